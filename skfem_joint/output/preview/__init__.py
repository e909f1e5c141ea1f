"""Picture of a structure before it is run: mesh, names, supports, loads, joints and bolts.

`marks.preview_of` collects what a scene describes as marks, `sheet.preview_figure` draws them, and
`files.write_preview` writes the picture. A bar is drawn along its axis with its thickness enlarged,
a plate in the plane of its mesh, a solid in space by pyvista with each joint's face below it.
Labels stand above the drawing, with lines to their places.

The sheet puts together: `projection` (coordinates of the drawing), `labels` (their places and
lines), and on the drawing's panel (`drawing`) the elements (`bodies`), what marks them
(`symbols`), the scales in mm (`scales`); below it the faces of joints of solids (`faces`), and
title, notes and legend (`words`). `colours` are the same in all of them.
"""

from skfem_joint.output.preview.files import check_target, write_preview
from skfem_joint.output.preview.marks import Mark, Preview, preview_of
from skfem_joint.output.preview.sheet import preview_figure

__all__ = ["Mark", "Preview", "check_target", "preview_figure", "preview_of", "write_preview"]
