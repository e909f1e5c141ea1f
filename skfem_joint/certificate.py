"""Estimated errors of a scene's results: time step, mesh, steepness of the law, number of modes.

Each source of error is looked at alone, by running the scene again with that one thing changed:

time step
    Steps halved twice. The observed order p (kept between 1/2 and 2, friction is not smooth)
    extrapolates the difference of the first two runs to the error of the first.
mesh
    Elements halved twice, likewise; full model only. Plates are halved once, and their error is
    taken to go with the size of the elements: another halving would cost sixteen times the first.
beta
    Against exact Coulomb friction: what the regularisation changes. Full model only, a reduced
    model chooses its beta below its truncation error.
modes
    j against j + 2 modes; no full model is run.
friction points
    The reduced model's few friction points against all contact nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import log2
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import InputError
from skfem_joint.history import AT_REST, peaks
from skfem_joint.meshing import BarMesh, refined
from skfem_joint.plate_mesh import PlateMesh
from skfem_joint.plate_mesh import refined as refined_plate
from skfem_joint.recording import Run
from skfem_joint.scene import AnyScene, PlateScene
from skfem_joint.study import run_scene

FloatArray = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

#: Results that errors are estimated for.
QUANTITIES = ("displacement_rms", "peak_displacement", "friction_energy", "loop_energy")
#: Orders of convergence that an extrapolation may use.
ORDERS = (0.5, 2.0)


@dataclass(frozen=True)
class Estimate:
    """Estimated relative errors from one source.

    Attributes
    ----------
    source : str
        ``time step``, ``mesh``, ``beta``, ``modes`` or ``friction points``.
    errors : dict
        By quantity, see `QUANTITIES`; not negative.
    order : float or None
        Observed order of convergence of the displacement history; None where nothing was halved
        twice. Outside `ORDERS` the extrapolation is not to be trusted beyond its size.
    """

    source: str
    errors: dict[str, float]
    order: float | None = None


def _variant(
    scene: AnyScene,
    model: str,
    *,
    halvings: int = 0,
    mesh: BarMesh | PlateMesh | None = None,
    joint: dict[str, Any] | None = None,
    reduction: dict[str, Any] | None = None,
) -> AnyScene:
    """Scene with one thing changed, storing the same times, points and nothing else."""
    factor = 2**halvings
    time = scene.time
    if time.cycles is not None:
        time = time.model_copy(update={"steps_per_cycle": time.steps_per_cycle * factor})
    else:
        time = time.model_copy(update={"step": scene.time_step / factor})
    output = scene.output.model_copy(
        update={
            "vtk": False,
            "plots": False,
            "history": True,
            "every": scene.output.every * factor,
            "points": scene.output_points,
        }
    )
    joints: tuple[Any, ...] = scene.joint
    if joint is not None:
        joints = tuple(one.model_copy(update=joint) for one in joints)
    changed = scene.model_copy(
        update={
            "time": time,
            "output": output,
            "joint": joints,
            "models": scene.models.model_copy(update={"run": (model,)}),
            "reduction": scene.reduction.model_copy(update=reduction or {}),
        }
    )
    if isinstance(changed, PlateScene):
        changed._plate = mesh if isinstance(mesh, PlateMesh) else changed.plate
    else:
        changed._bar = mesh if isinstance(mesh, BarMesh) else changed.bar
    return changed


def _run(scene: AnyScene) -> Run:
    (model,) = run_scene(scene).models.values()
    if model.run.interrupted:
        raise KeyboardInterrupt
    return model.run


def _scalars(run: Run) -> dict[str, float]:
    cycles = run.cycles
    has_cycles = cycles.friction.size > 0
    return {
        "peak_displacement": float(peaks(run).max(initial=0.0)),
        "friction_energy": float(cycles.friction[-1] if has_cycles else run.friction_work.sum()),
        "loop_energy": float(cycles.input[-1].sum() if has_cycles else run.input_work.sum()),
    }


def _difference(one: Run, other: Run) -> dict[str, float]:
    """Differences of two runs' results, relative to the first one's."""
    rows = min(one.times.size, other.times.size)  # a duration may not be whole steps
    history = one.point_u[:rows]
    largest = np.abs(history).max(axis=0, initial=0.0)
    moves = largest > AT_REST * largest.max(initial=0.0)
    rms = np.linalg.norm((history - other.point_u[:rows])[:, moves], axis=0)
    found = {
        "displacement_rms": float(
            (rms / np.linalg.norm(history[:, moves], axis=0)).max(initial=0.0)
        )
    }
    theirs = _scalars(other)
    for name, value in _scalars(one).items():
        found[name] = abs(value - theirs[name]) / abs(value) if value != 0.0 else 0.0
    return found


def extrapolated(first: float, second: float) -> tuple[float, float | None]:
    """Error of the coarsest of three results from their successive differences.

    Parameters
    ----------
    first, second : float
        Difference of the coarsest and the middle one, and of the middle and the finest.

    Returns
    -------
    error, order
        ``first / (1 - 2**-p)`` with the order p = log2(first / second) kept between `ORDERS`;
        the order as observed, None if there is none.
    """
    if first == 0.0 or second == 0.0:
        return first, None
    order = log2(first / second)
    p = min(max(order, ORDERS[0]), ORDERS[1])
    return max(first, second) / (1.0 - 2.0**-p), order


def _halved_twice(source: str, runs: Sequence[Run]) -> Estimate:
    first, second = _difference(runs[0], runs[1]), _difference(runs[1], runs[2])
    errors, order = {}, None
    for name in QUANTITIES:
        errors[name], p = extrapolated(first[name], second[name])
        if name == "displacement_rms":
            order = p
    return Estimate(source, errors, order)


def _finer(scene: AnyScene) -> list[BarMesh | PlateMesh]:
    """Meshes to compare the scene's own with."""
    if isinstance(scene, PlateScene):
        return [refined_plate(scene.plate)]
    once = refined(scene.bar)
    return [once, refined(once)]


def certify(scene: AnyScene, model: str, progress: Progress | None = None) -> list[Estimate]:
    """Estimate the errors of one model of a scene, source by source.

    Parameters
    ----------
    scene : Scene or PlateScene
    model : {"full", "reduced"}
    progress : callable, optional
        Called with (label, runs done, runs in all).

    Returns
    -------
    list of Estimate

    Raises
    ------
    InputError
        For a model that the scene does not run.
    ConvergenceError
        If a run does not converge.
    """
    if model not in scene.models.run:
        raise InputError(f"certify: the scene does not run the {model} model")
    plan = [_variant(scene, model, halvings=k) for k in range(3)]
    full = model == "full"
    regularised = [one for one in scene.joint if one.law == "arctan"]
    if full:
        plan += [_variant(scene, model, mesh=mesh) for mesh in _finer(scene)]
        if regularised:
            plan.append(_variant(scene, model, joint={"law": "coulomb"}))
    else:
        plan.append(_variant(scene, model, reduction={"modes": scene.reduction.modes + 2}))
        if scene.reduction.friction_points != "all":
            plan.append(_variant(scene, model, reduction={"friction_points": "all"}))
    runs: list[Run] = []
    for done, one in enumerate(plan):
        if progress is not None:
            progress(f"certifying the {model} model", done, len(plan))
        runs.append(_run(one))
    if progress is not None:
        progress(f"certifying the {model} model", len(plan), len(plan))
    estimates = [_halved_twice("time step", runs[:3])]
    if not full:
        estimates.append(Estimate("modes", _difference(runs[0], runs[3])))
        if len(runs) > 4:
            estimates.append(Estimate("friction points", _difference(runs[0], runs[4])))
        return estimates
    if isinstance(scene, PlateScene):
        once = _difference(runs[0], runs[3])
        estimates.append(Estimate("mesh", {name: 2.0 * error for name, error in once.items()}))
    else:
        estimates.append(_halved_twice("mesh", [runs[0], *runs[3:5]]))
    if regularised:
        estimates.append(Estimate("beta", _difference(runs[0], runs[-1])))
    return estimates
