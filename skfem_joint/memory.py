"""Memory that a scene will need, estimated before anything is computed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.errors import InputError
from skfem_joint.results import save_of
from skfem_joint.scene import AnyScene, PlateScene, Scene
from skfem_joint.scene_checks import vertices

GIB = 2**30
#: Share of the available memory that a run may take if nothing else is asked for.
SHARE = 0.8
#: Bound where the system does not say what is available, bytes.
FALLBACK = 4 * GIB

_NUMBER = 8  # bytes of a float
_OF_A_CYCLE = 800  # bytes of the works and peaks of a cycle: small arrays and what holds them
_OF_A_NODE = 900  # bytes of mesh, matrices, chain hierarchy and works arrays, while they are made
# Bytes of what a plate's element is assembled from, for each entry of its matrix.
_OF_AN_ENTRY = 120
# Entries of a factor of a plate's step matrix, over unknowns times their logarithm to base 2.
_FILL = 12


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


@dataclass(frozen=True)
class _Size:
    """Sizes that the need for memory comes from.

    Attributes
    ----------
    n, m, rows : int
        Unknowns, contact points and their directions of slip.
    picture : int
        Numbers of a frame of a model that is written for ParaView or drawn, beside the stored ones.
    columns : int
        Histories of the named points and loads.
    unknowns : int
        Mesh, matrices, their factors and works arrays, bytes.
    order : int
        Unknowns of a reduced model, at most.
    """

    n: int
    m: int
    rows: int
    picture: int
    columns: int
    unknowns: int
    order: int


def _size_of_bar(scene: Scene) -> _Size:
    bar = scene.bar
    nodes = int(bar.mesh.p.shape[1])
    held = {bar.points[name] for name in scene.support.fixed}
    n = nodes - len(held)
    in_joints = [bar.region_nodes(joint.region) for joint in scene.joint]
    m = int(np.unique(np.concatenate(in_joints)).size) if in_joints else 0
    order = min(n, scene.reduction.modes * max(1, 2 * len(scene.joint)) + 20)
    # Pictures are on all nodes (displacement, velocity, force, state), beside what is stored.
    picture = 7 * nodes - 2 * n + 2 * m
    return _Size(n, m, m, picture, len(scene.output_points), nodes * _OF_A_NODE, order)


def _size_of_plate(scene: PlateScene) -> _Size:
    plate = scene.plate
    mesh, corners = plate.mesh, int(plate.mesh.t.shape[0])
    elements = int(mesh.t.shape[1])
    second, square = plate.order == 2, corners == 4
    nodes = int(mesh.p.shape[1]) + second * (int(mesh.facets.shape[1]) + square * elements)
    m = rows = 0
    for joint in scene.joint:
        points = vertices(plate, joint.name).size
        if joint.kind == "region":
            inside = plate.regions[joint.name]
            edges = np.unique(mesh.t2f[:, inside]).size
            points += second * (edges + square * inside.size)
            rows += 2 * points
        else:
            points += second * plate.boundaries[joint.name].size
            rows += points
        m += points
    n = 2 * nodes
    of_element = 2 * ((9 if square else 2 * corners) if second else corners)
    unknowns = elements * of_element**2 * _OF_AN_ENTRY
    unknowns += int(24 * _FILL * n * math.log2(n))
    columns = 2 * len(scene.output_points) + len(scene.load)
    order = min(n, 2 * scene.reduction.modes * max(1, len(scene.joint)) + 20)
    return _Size(n, m, rows, 9 * nodes + 4 * rows, columns, unknowns, order)


def needed(scene: AnyScene) -> Need:
    """Estimate what a scene needs, from above but not by far."""
    output = scene.output
    sizes = _size_of_plate(scene) if isinstance(scene, PlateScene) else _size_of_bar(scene)
    n = sizes.n
    models, loads = len(scene.models.run), len(scene.load)
    reduced = "reduced" in scene.models.run
    save = save_of(scene)
    every, fields_every = save.strides

    rows = scene.n_steps // every + 1 if save.points else 0
    columns = 2 * sizes.columns
    # Stored, and once more where they are compared or written; loads and times with each model.
    points = rows * _NUMBER * ((models + 1) * columns + (models + 2) * (loads + 1))
    if output.plots:
        points += 20 * rows * _NUMBER

    fields = 0
    if save.fields:
        # Stored, and drawn.
        of_frame = 2 * n + sizes.rows + sizes.m + sizes.picture
        fields = (scene.n_steps // fields_every + 1) * _NUMBER * models * of_frame

    training = 0
    is_plate = isinstance(scene, PlateScene)
    if reduced and (is_plate or scene.reduction.reference == "self"):
        steps = scene.n_steps
        if scene.time.cycles is not None:
            steps = min(steps, 3 * scene.time.steps_per_cycle)
        # Two histories and the friction, both stacked, and a decomposition with its works arrays.
        snapshots = 2 * (steps + 1)
        smaller = min(snapshots, n)
        stored = (steps + 1) * (2 * n + 3 * sizes.rows + sizes.m)
        decomposed = 3 * snapshots * n + smaller * (snapshots + 8 * smaller)
        training = _NUMBER * (stored + decomposed)
        if scene.reduction.inner_product == "mass" and not is_plate:
            training += 3 * _NUMBER * n * n

    # Load amplitudes are made for a chunk of steps at a time.
    chunk = min(scene.n_steps, 20_000, 2_000_000 // n + 1)
    unknowns = sizes.unknowns + _NUMBER * loads * (3 * n + 6 * chunk)
    if reduced:
        unknowns += _NUMBER * sizes.order * (6 * sizes.order + 6 * n + 4 * sizes.rows)
    cycles = models * (scene.time.cycles or 0) * (_OF_A_CYCLE + 2 * _NUMBER * (columns + loads))
    return Need(points, fields, training, unknowns, cycles)


def check(scene: AnyScene, limit: float) -> Need:
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


def _savings(scene: AnyScene, need: Need, limit: float) -> list[tuple[str, int]]:
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
