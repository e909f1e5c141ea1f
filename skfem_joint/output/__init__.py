"""What is written of a study: summary and table, histories, fields for ParaView, and pictures.

`folder` prepares a folder and writes all files into it; `record` tracks which files in it this
program wrote. `report` (summary, printed tables), `page` (a page of HTML of them) and `tables`
(CSV, JSON); `fields` and `series` (VTK), `universal` (files of modal test); `plots` (curves) and
the folder `drawing` (bodies); `damping` (backbones and responses) with `loss` and
`backbone_peaks`, `nonlinear_modes`, `fits` and `sweeps`.
"""

from skfem_joint.output.folder import prepare, write

__all__ = ["prepare", "write"]
