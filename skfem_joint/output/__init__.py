"""What is written of a study: summary and table, histories, fields for ParaView, and pictures.

`folder` prepares a folder and writes all files into it; `record` tracks which files in it this
program wrote. `report` (summary, printed tables) and `tables` (CSV, JSON); `fields` and `series`
(VTK); `plots` (curves) and `pictures` with `offscreen` (bodies); `preview` and `preview_picture` (a
structure before it is run); `damping` (backbones and responses) with `loss`, `backbone_peaks`,
`fits` and `sweeps`.
"""

from skfem_joint.output.folder import prepare, write

__all__ = ["prepare", "write"]
