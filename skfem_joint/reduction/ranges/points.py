"""Points of a range: the system of one frequency, level and set of friction limits."""

from __future__ import annotations

from collections.abc import Mapping

from skfem_joint.system import System


def at(
    system: System,
    *,
    frequency: float,
    slip: float | None = None,
    level: float | None = None,
    limits: Mapping[str, float] | None = None,
) -> System:
    """Model of one point of the range that a reduced model serves.

    Parameters
    ----------
    system : System
        Reduced model for a range, `reduce` with ``range``. A system of any other kind is changed
        alike, without a range: then ``level`` must be given.
    frequency : float
        Frequency of the loads' common period, Hz.
    slip : float
        Share of the load that makes the first joint slip as a whole at that frequency and with
        those limits: within some cycles from rest, with inertia and damping.
    level : float
        Factor on the loads, in place of ``slip``.
    limits : mapping of str to float, optional
        Factor on the friction limits of joints by name; 1 where not given.

    Returns
    -------
    System
        To be run by `integrate`; its ``serves.point`` states frequency, level, limits and slip.
        ``sj.estimate(run)`` states the error of such a run.

    Raises
    ------
    InputError
        If the point is outside the range, a joint slips as a whole, or a name is unknown.
    """
    raise NotImplementedError
