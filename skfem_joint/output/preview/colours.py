"""Colours of a preview: of the kinds of marks, of bodies, and of pressures."""

from __future__ import annotations

from typing import Any

import numpy as np

from skfem_joint.output.preview.marks import Preview

#: Colours of the kinds of marks.
OF_KIND = {
    "joint": "#b35900",
    "support": "#1e7a34",
    "load": "#1f4fb4",
    "bolt": "#7a2f9e",
    "part": "#4a4f55",
}
#: Colours of the pressures: none, half of the largest, the largest.
PRESSURES = ("#fff8e6", "#f6b04a", "#c24e00")
_BODIES = ("#dfe3e8", "#c9d6e2", "#e4dccb", "#d3e0d1")


def of_body(number: int) -> str:
    """Colour of a body."""
    return _BODIES[number % len(_BODIES)]


def of_pressures() -> Any:
    """Colours of the pressures, from none to the largest."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("pressures", PRESSURES)


def scale_of_pressures(preview: Preview) -> Any:
    """Scale of the pressures of all joints, from 0, MPa."""
    from matplotlib.colors import Normalize

    joints = preview.of_kind("joint")
    top = max((float(np.max(np.asarray(mark.pressure))) for mark in joints), default=0.0)
    return Normalize(0.0, 1e-6 * top or 1.0)
