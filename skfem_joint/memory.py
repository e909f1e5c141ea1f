"""Memory that a scene will need, estimated before anything is computed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.errors import InputError
from skfem_joint.scene import Scene
from skfem_joint.study import save_of

GIB = 2**30
#: Share of the available memory that a run may take if nothing else is asked for.
SHARE = 0.8
#: Bound where the system does not say what is available, bytes.
FALLBACK = 4 * GIB

_NUMBER = 8  # bytes of a float
_OF_A_CYCLE = 800  # bytes of the works and peaks of a cycle: small arrays and what holds them
_OF_A_NODE = 900  # bytes of mesh, matrices, chain hierarchy and works arrays, while they are made


@dataclass(frozen=True)
class Need:
    """Bytes that a scene needs at its peak, by what takes them.

    Attributes
    ----------
    points : int
        Histories of named points and loads, their comparison and their plots.
    fields : int
        Fields of the frames, and what the ParaView series is written from.
    training : int
        Every step of the run that a reduced model's modes come from, and their decomposition.
    unknowns : int
        Mesh, matrices, hierarchy of chains and states.
    cycles : int
        Works and peaks by cycle.
    """

    points: int
    fields: int
    training: int
    unknowns: int
    cycles: int

    @property
    def total(self) -> int:
        """Sum of all, bytes."""
        return self.points + self.fields + self.training + self.unknowns + self.cycles


def available() -> int | None:
    """Memory that the system can give without swapping, bytes; None if it does not say."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        amounts = dict(line.split(":", 1) for line in lines)
        return 1024 * int(amounts["MemAvailable"].split()[0])
    except (OSError, ValueError, KeyError):
        return None


def default_limit() -> float:
    """Bound on what a run may take, bytes."""
    free = available()
    return FALLBACK if free is None else SHARE * free


def needed(scene: Scene) -> Need:
    """Estimate what a scene needs, from above but not by far."""
    bar, output = scene.bar, scene.output
    nodes = int(bar.mesh.p.shape[1])
    held = {bar.points[name] for name in scene.support.fixed}
    n = nodes - len(held)
    in_joints = [bar.region_nodes(joint.region) for joint in scene.joint]
    m = int(np.unique(np.concatenate(in_joints)).size) if in_joints else 0
    models, loads = len(scene.models.run), len(scene.load)
    reduced = "reduced" in scene.models.run
    save = save_of(scene)
    every, fields_every = save.strides

    rows = scene.n_steps // every + 1 if save.points else 0
    columns = 2 * len(scene.output_points)
    # Stored, and once more where they are compared or written; loads and times with each model.
    points = rows * _NUMBER * ((models + 1) * columns + (models + 2) * (loads + 1))
    if output.plots:
        points += 20 * rows * _NUMBER

    fields = 0
    if save.fields:
        # Stored, on all nodes (displacement, velocity, force, state), and a model's modes expanded.
        fields = (scene.n_steps // fields_every + 1) * _NUMBER * models * (7 * nodes + 3 * m)

    training = 0
    if reduced and scene.reduction.reference == "self":
        steps = scene.n_steps
        if scene.time.cycles is not None:
            steps = min(steps, 3 * scene.time.steps_per_cycle)
        # Two histories and the friction, both stacked, and a decomposition with its works arrays.
        snapshots = 2 * (steps + 1)
        smaller = min(snapshots, n)
        training = _NUMBER * (
            (steps + 1) * (2 * n + 3 * m) + 3 * snapshots * n + smaller * (snapshots + 8 * smaller)
        )
        if scene.reduction.inner_product == "mass":
            training += 3 * _NUMBER * n * n

    # Load amplitudes are made for a chunk of steps at a time.
    chunk = min(scene.n_steps, 20_000, 2_000_000 // n + 1)
    unknowns = nodes * _OF_A_NODE + _NUMBER * loads * (3 * n + 6 * chunk)
    if reduced:
        order = min(n, scene.reduction.modes * max(1, 2 * len(scene.joint)) + 20)
        unknowns += _NUMBER * order * (6 * order + 6 * n + 4 * m)
    cycles = models * (scene.time.cycles or 0) * (_OF_A_CYCLE + 2 * _NUMBER * (columns + loads))
    return Need(points, fields, training, unknowns, cycles)


def check(scene: Scene, limit: float) -> Need:
    """Refuse a scene that needs more than ``limit`` bytes.

    Raises
    ------
    InputError
        If it does: how much it needs, what takes it, and the options that store less. Or the
        limit is not positive.
    """
    if not limit > 0.0:
        raise InputError(f"--memory-limit: found {limit / GIB:g} GiB, must be > 0")
    need = needed(scene)
    if need.total <= limit:
        return need
    parts = {
        "histories of points": need.points,
        "fields": need.fields,
        "training run of the reduced model": need.training,
        "unknowns": need.unknowns,
        "works of cycles": need.cycles,
    }
    largest = sorted(parts.items(), key=lambda part: -part[1])
    shown = ", ".join(f"{name} {size(part)}" for name, part in largest if part > 0.01 * need.total)
    savings = "; ".join(
        f"{option} needs {size(total)}" for option, total in _savings(scene, need, limit)
    )
    raise InputError(
        f"memory: the run would need {size(need.total)} ({shown}), more than the {size(limit)} it "
        f"may take. Store less: {savings or 'use a coarser mesh'}. Or raise --memory-limit"
    )


def _savings(scene: Scene, need: Need, limit: float) -> list[tuple[str, int]]:
    """Options that store less, each with what the run then needs, bytes."""
    output = scene.output

    def fitting(part: int) -> float:
        """Factor by which a part must shrink for the run to fit, if it can."""
        room = limit - (need.total - part)
        return 2.0 * part / room if room > 0.02 * part else 100.0

    def changed(table: str, **values: Any) -> int:
        options = getattr(scene, table).model_copy(update=values)
        return needed(scene.model_copy(update={table: options})).total

    every = min(scene.n_steps, math.ceil(output.every * fitting(need.points)))
    frames = max(1, int(min(output.frames, scene.n_steps) / fitting(need.fields)))
    candidates = [
        (f"output.every = {every}", changed("output", every=every)),
        ("output.history = false", changed("output", history=False)),
        ("output.plots = false", changed("output", plots=False)),
        (f"output.frames = {frames}", changed("output", frames=frames)),
        ("output.vtk = false", changed("output", vtk=False)),
        ('reduction.reference = "paper"', changed("reduction", reference="paper")),
    ]
    return [(option, total) for option, total in candidates if total < 0.98 * need.total]


def size(amount: float) -> str:
    """Bytes in a unit that reads well."""
    unit, name = next(
        ((unit, name) for unit, name in ((GIB, "GiB"), (2**20, "MiB")) if amount >= unit),
        (2**10, "KiB"),
    )
    return f"{amount / unit:.3g} {name}"
