"""What is written of a study: summary and table, histories, fields for ParaView, and pictures."""

from skfem_joint.output.folder import prepare, write

__all__ = ["prepare", "write"]
