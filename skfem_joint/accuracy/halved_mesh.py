"""Error of a run by its mesh: what the same run changes where all elements are halved.

Few contact points across the zone that slips, and a body that is too stiff or too coarse around its
front, act together, and on the load of a joint through the resonance of the body too. So nothing
but the same run on a finer mesh says what they do. On slow cycles of 21 structures (plates in plan
and from the side, laps, solids, even and bolted pressures, all kinds of elements; 14 levels of load
each) the friction energy errs by 1.1 to 2.4 times what halved elements change, as the error falls
with the first power of the size where it is small and slower where elements lock. `BEYOND` times
the change was 0.5 to 3 times the error in 94 to 95 % of the cases. (Merged contact points in place
of a finer mesh, and the ratio of the slipping zone to the size of elements, in 42 to 68 %.)

Both runs are of full models if these are small, and otherwise of reduced models made alike, whose
own errors are much the same. What is asked for is the error of a structure under its loads: it is
the same for its full, condensed and reduced models.
"""

from __future__ import annotations

from collections.abc import Callable

from skfem_joint.accuracy.estimate import Parts, named, verification_run
from skfem_joint.accuracy.ladder import apart
from skfem_joint.accuracy.rungs import is_small, model_beside
from skfem_joint.ground.errors import InputError
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system.system import System

#: Error over the change by halved elements.
BEYOND = 1.5


def of_run(
    run: Run,
    plan: Plan,
    system: System,
    finer: System,
    progress: Callable[..., None] | None = None,
) -> Parts:
    """Errors of a run of a full system, or of a model of it, by its mesh.

    Parameters
    ----------
    run : Run
        By ``plan``, with its named points.
    plan : Plan
    system : System
        The full system.
    finer : System
        The same on a mesh whose elements are halved, with points of the same names.
    progress : callable, optional
        As `integrate` takes it.

    Raises
    ------
    InputError
        If the systems are too large to be run, and contact opens, so that there is no reduced
        model that takes the same steps.
    ConvergenceError
        If a step does not converge.
    KeyboardInterrupt
        If a run is interrupted.
    """
    if is_small(finer, plan) or plan.quasi_static:
        systems = system, finer
    elif system.contact.opens:
        raise InputError("contact opens, and on halved elements the full model is large")
    else:
        systems = model_beside(system, plan), model_beside(finer, plan)
    before, after = (
        run if each is run.system else verification_run(each, plan, progress=progress)
        for each in systems
    )
    return named(BEYOND * apart(after, before))
