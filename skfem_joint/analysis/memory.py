"""Memory that a scene will need, estimated from its sizes before it is run."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.analysis.asked import options_of, save_of
from skfem_joint.errors import InputError
from skfem_joint.reduction import missing_modes
from skfem_joint.reduction.excitation import SHORT_RUNS
from skfem_joint.scene import Scene

GIB = 2**30
#: Share of the available memory that a run may take if nothing else is asked for.
SHARE = 0.8
#: Bound where the system does not say what is available, bytes.
FALLBACK = 4 * GIB

_POINTS, _FIELDS = "histories of points", "fields"  # parts that options of the output shrink
_NUMBER = 8  # bytes of a float
_OF_A_SCENE = 2**17  # bytes of what does not grow with anything
_OF_A_CYCLE = 800  # bytes of the works and peaks of a cycle: small arrays and what holds them
_OF_A_NODE = 1100  # bytes of mesh, order of unknowns and works arrays, while they are made
_OF_AN_ENTRY = 120  # bytes of what is assembled from, for each entry of an element's matrix
_OF_THE_FACTOR = 24  # bytes of an entry of the factors of a step matrix
# Entries of them for each unknown: share times this power of the unknowns, by dimension; measured.
_FILL = {1: (3.0, 0.0), 2: (10.0, 0.3), 3: (2.2, 2.0 / 3.0)}
_OF_MODES = 60  # vectors of the natural modes that are looked at, and what finds them
_MOST_TIMES = 300  # of a run that a decomposition takes
_PROBE_STEPS, _PROBE_NUMBERS = 400, 20_000_000  # of a cycle of a probe run; of what it stores
# States of static paths, with increments, in general and under one harmonic; preliminary steps.
_PATH_STATES, _PRELIMINARY_STEPS = (230, 40), 400


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


def needed(scene: Scene, like: Scene | None = None) -> dict[str, int]:
    """Estimate what a scene needs at its peak by what takes it, bytes, from above but not by far.

    ``like`` is one whose structure and system are the same, but built already.
    """
    structure, system = (like or scene).structure(), (like or scene).system()
    n, rows, named, loads = system.n, system.B.shape[0], len(system.points), len(system.loads)
    joints = len(system.joints)
    body, save = structure.body, save_of(scene)
    nodes, dim = (structure.n_dofs, 3) if body is None else (body.n_nodes, body.dim)
    models, reduced = len(scene.models.run), "reduced" in scene.models.run
    condensed = "condensed" in scene.models.run
    every, fields_every = save.strides

    stored = scene.n_steps // every + 1 if save.points else 0
    # Stored, and once more where they are compared or written; loads and times with each model.
    history = (models + 1) * (2 * named + joints) + (models + 2) * (loads + 1)
    history += 2 * (models + 1) * joints if save.slips else 0
    history += 20 if scene.output.plots else 0

    frames = scene.n_steps // fields_every + 1 if save.fields else 0
    # Stored, and written or drawn.
    frame = models * (2 * n + 6 * rows + (4 * dim + 3) * nodes)

    training = 0
    if reduced:
        cycle_steps = scene.cycle_steps or scene.n_steps
        steps = 1 + min(scene.n_steps, SHORT_RUNS.training_cycles * cycle_steps)
        if scene.reduction.reference == "paper":
            steps = 1 + SHORT_RUNS.cycles * min(cycle_steps, _PROBE_STEPS)
            steps = min(steps, _PROBE_NUMBERS // n + 2)
        kept, times = steps * (2 * n + 4 * rows), 2 * min(steps, _MOST_TIMES)
        if scene.reduction.reference == "static":
            single = [load.kind for load in scene.load] == ["harmonic"]
            times = _PATH_STATES[single]
            kept = min(steps, _PRELIMINARY_STEPS) * (2 * rows + 2 * min(n, 50))
        # Two histories and the friction, and a decomposition with its works arrays.
        training = kept + 4 * times * n
        training += min(times, n) * (times + 8 * min(times, n))

    # Load amplitudes are made for a chunk of steps at a time.
    states = loads * (3 * n + 6 * min(scene.n_steps, 20_000, 2_000_000 // n + 1))
    states += _OF_MODES * n
    estimated = 0
    if scene.accuracy.estimate:
        # A run with twice the step; of a reduced model residuals and their static response too.
        estimated = stored * (named + joints + loads + 1)
        if reduced or condensed:
            # Looks are whole runs where cycles never become alike; its own run is stored already.
            instants = missing_modes.SETTINGS.instants
            estimated += instants * (6 * n + 8 * rows) + stored * (7 * named + 2 * (loads + 1))
    if reduced:
        most = options_of(scene).mode_count * max(1, 2 * len(structure.joints)) + 20
        states += min(n, most) * (6 * min(n, most) + 6 * n + 4 * rows)
    kept = np.count_nonzero(system.on_rows(system.w)) + _OF_MODES if condensed else 0
    unknowns = _OF_A_SCENE + nodes * _OF_A_NODE + structure.n_entries * _OF_AN_ENTRY
    share, power = _FILL[dim]
    largest = dim * nodes if scene.bolt else n  # a preload is solved for all nodes
    factor = int(_OF_THE_FACTOR * share * largest ** (1.0 + power))
    factor += factor if reduced and models > 1 else 0  # that of the static path is kept
    cycle = _OF_A_CYCLE + 2 * _NUMBER * (2 * named + loads + joints)
    return {
        _POINTS: _NUMBER * (stored * history + estimated),
        _FIELDS: _NUMBER * frames * frame,
        "training run of the reduced model": _NUMBER * training,
        "condensed model": _NUMBER * kept * (2 * dim * nodes + 2 * n + 16 * kept),
        "unknowns": unknowns + factor + _NUMBER * states,
        "works of cycles": models * (scene.time.cycles or 0) * cycle,
    }


def check(scene: Scene, limit: float) -> None:
    """Refuse a scene that needs more than ``limit`` bytes, or a limit that is not positive.

    The InputError says how much it needs, what takes it, and the options that store less.
    """
    if not limit > 0.0:
        raise InputError(f"--memory-limit: found {limit / GIB:g} GiB, must be > 0")
    need = needed(scene)
    total = sum(need.values())
    if total <= limit:
        return
    largest = sorted(need, key=lambda name: -need[name])
    shown = [f"{name} {size(need[name])}" for name in largest if need[name] > 0.01 * total]
    savings = "; ".join(_savings(scene, need, limit)) or "use a coarser mesh"
    raise InputError(
        f"memory: the run would need {size(total)} ({', '.join(shown)}), more than the "
        f"{size(limit)} it may take. Store less: {savings}. Or raise --memory-limit"
    )


def _savings(scene: Scene, need: Mapping[str, int], limit: float) -> Iterator[str]:
    """Options that store less, each with what the run then needs."""
    output, whole = scene.output, sum(need.values())

    def fitting(part: int) -> float:
        """Factor by which a part must shrink for the run to fit, if it can."""
        room = limit - (whole - part)
        return 2.0 * part / room if room > 0.02 * part else 100.0

    every = min(scene.n_steps, math.ceil(output.every * fitting(need[_POINTS])))
    frames = max(1, int(min(output.frames, scene.n_steps) / fitting(need[_FIELDS])))
    options: list[tuple[str, str, Any]] = [
        ("output", "every", every),
        ("output", "history", False),
        ("output", "plots", False),
        ("output", "frames", frames),
        ("output", "vtk", False),
        ("reduction", "reference", "static"),
    ]
    for table, key, value in options:
        changes: Any = {table: {key: value}}
        total = sum(needed(scene.changed(**changes), scene).values())
        if total < 0.98 * whole:
            yield f"{table}.{key} = {json.dumps(value)} needs {size(total)}"


def size(amount: float) -> str:
    """Bytes in a unit that reads well."""
    power = 3 if amount >= GIB else 2 if amount >= 2**20 else 1
    return f"{amount / 1024**power:.3g} {' KMG'[power]}iB"
