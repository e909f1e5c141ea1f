"""One reduced model for all scenes of a range, by their key ``reduction.range``.

Scenes that differ in load level, frequency and friction limits alone share a model. It is made of
the scene in the *middle* of the range: its joints have the geometric means of the intervals, its
loads the middle frequency, the largest of them 1 N (or m/s²). What a model depends on is the same
for all of these scenes, and its digest names the model's file: a sweep makes the model once, and
its processes, a resumed sweep and other commands with the same folder load it.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.ground.errors import InputError
from skfem_joint.ground.plain_values import fingerprint
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.ground.rows import code_version
from skfem_joint.reduction.models import reduce
from skfem_joint.reduction.ranges.points import at, period_of, placed
from skfem_joint.scene import Scene
from skfem_joint.scene.range_table import ServedRangeTable
from skfem_joint.scene.scene import TABLES_OF_STRUCTURE
from skfem_joint.scene.tables import AnyLoad, HarmonicLoad, MultiHarmonicLoad
from skfem_joint.system import system_files
from skfem_joint.system.served import Point, Range, Served
from skfem_joint.system.system import System

_log = logging.getLogger(__name__)

#: Digits to which amplitudes of loads are taken relative to the largest.
_DIGITS = 12


@dataclass(frozen=True)
class ServedScene:
    """A scene as a point of its range.

    Attributes
    ----------
    mark : str
        Digest of all that the model for the range is made of, and of the version.
    middle : Scene
        Scene in the middle of the range, of which the model is made.
    range : Range
    accuracy : float or None
        Error of displacement histories that the scene asks for, None where it asks for none.
    """

    mark: str
    middle: Scene = field(compare=False, repr=False)
    range: Range = field(compare=False)
    accuracy: float | None = field(compare=False)

    def file(self, folder: Path) -> Path:
        """File of the model in a folder of results."""
        return folder / f"range_{self.mark[:16]}.npz"


def served_scene(scene: Scene) -> ServedScene | None:
    """Range that a scene asks for; None if it asks for none, or runs no reduced model.

    InputError if no load of the scene acts.
    """
    table = scene.reduction.range
    if table is None or "reduced" not in scene.models.run:
        return None
    middle = scene.model_copy(
        update={
            "joint": scene.changed(table.middle()).joint,
            "load": tuple(_in_the_middle(scene, table)),
        }
    )
    limits = table.limits(scene.joint)
    range_ = Range.of({"slip": table.slip, "frequency": table.frequency, "limits": limits})
    asked = scene.accuracy.displacement, scene.accuracy.energy and scene.accuracy.energy / 3.0
    accuracy = min((error for error in asked if error is not None), default=None)
    names = TABLES_OF_STRUCTURE | {"load"}
    content = middle.model_dump(mode="json", include=set(names), warnings=False)
    asked_for = range_, table.values(), scene.reduction.modes, accuracy, middle.output.points
    # A mesh is not assembled for what distinguishes it.
    identity = scene.structure().identity if scene.matrices else scene.named_mesh.identity
    mark = fingerprint(code_version(), content, asked_for, identity)
    return ServedScene(mark, middle, range_, accuracy)


def point_of(scene: Scene, model: System) -> System:
    """Point of a range model that a scene is.

    Raises
    ------
    InputError
        If the scene is outside the range, or a joint slips as a whole.
    """
    here = _place(scene, scene.cycle_period)
    return at(model, frequency=here.frequency, level=here.level, limits=here.limits)


def _place(scene: Scene, period: float | None) -> Point:
    """Place in its range of a scene whose loads have a ``period`` (s)."""
    table = scene.reduction.range
    if table is None or period is None:
        raise InputError("reduction.range: missing, or the loads have no common period")
    return Point(1.0 / period, _largest(scene), table.factors(scene.joint))


def of_scene(scene: Scene, model: System) -> System:
    """Model for the range of a scene, as if it were made of the scene itself.

    Level 1 is that of the scene's loads, and all factors on limits are 1 at its joints.

    Raises
    ------
    InputError
        If no load acts, or bolts of a joint have other factors than each other.
    """
    serves, joints = Served.by(model), model.contact.joints
    here = _place(scene, period_of(model))
    factors = here.factors(joints)
    limits = {
        name: (low / factor, high / factor)
        for name, factor, (low, high) in zip(
            joints, factors.tolist(), serves.range.of_joints(joints), strict=True
        )
    }
    changed = replace(
        serves,
        range=replace(serves.range, limits=limits),
        larger=placed(serves.larger, here),
        law=serves.law / here.mean_factor(joints),
        known=serves.known / np.concatenate([[1.0], factors, [here.level]]),
    )
    return replace(placed(model, here), serves=changed)


def model_in_range(scene: Scene, folder: Path | None) -> System | None:
    """Model for the range of a scene as by `of_scene`; None for a scene that has no range."""
    served = served_scene(scene)
    return None if served is None else of_scene(scene, range_model(served, folder))


@lru_cache(maxsize=1)
def range_model(served: ServedScene, folder: Path | None) -> System:
    """Reduced model for a range: loaded from a folder, or made and saved there.

    The latest one stays in the memory of the process.

    Raises
    ------
    InputError, ConvergenceError
        As `reduce`; InputError if the file in the folder is damaged.
    """
    path = None if folder is None else served.file(folder)
    if path is not None and path.exists():
        return system_files.load(path)
    _log.info("Making the reduced model for the range %s.", served.range)
    asked: dict[str, Any] = {} if served.accuracy is None else {"accuracy": served.accuracy}
    modes = served.middle.reduction.modes
    model = reduce(served.middle.system(), modes, range=served.range, **asked)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        system_files.save(model, path)
    return model


@lru_cache(maxsize=1)
def middle_of(served: ServedScene) -> Scene:
    """Scene in the middle of a range, kept in the memory of the process.

    All scenes of the range have its structure and full system, but for the size of limits and
    loads.
    """
    return served.middle


def make_missing(scenes: Iterable[Scene], folder: Path, progress: Progress = silent) -> int:
    """Make the models for the ranges of some scenes that are not in a folder; returns how many.

    InputError, ConvergenceError as `range_model`.
    """
    ranges = dict.fromkeys(filter(None, map(served_scene, scenes)))
    missing = [served for served in ranges if not served.file(folder).exists()]
    for done, served in enumerate(missing):
        progress("models for ranges", done, len(missing))
        range_model(served, folder)
    return len(missing)


def _largest(scene: Scene) -> float:
    """Largest amplitude of a harmonic of a load; InputError if all are zero."""
    harmonics = (part for load in scene.load for part in load.to_amplitude().harmonics)
    largest = max((abs(part.amplitude) for part in harmonics), default=0.0)
    if largest == 0.0:
        raise InputError("reduction.range: no load acts; give one an amplitude above 0")
    return largest


def _in_the_middle(scene: Scene, table: ServedRangeTable) -> Iterable[AnyLoad]:
    """Loads with the largest harmonic of 1 N, at the middle frequency of a range."""
    period, largest = scene.cycle_period, _largest(scene)
    if period is None:
        raise InputError("reduction.range: the loads have no common period")
    frequency = math.sqrt(table.frequency[0] * table.frequency[1])

    def moved(part: Any) -> dict[str, float]:
        amplitude = float(f"{part.amplitude / largest:.{_DIGITS}g}")
        return {"amplitude": amplitude, "frequency": round(part.frequency * period) * frequency}

    for load in scene.load:
        if isinstance(load, HarmonicLoad):
            yield load.model_copy(update=moved(load))
        elif isinstance(load, MultiHarmonicLoad):  # others were refused with the scene
            parts = tuple(part.model_copy(update=moved(part)) for part in load.components)
            yield load.model_copy(update={"components": parts})
