"""What a study of a scene holds, and what studies of struts and of plates do alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from skfem_joint import friction
from skfem_joint.active_length import Estimate
from skfem_joint.checkpoint import Checkpoint, Checkpoints
from skfem_joint.errors import ConvergenceError, InputError, JointError
from skfem_joint.history import Errors, compare, peaks, steady_state
from skfem_joint.integrate import integrate
from skfem_joint.pod import ProperModes
from skfem_joint.recording import Run, Save
from skfem_joint.reduction import ReferenceModes
from skfem_joint.scene import CommonScene, PlateScene
from skfem_joint.schemes import generalized_alpha
from skfem_joint.system import System

FloatArray = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

#: Slip velocities of a reduced model are wrong by about a percent of the largest one: resolving the
#: friction law more finely than this share of it costs iterations and gains nothing.
RESOLVED_SHARE = 1e-4
#: Slip velocity of a joint that sticks throughout, for the choice of beta, m/s.
STUCK_VELOCITY = 1e-3


@dataclass(frozen=True)
class ZoneLength:
    """Active length of one zone and where it comes from.

    Attributes
    ----------
    joint : str
    length : float
        Used, m.
    source : str
        ``given``, ``probe`` or ``estimate``.
    estimate : Estimate or None
        By Eqs. (17)-(20), for harmonic loads.
    """

    joint: str
    length: float
    source: str
    estimate: Estimate | None = None


@dataclass(frozen=True)
class Model:
    """One model that was run.

    Attributes
    ----------
    name : str
    run : Run
    basis : ndarray, shape (n, j), or None
        Reduced basis; None for the full model.
    offline_s : float
        Time for everything before the first step, s: reference run, decomposition, active length,
        projection, compilation.
    active_length : dict
        Active length of each joint end where force enters, m.
    zones : tuple of ZoneLength
        How a reduced model got its active lengths.
    proper : ProperModes or None
        Decomposition that a reduced model's modes come from.
    reference : ReferenceModes or None
    errors : Errors or None
        Against the full model, where both were run.
    active_area_fraction : dict
        Part of each joint's area that slips, for plates.
    """

    name: str
    run: Run
    basis: FloatArray | None
    offline_s: float
    active_length: dict[str, float]
    zones: tuple[ZoneLength, ...] = ()
    proper: ProperModes | None = None
    reference: ReferenceModes | None = None
    errors: Errors | None = None
    active_area_fraction: dict[str, float] = field(default_factory=dict)

    def fields(self) -> tuple[FloatArray, FloatArray]:
        """Displacement and velocity histories on the full model's unknowns."""
        if self.basis is None:
            return self.run.u, self.run.v
        return self.run.u @ self.basis.T, self.run.v @ self.basis.T

    def normalised_friction(self, system: System) -> FloatArray:
        """Friction over its limit at all contact points of the full model, (frames, rows of B).

        A reduced model evaluates friction at points of its own; here its law is evaluated at its
        velocities of the contact nodes.
        """
        if self.basis is None:
            return self.run.sigma
        slip = (system.B @ self.fields()[1].T).T
        beta = np.minimum(system.beta, self.run.system.beta.max())
        return friction.force_vectors(slip, beta, system.directions)


S = TypeVar("S", bound=CommonScene)
T = TypeVar("T")


@dataclass
class Results(Generic[S, T]):
    """Results of a scene; ``warnings`` are whole sentences."""

    scene: S
    structure: T
    system: System
    models: dict[str, Model] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    interrupted: bool = False


R = TypeVar("R", bound=Results[Any, Any])
#: Runs one model of a study: takes the study, the progress of its steps and its checkpoint.
Maker = Callable[[R, Callable[[int, int], None], Checkpoint | None], Model]


def run_models(
    study: R,
    makers: Mapping[str, Maker[R]],
    progress: Progress | None,
    checkpoints: Checkpoints | None,
    origin: str,
    check: Callable[[R, Model], None],
) -> R:
    """Run the models that a study's scene asks for, compare them, and say what to beware of.

    Parameters
    ----------
    study : Results
        Without models yet; filled in and returned.
    makers : mapping
        How to run each model.
    progress, checkpoints
        As `skfem_joint.study.run_scene` takes them.
    origin : str
        Fingerprint of the scene, for checkpoints.
    check : callable
        Adds warnings about a model that was run whole.

    Raises
    ------
    JointError
        If a model is refused or does not converge; its ``results`` are the study where other
        models were run before.
    """
    scene = study.scene
    for name in sorted(scene.models.run):  # the full model first: others compare with it
        try:
            checkpoint = None if checkpoints is None else checkpoints.of(name, origin)
            model = makers[name](study, partial(_report, progress, f"{name} model"), checkpoint)
        except JointError as error:
            if not study.models:
                raise
            study.warnings.append(f"There is no {name} model: {error}")
            error.results = study
            raise
        except KeyboardInterrupt:
            if not study.models:
                raise
            study.interrupted = True
            study.warnings.append(f"The run was interrupted while the {name} model was made.")
            break
        if "full" in study.models and not model.run.interrupted:
            model = replace(model, errors=compare(study.models["full"].run, model.run))
        study.models[name] = model
        if model.run.interrupted:
            study.interrupted = True
            study.warnings.append(
                f"The run was interrupted in the {name} model at t = "
                f"{model.run.counters.steps * scene.time_step:.6g} s; "
                "results are those until then."
            )
            break
        check(study, model)
    return study


def _report(progress: Progress | None, label: str, done: int, total: int) -> None:
    if progress is not None:
        progress(label, done, total)


def save_of(scene: CommonScene) -> Save:
    """Store only what a picture, a file or a comparison of this scene needs."""
    output = scene.output
    return Save(
        every=output.every,
        points=output.history or output.plots or len(scene.models.run) > 1,
        fields=output.vtk or (output.plots and isinstance(scene, PlateScene)),
        fields_every=max(1, -(-scene.n_steps // output.frames)),
    )


def integrated(
    scene: CommonScene,
    system: System,
    progress: Callable[[int, int], None],
    checkpoint: Checkpoint | None,
) -> Run:
    """Run of one of a scene's models with the steps, scheme and output that the scene asks for."""
    return integrate(
        system,
        step=scene.time_step,
        n_steps=scene.n_steps,
        scheme=generalized_alpha(scene.time.rho_infinity),
        save=save_of(scene),
        cycle_steps=scene.cycle_steps,
        progress=progress,
        checkpoint=checkpoint,
    )


def full_run(
    study: R,
    progress: Callable[[int, int], None],
    checkpoint: Checkpoint | None,
    place: Callable[[int], str],
) -> Run:
    """Run of the full model; ``place`` says in words where an unknown is.

    Raises
    ------
    ConvergenceError
        If a step does not converge, with the place of the largest residual.
    """
    try:
        return integrated(study.scene, study.system, progress, checkpoint)
    except ConvergenceError as error:
        if error.unknown is None:
            raise
        raise ConvergenceError(
            f"full model: {error} That unknown is {place(error.unknown)}.", error.unknown
        ) from error


def check_friction(system: System) -> None:
    """Refuse to reduce a system without friction.

    Raises
    ------
    InputError
    """
    if system.contact_points == 0:
        raise InputError(
            "models.run: 'reduced' needs friction in a joint; every joint of this scene has zero "
            "pressure or zero friction. Run 'full' alone."
        )


def finished(run: Run) -> Run:
    """Pass on a whole run; half of one makes neither modes nor an active length."""
    if run.interrupted:
        raise KeyboardInterrupt
    return run


def run_warnings(model: Model) -> list[str]:
    """What to beware of in a run: no steady state, an open energy balance."""
    run = model.run
    found = []
    state = steady_state(run)
    if state is not None and not state.reached:
        found.append(
            f"The {model.name} model has not reached a steady state: the last cycle differs by "
            f"{100 * state.energy_change:.2g} % in energy and {100 * state.peak_change:.2g} % in "
            "peaks from the one before. Energies and peaks per cycle are those of the last cycle."
        )
    if np.any(peaks(run) > 0.0) and run.energy_residual > 1e-8:
        found.append(
            f"The energy balance of the {model.name} model is open by {run.energy_residual:.2g} of "
            "the energy in play."
        )
    return found


def with_resolvable_beta(study: R, system: System, slip_velocity: float) -> System:
    """Give a reduced system the steepness asked for, or else one that it can make use of.

    A free decay comes to rest, where a law less steep would let the joint creep: there the share
    of the slip velocity (its largest, m/s) that is resolved is a hundred times smaller.
    """
    asked = study.scene.reduction.beta
    if not isinstance(asked, str):
        return replace(system, beta=np.full_like(system.beta, asked))
    share = RESOLVED_SHARE if study.scene.time.cycles is not None else 0.01 * RESOLVED_SHARE
    beta = 1.0 / (share * slip_velocity)
    if np.any(study.system.beta > beta):
        study.warnings.append(
            f"The reduced model uses beta = {beta:.3g} s/m: its modes do not resolve slip "
            f"velocities below {share:g} of the largest ({slip_velocity:.3g} m/s), where "
            "a steeper law would differ. Set reduction.beta to choose."
        )
    return replace(system, beta=np.minimum(system.beta, beta))
