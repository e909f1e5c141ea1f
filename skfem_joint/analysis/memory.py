"""Memory that a scene's stored results and factors take, estimated before it is run."""

from __future__ import annotations

import math
from pathlib import Path

from skfem_joint.analysis.scene_plan import save_of
from skfem_joint.errors import InputError
from skfem_joint.linalg.schur import complement_bytes
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.scene import Scene
from skfem_joint.stepping.arrangement import MOST_DENSE, arranged
from skfem_joint.structure.active_set import SETTINGS as ACTIVE_SET
from skfem_joint.system import System

GIB = 2**30
#: Parts of the memory, and what makes each smaller.
CURES = {
    "histories of points": "a larger output.every, or output.history = false",
    "fields": "fewer output.frames, or output.vtk = false",
    "training run of the reduced model": 'reduction.reference = "static"',
    "mesh and factors": "a coarser mesh",
    "contact's own matrix": "fewer contact points",
}
# Entries of the factors of a step matrix for each unknown: share times this power of the unknowns,
# by dimension; measured.
_FILL = {1: (3.0, 0.0), 2: (10.0, 0.3), 3: (2.2, 2.0 / 3.0)}


def default_limit() -> float:
    """Bytes that a run may take: 80 % of what the system can give without swapping.

    Where the system does not say that, 4 GiB.
    """
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        amounts = dict(line.split(":", 1) for line in lines)
        return 0.8 * 1024 * int(amounts["MemAvailable"].split()[0])
    except (OSError, ValueError, KeyError):
        return 4.0 * GIB


def needed(scene: Scene) -> dict[str, int]:
    """Bytes that the large parts of a scene take, by the names in `CURES`.

    Stored arrays are counted; mesh and factors are estimated from the numbers of nodes and entries.
    """
    structure, system, save = scene.structure(), scene.system(), save_of(scene)
    n, rows, joints, loads = system.n, system.B.shape[0], len(system.joints), len(system.loads)
    body, models = structure.body, len(scene.models.run)
    nodes, dim = (structure.n_dofs, 3) if body is None else (body.n_nodes, body.dim)
    every, fields_every = save.strides
    # Of each model, and once more where they are compared, written or drawn.
    row = (models + 1) * (2 * len(system.points) + (3 if save.slips else 1) * joints + loads + 1)
    stored = scene.n_steps // every + 1 if save.points else 0
    frames = scene.n_steps // fields_every + 1 if save.fields else 0
    frame = models * (2 * n + 6 * rows + (4 * dim + 3) * nodes)
    training = 0
    if "reduced" in scene.models.run and scene.reduction.reference == "self":
        training = min(scene.n_steps, 3 * (scene.cycle_steps or scene.n_steps)) * (2 * n + 4 * rows)
    share, power = _FILL[dim]
    factorised = [n]
    if scene.bolt:  # a preload is solved for all nodes, and a small one keeps its factor
        factorised = [dim * nodes, *([n] if dim * nodes <= ACTIVE_SET.kept else [])]
    # Bytes of an entry with its index.
    factors = sum(24 * int(share * unknowns ** (1.0 + power)) for unknowns in factorised)
    factors += factors if "reduced" in scene.models.run and models > 1 else 0
    assembled = 1100 * nodes + 120 * structure.n_entries  # measured
    parts = 8 * stored * row, 8 * frames * frame, 8 * training, factors + assembled
    return dict(zip(CURES, (*parts, _of_contact(system)), strict=True))


def _of_contact(system: System) -> int:
    """Bytes of the matrices to which a step is condensed."""
    closed = system.closed()
    if closed.is_dense or not closed.contact_points or closed.n <= MOST_DENSE:
        return 0
    to = arranged(closed)
    if to.kind != "contact":
        return 0
    return complement_bytes(to.system.K, ContactPoints.of(to.system).limited)


def check(scene: Scene, limit: float) -> None:
    """Refuse a scene that needs more than ``limit`` bytes, or a limit that is not positive.

    The InputError says how much it needs, what takes it, and what takes less.
    """
    if not limit > 0.0:
        raise InputError(f"--memory-limit: found {limit / GIB:g} GiB, must be > 0")
    parts = needed(scene)
    total = sum(parts.values())
    if total <= limit:
        return
    large = [name for name in sorted(parts, key=lambda n: -parts[n]) if parts[name] > 0.1 * total]
    shown = ", ".join(f"{name} {size(parts[name])}" for name in large)
    raise InputError(
        f"memory: the run would need {size(total)} ({shown}), more than the {size(limit)} it may "
        f"take. Take {'; '.join(CURES[name] for name in large)}. Or raise --memory-limit"
    )


def size(amount: float) -> str:
    """Bytes as text, in a unit that suits the size."""
    power = min(3, max(1, int(math.log(max(amount, 1.0), 1024))))
    return f"{amount / 1024**power:.3g} {' KMG'[power]}iB"
