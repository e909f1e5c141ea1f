"""What was found of a scene: the models that were run, and the study that holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from skfem_joint.accuracy.estimate import Estimate
from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import JointError
from skfem_joint.reduction.basis import Basis
from skfem_joint.results.history import Errors
from skfem_joint.results.loss import losses, over
from skfem_joint.results.places import slips_of_all
from skfem_joint.scene import Scene
from skfem_joint.stepping.recording import Run
from skfem_joint.structure.model import AnyStructure
from skfem_joint.study.description import Description
from skfem_joint.system.system import System


@dataclass(frozen=True)
class Model:
    """One model that was run.

    Attributes
    ----------
    name : str
        "full", "condensed" or "reduced".
    run : Run
    offline_s : float
        Time before the first step, s: modes, active length, projection.
    active_length : dict of str to float
        Active length of each joint whose axis is known, m.
    active_area_fraction, slipping_fraction : dict of str to float
        Share of each joint's contact area, and of its nodes, that slips; empty for a reduced model
        beside a full one.
    errors : Errors, optional
        Distance from the full model, where both were run.
    estimate : Estimate, optional
        Errors estimated without the full model.
    estimate_s : float
        Time that the estimate took, s.
    compilation_s : float
        Time of compilation, s, which happens once on a machine and is in no other time here.
    """

    name: str
    run: Run
    offline_s: float
    active_length: dict[str, float]
    active_area_fraction: dict[str, float] = field(default_factory=dict)
    slipping_fraction: dict[str, float] = field(default_factory=dict)
    errors: Errors | None = None
    estimate: Estimate | None = None
    estimate_s: float = 0.0
    compilation_s: float = 0.0

    @property
    def basis(self) -> Basis | None:
        """What a reduced or condensed model is made of; None for one that serves a range."""
        origin = self.run.system.origin
        return None if origin is None else origin.basis

    @property
    def loss_error(self) -> float | None:
        """Stated relative error of the loss factor in the last cycle; None where it is not known.

        To first order from the stated errors of friction energy and peak, as if none cancelled:
        viscous losses and strain energy grow with the square of the peak.
        """
        if self.estimate is None or not self.run.cycles.friction.size:
            return None
        energy, peak = (
            self.estimate.of("total", name) for name in ("friction_energy", "peak_displacement")
        )
        found = losses(self.run)
        share = float(over(found.friction, found.lost))
        if peak is None or (energy is None and share):
            return None
        return share * (energy or 0.0) + 2.0 * (1.0 - share) * peak + 2.0 * peak

    @property
    def slip_peak(self) -> FloatArray:
        """Largest slip of each contact point of the full model, m, as far as it is known, (m,).

        That of a reduced model is of the run that its modes were made from; of one that serves a
        range it is that of the friction points that stand for the contact points.
        """
        if self.basis is not None and self.name == "reduced":
            return self.basis.history.slip_peak
        return slips_of_all(self.run.system, self.run.slip_peak)

    def slider_peak(self, system: System) -> FloatArray:
        """Largest slip of each slider of the full ``system``, as `slip_peak`, (m,), m."""
        if not system.contact.opens or not system.contact.has_springs:
            return system.contact.slider_peak(self.slip_peak)
        return slips_of_all(self.run.system, self.run.slider_peak)

    @property
    def modes(self) -> int | None:
        """Number of vectors of the basis; None for the full model."""
        if self.basis is None:
            return None if self.name == "full" else self.run.system.n
        return int(self.basis.V.shape[1])


@dataclass(frozen=True)
class Failure:
    """Why a study does not have all models of its scene.

    Attributes
    ----------
    model : str
        Name of the model that was not made.
    error : JointError
        InputError where the model does not fit the scene, ConvergenceError where a step of it does
        not converge.
    """

    model: str
    error: JointError


@dataclass(frozen=True)
class Study:
    """Results of a scene.

    Attributes
    ----------
    scene : Scene
        The scene with the time steps that were taken.
    structure : Structure or MatrixModel
    system : System
        System of the full model.
    description : Description
        Facts about the structure, and its response to static loads.
    models : mapping of str to Model
        Models by their names, in the order in which they were run.
    notes : tuple of str
        What to beware of, in whole sentences.
    failure : Failure, optional
        The model that could not be made, and why; models after it were not tried.
    interrupted : bool
        Whether the study was stopped early: the last model may hold a part of its run.
    """

    scene: Scene
    structure: AnyStructure
    system: System
    description: Description = field(default_factory=Description)
    models: Mapping[str, Model] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    failure: Failure | None = None
    interrupted: bool = False

    @property
    def runs(self) -> dict[str, Run]:
        """Runs by the names of their models."""
        return {name: model.run for name, model in self.models.items()}

    @property
    def ended(self) -> bool:
        """Whether the study was interrupted, or one of its models failed."""
        return self.interrupted or self.failure is not None

    @property
    def period(self) -> float:
        """Period of the load, or the length of the run where it has none, s."""
        return (self.scene.cycle_steps or self.scene.n_steps) * self.scene.time_step

    def finished(self) -> Study:
        """The study itself, if it has all models of its scene.

        Raises
        ------
        JointError
            That of the model that failed.
        KeyboardInterrupt
            If the study was interrupted.
        """
        if self.failure is not None:
            raise self.failure.error
        if self.interrupted:
            raise KeyboardInterrupt
        return self

    def whole(self, name: str) -> Model | None:
        """A model whose run was not interrupted; None if there is none of this name."""
        model = self.models.get(name)
        return None if model is None or model.run.interrupted else model

    def holding(self, model: Model) -> Study:
        """Copy that holds a model, in place of one of the same name."""
        return replace(self, models={**self.models, model.name: model})

    def noting(self, *notes: str, interrupted: bool = False) -> Study:
        """Copy with more notes, which is also ``interrupted`` if so said."""
        interrupted = interrupted or self.interrupted
        said = tuple(dict.fromkeys([*self.notes, *notes]))
        return replace(self, notes=said, interrupted=interrupted)
