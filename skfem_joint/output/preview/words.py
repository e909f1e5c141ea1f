"""Title, notes and legend of a preview."""

from __future__ import annotations

from typing import Any

from skfem_joint.output.preview import colours
from skfem_joint.output.preview.drawing import Reach, edges_fit
from skfem_joint.output.preview.faces import faces_of
from skfem_joint.output.preview.marks import Preview
from skfem_joint.output.preview.projection import Projection


def notes_of(preview: Preview, projection: Projection, reach: Reach) -> list[str]:
    """Sentences below the picture, on what it leaves out and what is not to scale."""
    notes, dim = list(preview.notes), projection.dim
    if dim == 1:
        notes.append("The thickness of bars is not to scale.")
    if dim == 3:
        notes.append("Dashed outlines mark surfaces, also where other parts hide them.")
    if projection.enlarged > 1:
        notes.append(f"Lengths along y are drawn {projection.enlarged} times as large.")
    left = len(preview.of_kind("joint")) - len(faces_of(preview)) if dim == 3 else 0
    if left:
        notes.append(f"The faces of {left} further joints are not drawn below.")
    if not edges_fit(preview, reach):
        notes.append("The mesh is too fine for this picture: its edges are left out.")
    return notes


def headings_of(preview: Preview) -> tuple[str, str]:
    """Title, and what the structure consists of."""
    structure = preview.structure
    kind = {1: "Bars", 2: "Plates", 3: "Solids"}[structure.dim]
    return preview.title, f"{kind}: {structure.overview()}"


def legend_of(preview: Preview) -> list[Any]:
    """Handles of a legend, of all kinds of marks that there are."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch as Square

    solid, colour = preview.structure.dim == 3, colours.OF_KIND
    handles: list[Any] = [
        Square(facecolor=colours.of_body(0), edgecolor="#8a929b", label="element")
    ]
    if preview.of_kind("joint"):
        handles.append(
            Square(facecolor="white" if solid else colours.PRESSURES[1], edgecolor=colour["joint"],
                   linestyle="--" if solid else "-",
                   label="joint, its face is below" if solid else "joint")
        )  # fmt: skip
    lines: dict[str, dict[str, Any]] = {
        "support": {"marker": "^", "lw": 3, "label": "support"},
        "load": {"marker": ">", "lw": 3, "label": "load, in its positive direction"},
        "bolt": {"marker": "+", "lw": 1.5, "label": "bolt"},
        "part": {"marker": "o", "lw": 0.7, "ms": 4, "label": "named part"},
    }
    handles += [Line2D([], [], color=colour[kind], **line) for kind, line in lines.items()
                if preview.of_kind(kind)]  # fmt: skip
    return handles
