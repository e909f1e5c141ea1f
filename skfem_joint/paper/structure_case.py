"""What the two runs of the jointed structure share (sections 7.3 and 7.4)."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh

from skfem_joint.paper.cases import CASES
from skfem_joint.paper.figures import finish
from skfem_joint.paper.items import FloatArray
from skfem_joint.reference import lap_joint
from skfem_joint.structure import assemble
from skfem_joint.study import Study

CASE = CASES["structure"]
POINTS = {"free_end": "free end", "junction": "junction"}
#: Reductions by whether they are the paper's plain choice.
CHOICES = {False: "ours", True: "the paper's plain choice"}


def difference(study: Study, point: str) -> FloatArray:
    """Reduced minus full over time, percent of the full model's peak."""
    full, reduced = (study.models[name].run.point(point) for name in ("full", "reduced"))
    return np.asarray(100.0 * (reduced - full) / np.abs(full).max())


def resonances(length: float, count: int) -> FloatArray:
    """First natural frequencies of a plate held at one end, by finite elements, Hz."""
    system = assemble(lap_joint(length))
    values = eigsh(
        sparse.csc_array(system.K),
        k=count,
        M=sparse.csc_array(system.M),
        sigma=0.0,
        return_eigenvectors=False,
        v0=np.ones(system.n),
    )
    return np.asarray(np.sort(np.sqrt(values)) / (2.0 * np.pi))


def moving_length() -> float:
    """Linear region and static active length, m."""
    return CASE.linear + CASE.static_length


def finish_panels(upper: Any, lower: Any, title: str, limit: float, label: str) -> None:
    """Draw the published limit (percent) into a panel of differences and label both panels."""
    for sign in (-1.0, 1.0):
        lower.axhline(
            sign * limit, color="#555555", linewidth=0.8, label=label if sign > 0 else None
        )
    finish(upper, "time (ms)", "displacement (µm)", title, legend=False)
    finish(lower, "time (ms)", "difference (% of peak)", legend=False)


def legend_above(drawing: Any, *panels: Any) -> None:
    """One legend for all panels, outside them."""
    handles: dict[str, Any] = {}
    for panel in panels:
        handles |= dict(zip(*reversed(panel.get_legend_handles_labels()), strict=True))
    drawing.legend(
        handles.values(), handles.keys(), loc="outside upper center", ncols=4, handlelength=3.2
    )
