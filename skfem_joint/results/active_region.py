"""Where joints slip: the share of each joint's area, and the length, that is active in a run."""

from __future__ import annotations

from dataclasses import dataclass

from skfem_joint.ground.arrays import BoolArray, FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import common_period
from skfem_joint.ground.values import POSITIVE, check_some
from skfem_joint.reduction.active_length import active_fractions, measured_lengths
from skfem_joint.results.contact_history import contact_system, slip_peaks_of
from skfem_joint.stepping.recording import Run
from skfem_joint.structure.model import AnyStructure
from skfem_joint.structure.structure import Structure
from skfem_joint.system.system import System


@dataclass(frozen=True)
class ActiveRegion:
    """Active region of each joint, the part that slips rather than creeps.

    Attributes
    ----------
    length : dict of str to float
        Active length of each joint that has an axis, m: from its loaded end to where the largest
        slip has fallen to a thousandth of that at the end.
    area_fraction : dict of str to float
        Share of each joint's contact area that slips.
    point_fraction : dict of str to float
        Share of each joint's contact nodes that slip.
    slips : ndarray of bool, shape (m,)
        Whether each contact point slips.
    slip_peak : ndarray, shape (m,)
        Largest slip of each contact point, m.
    """

    length: dict[str, float]
    area_fraction: dict[str, float]
    point_fraction: dict[str, float]
    slips: BoolArray
    slip_peak: FloatArray


def active_region(structure: Structure, run: Run, period: float | None = None) -> ActiveRegion:
    """Active region of each joint of a structure in a run.

    A point is active if it slips by the definition of `System.slipping`: by more than a thousandth
    of the largest slip, and than it creeps in a period at half of its friction limit. The slip of
    full and condensed models is known at every step, that of reduced ones from stored fields.

    Parameters
    ----------
    structure : Structure
        That the run's system was made from.
    run : Run
    period : float, optional
        Time that a point has to creep in, s; if not given the loads' common period, or without one
        the time of the last row that the run stored.

    Returns
    -------
    ActiveRegion

    Raises
    ------
    InputError
        If the run is not one of this structure, ``period`` is not positive, or neither given nor
        known from the run, or a reduced model stored no fields.
    """
    check_some(POSITIVE, period=period)
    if period is None:
        period = common_period(load.amplitude for load in run.system.loads)
    if period is None:
        rows = max(run.times, run.field_times, key=len)
        if not rows.size or rows[-1] == 0.0:
            raise InputError("active_region: the run stored no times; give a period (s)")
        period = float(rows[-1])
    system = contact_system(structure, run)
    return region_of(structure, system, slip_peaks_of(structure, run), period)


def region_of(
    structure: AnyStructure, system: System, peaks: tuple[FloatArray, FloatArray], period: float
) -> ActiveRegion:
    """Active region from the largest slips of all contact points and of their sliders, (m,), m.

    The law is that of ``system``, which has all contact points; ``period`` in s.
    """
    slip_peak, sliding = peaks
    area, points = active_fractions(structure, system, sliding, period)
    active = system.slipping(sliding, period)
    lengths = measured_lengths(structure, sliding)
    return ActiveRegion(lengths, area, points, active, slip_peak)
