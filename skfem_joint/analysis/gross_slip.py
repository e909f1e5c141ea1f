"""Joints that slip as a whole: whether they do, and the load at which the first one does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.arrays import FloatArray, IntArray, as_dense
from skfem_joint.reduction.active_length import THRESHOLD
from skfem_joint.stepping.quasi_static import QuasiStatic


@dataclass(frozen=True)
class GrossSlipSettings:
    """Numbers of gross slip.

    Attributes
    ----------
    whole : float
        A joint slips as a whole if points with this share of its friction limit slip.
    still : float
        Points whose slip is below this share of the largest slip count as sticking. In dense
        systems, which have fewer unknowns than points, points cannot stick exactly: there the share
        is a thousandth.
    above : float
        The search begins this much, relative, above the load at which the forces on the stuck
        joint add up to its limit.
    raised : float
        Factor of the load from one trial to the next.
    trials : int
        Most trials, up to 190 times the first load.
    """

    whole: float = 0.99
    still: float = 1e-9
    above: float = 0.01
    raised: float = 1.3
    trials: int = 20


SETTINGS = GrossSlipSettings()


def still_share(path: QuasiStatic) -> float:
    """Share of the largest slip below which a point of a path counts as sticking."""
    return THRESHOLD if path.to.kind == "dense" else SETTINGS.still


def sticking_share(path: QuasiStatic, slip: FloatArray, points: IntArray) -> float:
    """Share of a joint's friction limit whose points stick, by the slip (m,), m, of a state."""
    limits = path.to.system.w[points]
    sticks = slip[points] <= still_share(path) * slip.max()
    return float(limits[sticks].sum() / limits.sum())


def is_gross(sticking: float) -> bool:
    """Whether a joint slips as a whole, by the share of its limit that sticks."""
    return sticking <= 1.0 - SETTINGS.whole


def gross_slip_level(
    path: QuasiStatic, force: FloatArray, stuck: FloatArray, raised: bool
) -> float:
    """Multiple of a force at which the first joint slips as a whole.

    Where joints alone carry the load, the first one slips when the forces on it, with all joints
    stuck, add up to its friction limit. Where supports carry a part too, slip moves load to them:
    then the load is raised from there, in steps, until a joint slips as a whole, and the level is
    interpolated between the last two steps.

    Parameters
    ----------
    path : QuasiStatic
        Of the system.
    force : ndarray, shape (n,)
        N, in the unknowns of ``path.to.system``.
    stuck : ndarray, shape (n,)
        Displacement, m, under that force with all joints stuck.
    raised : bool
        Whether supports carry a part of the load.

    Returns
    -------
    float
        ``inf`` where the force loads no joint.

    Raises
    ------
    ConvergenceError
        If the response to a load does not converge.
    """
    system = path.to.system
    balanced = force - system.K @ stuck
    # A dense system has more slip rows than unknowns: the smallest forces that hold it are taken.
    dense = path.to.kind == "dense"
    rows = np.linalg.lstsq(as_dense(system.B).T, balanced)[0] if dense else system.B @ balanced
    forces = system.slip_norm(np.asarray(rows, dtype=float))
    loaded = [points for points in system.joint_points if forces[points].sum() > 0.0]
    if not loaded:
        return np.inf
    nominal = min(float(system.w[p].sum() / forces[p].sum()) for p in loaded)
    if not raised:
        return nominal

    level, sticking = nominal * (1.0 + SETTINGS.above), 1.0
    u = before = 0.0 * force
    for _ in range(SETTINGS.trials):
        path.tally.total += 1
        u = path.follow(level * force[np.newaxis], limit_share=np.inf, start=(u, before))[0]
        slip = system.slip_norm(system.B @ u)
        last = sticking
        sticking = min(sticking_share(path, slip, points) for points in loaded)
        if is_gross(sticking):
            if last == 1.0:  # at the first trial, or from all sticking to none
                return nominal
            beyond = (1.0 - SETTINGS.whole - sticking) / (last - sticking)
            return float(level * SETTINGS.raised**-beyond)
        before = level * force
        level *= SETTINGS.raised
    # The basis of a dense system may not let a joint slip so far.
    return nominal
