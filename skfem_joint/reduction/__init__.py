"""Reduced models of structures with joints.

`pod` decomposes histories; `basis` makes modes, of the structure's own run or scaled from the
paper's `reference` joint over the active `zones` (`active_length`); `friction_points` gives a
reduced system as few points of friction as it can make use of.
"""

from __future__ import annotations

from skfem_joint.reduction.basis import TRAINING_CYCLES, finished, own_basis
from skfem_joint.reduction.friction_points import reduced_system
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.system import System


def reduce(
    system: System,
    modes: int = 10,
    *,
    run: Run | None = None,
    friction_points: str | int = "auto",
    beta: str | float = "auto",
) -> System:
    """Reduced model on proper orthogonal modes of a system's own run.

    Parameters
    ----------
    system : System
        With loads, as runs to come have them.
    modes : int
    run : Run, optional
        With stored fields, ``save=Save(fields=True)``; three periods of the loads from rest, of 200
        steps each, if not given.
    friction_points : "auto", "all" or int
        Most friction points; four for each mode. Points that slip alike are merged.
    beta : "auto" or float
        Scaling constant of Eq. (2), s/m; no steeper than the modes resolve.

    Returns
    -------
    System
        Of ``modes`` unknowns; its ``expand`` gives the displacement of all that the full one has.

    Raises
    ------
    InputError
        If the loads have no common period, nothing moves, or no point carries friction.
    """
    if run is None:
        save = Save(fields=True, points=False)
        run = finished(integrate(system, cycles=TRAINING_CYCLES, steps_per_cycle=200, save=save))
    basis = own_basis(system, run, modes)
    return reduced_system(system, basis, friction_points=friction_points, beta=beta, warn=[])[0]
