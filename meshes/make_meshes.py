"""Make the mesh files of this folder: ``python meshes/make_meshes.py [FOLDER]``.

The lap joints have 100 elements and are in contact along their whole length; the structure of
Fig. 18(b) is a 0.1 m joint of 1 mm elements followed by 0.5 m without contact, of 5 mm elements.
All bars run along x, in metres, and are held at ``fixed``.
"""

from __future__ import annotations

import sys
from pathlib import Path

from skfem_joint.meshing import BarMesh, build_bar, write_mesh


def lap_joint(length: float) -> BarMesh:
    """Lap joint of 100 equal elements; length in m."""
    return build_bar([("joint", length, 100)], {"fixed": 0.0, "free_end": length})


def structure() -> BarMesh:
    """Structure of Fig. 18(b): joint of 0.1 m, linear region of 0.5 m."""
    return build_bar(
        [("joint", 0.1, 100), ("linear", 0.5, 100)],
        {"fixed": 0.0, "junction": 0.1, "free_end": 0.6},
    )


def main(folder: Path) -> None:
    """Write all mesh files into a folder."""
    write_mesh(lap_joint(0.25), folder / "lap_joint_250mm.msh")
    write_mesh(lap_joint(0.5), folder / "lap_joint_500mm.msh")
    write_mesh(structure(), folder / "structure.msh")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
