"""Fig. 18(a) beside Fig. 18(b): what the simplified model of the jointed structure leaves out.

    python examples/two_plates.py

(a) Two plates of 700 x 50 x 10 mm overlap by 200 mm and are pressed on each other; their far ends
are pulled apart. (b) The paper's model of one half: a plate of 600 mm, held in the middle of the
joint, its last 100 mm pressed on a rigid base. Both as struts, as plates in plan view (friction
over an area), and from the side (friction along an edge, with bending). Beside them a model of one
half that is exact for struts, of the half of the slip z and the mean m of both displacements,

    2 rho A z'' - (2 E A z_x)_x + 2 tau sigma(2 z') = 0,   2 rho A m'' - (2 E A m_x)_x = 0,

a bar with friction of twice the section, free in the middle of the joint, in series with a bar
without, held there; the plate beside the joint ends at z + m. See ``two_plates.md``.

Units: SI. Source: Journal of Sound and Vibration (2010), sections 7.3 and 7.4.
"""

# %% Models
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh

from skfem_joint.active_length import THRESHOLD, measured
from skfem_joint.history import slip_state
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic, Load, Triangle
from skfem_joint.meshing import BarMesh, build_bar
from skfem_joint.plate import (
    PlateJoint,
    PlateStructure,
    assemble_plate,
    build_plate_structure,
    full_matrices,
)
from skfem_joint.plate_mesh import PlateMesh, build_plate, load_meshes
from skfem_joint.recording import Run, Save
from skfem_joint.structure import Joint, Structure, assemble, build_structure
from skfem_joint.system import System
from skfem_joint.two_bars import TwoBars, assemble_two_bars

MESHES = Path(__file__).parents[1] / "meshes"
E, DENSITY, WIDTH, THICKNESS = 200e9, 8000.0, 0.05, 0.01
PRESSURE, FRICTION = 50e6, 0.7
FORCE, FREQUENCY = 87.5e3, 500.0
ARM, HALF = 0.5, 0.1  # length beside the joint and half of the overlap, m
EA, TAU = E * WIDTH * THICKNESS, FRICTION * PRESSURE * WIDTH
PULL = Harmonic(FORCE, FREQUENCY)
STEPS = 100  # per period
PULSE, PULSE_STEP = 2e-3, 4e-6  # time after the impulse, and its step, s


@dataclass(frozen=True)
class Model:
    """A model of the whole structure or of one half.

    Attributes
    ----------
    name : str
    system : System
        Its first point is the loaded end, positive outwards.
    distance : ndarray
        Of each contact point from the joint's end where the force comes in, m.
    halves : int
        1 or 2: how many halves of the joint it holds.
    middle : str, optional
        Point in the middle of the joint, if that can move.
    structure : PlateStructure, optional
    """

    name: str
    system: System
    distance: np.ndarray
    halves: int
    middle: str | None = None
    structure: PlateStructure | None = None

    def end_history(self, run: Run) -> np.ndarray:
        """Displacement of the loaded end against the middle of the joint, m."""
        middle = 0.0 if self.middle is None else run.point(self.middle)
        return run.point_u[:, 0] - middle


def bar(mesh: BarMesh, joint: str = "", at: float = 0.0, **changes: Any) -> Structure:
    values = {
        "E": E, "density": DENSITY, "width": WIDTH, "thickness": THICKNESS, "fixed": [],
        "joints": [Joint(joint, PRESSURE, FRICTION)] if joint else [], "stiffness_damping": 1e-5,
    }  # fmt: skip
    placed = replace(mesh, coordinates=mesh.coordinates + np.array([at, 0.0, 0.0]))
    return build_structure(placed, **{**values, **changes})


def strut_b(elements: int = 50, arm: int = 50) -> Model:
    """Fig. 18(b): held at the cut, pressed on a rigid base."""
    parts = [("joint", HALF, elements), ("arm", ARM, arm)]
    points = {"cut": 0.0, "edge": HALF, "end": HALF + ARM}
    structure = bar(build_bar(parts, points), "joint", fixed=["cut"])
    distance = HALF - structure.position[structure.joint_nodes(structure.joints[0])]
    return Model("(b) strut", assemble(structure, [("end", PULL)], ["end", "edge"]), distance, 1)


def strut_a(elements: int = 50, arm: int = 50, held: bool = False) -> Model:
    """Fig. 18(a): both ends pulled, or one held and one pulled."""
    points = {"upper_end": 0.0}
    upper = build_bar([("upper_arm", ARM, arm), ("upper_joint", 2 * HALF, 2 * elements)], points)
    points = {"middle": HALF, "edge": 2 * HALF, "end": 2 * HALF + ARM}
    lower = build_bar([("lower_joint", 2 * HALF, 2 * elements), ("lower_arm", ARM, arm)], points)
    bars = TwoBars(
        bar(upper, "upper_joint", at=-ARM, fixed=["upper_end"] if held else []),
        bar(lower),
        {"upper_joint": "lower_joint"},
    )
    loads: list[tuple[str, Load]] = [("end", PULL)]
    if not held:
        loads.append(("upper_end", Harmonic(-FORCE, FREQUENCY)))
    system = assemble_two_bars(bars, loads, ["end", "edge", "middle"])
    distance = 2 * HALF - bars.upper.bar.coordinates[bars.nodes, 0]
    name = "(a) struts, one end held" if held else "(a) struts"
    return Model(name, system, distance, 2, "middle" if held else None)


def strut_in_series(elements: int = 50, arm: int = 50) -> Model:
    """One half of (a), exactly: a bar with friction and one without in series."""
    mesh = build_bar([("joint", HALF, elements)], {"side": 0.0, "middle": HALF})
    slip = assemble(bar(mesh, "joint", width=2 * WIDTH), points=[])
    mean = assemble(bar(mesh, width=2 * WIDTH, fixed=["middle"]), points=[])
    end = assemble(bar(build_bar([("arm", ARM, arm)], {"end": 0.0})), [("end", PULL)])
    parts = (end, slip, mean)
    n, k = end.n - 1, slip.n
    size = n + k + mean.n
    join = sparse.csr_array((np.ones(2), ([0, 0], [n, n + k])), shape=(1, size))
    G = sparse.vstack([sparse.eye_array(n, size), join, sparse.eye_array(size - n, size, k=n)])

    def total(name: str) -> sparse.csr_array:
        matrix = sparse.block_diag([getattr(part, name) for part in parts])
        return sparse.csr_array(G.T @ matrix @ G)

    rows = sparse.vstack([sparse.eye_array(1, size), join], format="csr")
    system = System(
        M=total("M"), C=total("C"), K=total("K"),
        B=sparse.eye_array(k, size, k=n, format="csr"), w=slip.w, beta=2.0 * slip.beta,
        loads=(replace(end.loads[0], vector=np.eye(1, size)[0]),), P=rows, points=("end", "edge"),
    )  # fmt: skip
    return Model("(a) one half, in series", system, mesh.mesh.p[0], 1)


def plates(
    plate: PlateMesh,
    joint: PlateJoint,
    supports: Sequence[tuple[str, str]],
    points: dict[str, tuple[float, float]],
    thickness: float,
) -> PlateStructure:
    """Structure with some vertices named, each of the body whose vertices come last."""
    p = plate.mesh.p.T
    named = {}
    for name, place in points.items():
        near = np.linalg.norm(p - np.array(place), axis=1)
        named[name] = int(np.flatnonzero(near < 1e-9)[-1])
    return build_plate_structure(
        replace(plate, points=named), E=E, poisson=0.3, density=DENSITY, thickness=thickness,
        supports=supports, joints=[joint], stiffness_damping=1e-5,
    )  # fmt: skip


def plate_b(side: bool = False, along: int = 40, arm: int = 50, across: int = 8) -> Model:
    """Fig. 18(b) in plan view, or from the side."""
    height, thickness = (THICKNESS, WIDTH) if side else (WIDTH, THICKNESS)
    edge = {"cut": "left", "end": "right"}
    base = {"joint": ("bottom", "foot")} if side else {}
    strip = "foot" if side else "joint"
    mesh = build_plate(
        [(strip, HALF, along), ("arm", ARM, arm)], height, across, boundaries={**edge, **base}
    )
    joint = PlateJoint("joint", "boundary" if side else "region", None, PRESSURE, FRICTION)
    supports = [("cut", "x"), ("end", "y") if side else ("centre", "y")]
    points = {} if side else {"centre": (0.0, 0.5 * WIDTH)}
    structure = plates(mesh, joint, supports, points, thickness)
    system = assemble_plate(structure, [("end", (1.0, 0.0), PULL)], [])
    distance = HALF - structure.nodes[structure.patches[0].nodes, 0]
    name = f"(b) plate, {'side' if side else 'plan'}"
    return Model(name, system, distance, 1, structure=structure)


def plate_a(side: bool = False) -> Model:
    """Fig. 18(a) in plan view, or from the side, pulled at both ends.

    The pulls are in balance: what holds the structure takes no force but, from the side, that of
    the couple which they make.
    """
    mesh = load_meshes([MESHES / f"two_plates{'_side' if side else ''}.msh"])
    if side:
        joint = PlateJoint("upper_contact", "boundary", "lower_contact", PRESSURE, FRICTION)
        supports = [("middle", "x"), ("upper_end", "y"), ("lower_end", "y")]
        points = {"middle": (ARM + HALF, THICKNESS)}
    else:
        joint = PlateJoint("upper_joint", "region", "lower_joint", PRESSURE, FRICTION)
        supports = [("middle", "xy"), ("far", "y")]
        axis = 0.5 * WIDTH
        points = {"middle": (ARM + HALF, axis), "far": (2 * (ARM + HALF), axis)}
    structure = plates(mesh, joint, supports, points, WIDTH if side else THICKNESS)
    pulls = [("lower_end", (1.0, 0.0), PULL), ("upper_end", (-1.0, 0.0), PULL)]
    distance = ARM + 2 * HALF - structure.nodes[structure.patches[0].nodes, 0]
    name = f"(a) plates, {'side' if side else 'plan'}"
    return Model(name, assemble_plate(structure, pulls, []), distance, 2, structure=structure)


# %% What is measured
def with_amplitudes(system: System, change: Callable[[float], Load]) -> System:
    """The same system under other loads, given by their largest force."""
    loads = (replace(a, amplitude=change(a.amplitude.amplitude)) for a in system.loads)
    return replace(system, loads=tuple(loads))


def slip_along(model: Model, run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the joint's loaded edge (m), and the largest slip there (m)."""
    place = np.round(model.distance, 9)
    x = np.unique(place)
    return x, np.array([run.slip_peak[place == value].max() for value in x])


def active_lengths(model: Model, run: Run) -> tuple[float, float]:
    """Lengths that slip, from the joint's loaded edge inwards and from its other edge, m."""
    x, slip = slip_along(model, run)
    length = x[-1] + x[0]
    return measured(x, slip), measured(length - x[::-1], slip[::-1]) if model.halves == 2 else 0.0


def resonance(model: Model, run: Run | None = None) -> float:
    """Frequency of the linear mode that does most for the static response to the load, Hz.

    What slips in the run moves freely, the rest of the joint is held, as in the paper's "length of
    the structure experiencing displacement"; without a run nothing slips.
    """
    system = model.system
    slips = np.zeros(system.w.size, dtype=bool)
    if run is not None:
        slips = run.slip_peak > THRESHOLD * run.slip_peak.max()
    held = sparse.csr_array(system.B).indices[~np.repeat(slips, system.directions)]
    free = np.setdiff1d(np.arange(system.n), held)
    K, M = (sparse.csc_array(A)[free][:, free] for A in (system.K, system.M))
    squares, modes = eigsh(K, 40, M, sigma=-((2 * np.pi * 10.0) ** 2))
    load = sum(load.vector * np.sign(load.amplitude.amplitude) for load in system.loads)[free]
    elastic = squares > 1.0  # free bars have a rigid motion, which these loads leave alone
    share = (modes.T @ load)[elastic] ** 2 / squares[elastic]
    return float(np.sqrt(squares[elastic][np.argmax(share)]) / (2 * np.pi))


@dataclass(frozen=True)
class Result:
    """Runs of one model: 500 Hz with the paper's law and with Coulomb's, and an impulse."""

    model: Model
    harmonic: Run
    coulomb: Run
    pulse: Run

    @property
    def end(self) -> np.ndarray:
        """Displacement of the loaded end in the last period, m."""
        return self.model.end_history(self.harmonic)[-STEPS - 1 :]

    @property
    def pulse_end(self) -> np.ndarray:
        return self.model.end_history(self.pulse)

    def friction(self, run: Run) -> float:
        """Of one half of the joint: in the last period, or in all without periods, J."""
        periods = run.cycles.friction
        total = periods[-1] if periods.size else run.friction_work.sum()
        return float(total) / self.model.halves


def run_all(model: Model, cycles: int = 4, save: Save | None = None) -> Result:
    """Run a model from rest; an impulse that rises in 40 us to the force of the harmonic load."""
    timing = {"step": 1.0 / FREQUENCY / STEPS, "n_steps": cycles * STEPS, "cycle_steps": STEPS}
    pulled = with_amplitudes(model.system, lambda force: Triangle(force, 4e-5))
    return Result(
        model,
        integrate(model.system, save=save, **timing),
        integrate(model.system.with_beta(np.inf), **timing),
        integrate(pulled, step=PULSE_STEP, n_steps=round(PULSE / PULSE_STEP)),
    )


def slow(model: Model) -> Run:
    """Two periods at 5 Hz with Coulomb friction: no inertia."""
    system = with_amplitudes(model.system, lambda force: Harmonic(force, 5.0)).with_beta(np.inf)
    return integrate(system, step=1e-3, n_steps=400, cycle_steps=200)


def difference(history: np.ndarray, reference: np.ndarray) -> float:
    """Largest difference of two histories over the reference's largest value."""
    return float(np.abs(history - reference).max() / np.abs(reference).max())


def opening(model: Model, run: Run) -> tuple[float, np.ndarray]:
    """Largest displacement across (m), and pull on each contact node beside the clamping (Pa).

    The pull is what holds the contact closed: elastic, damping and inertia forces across it. Nodes
    in order along the joint.
    """
    structure = model.structure
    assert structure is not None
    (patch,) = structure.patches
    M, K = full_matrices(structure)
    u, v = (structure.expand(field).reshape(len(run.u), -1) for field in (run.u, run.v))
    a = np.gradient(v, run.field_times, axis=0)
    forces = (K @ (u + structure.stiffness_damping * v).T + M @ a.T).T
    pull = -forces[:, 2 * patch.nodes + 1] / patch.area
    order = np.argsort(structure.nodes[patch.nodes, 0])
    return float(np.abs(u[:, 1::2]).max()), pull.max(axis=0)[order]


# %% Tables and pictures
def print_slow(runs: dict[str, tuple[Model, Run]]) -> None:
    print(f"Slow load of {FORCE / 1e3:g} kN (5 Hz), Coulomb: computed | closed form")
    print(f"{'':24}{'end, um':>19}{'edge, um':>19}{'J per half':>19}{'active, mm':>19}")
    edge = {"(b)": FORCE**2 / (2 * EA * TAU)}
    edge["(a)"] = FORCE * HALF / (2 * EA) + FORCE**2 / (8 * EA * TAU)
    loss = {"(b)": 2 * FORCE**3 / (3 * EA * TAU), "(a)": FORCE**3 / (6 * EA * TAU)}
    for name, (model, run) in runs.items():
        which = name[:3]
        exact = (
            1e6 * (edge[which] + FORCE * ARM / EA), 1e6 * edge[which], loss[which],
            1e3 * FORCE / (TAU if which == "(b)" else 2 * TAU),
        )  # fmt: skip
        found = (
            *(1e6 * run.cycles.peak[-1, :2]), run.cycles.friction[-1] / model.halves,
            1e3 * active_lengths(model, run)[0],
        )  # fmt: skip
        cells = (f"{a:9.2f} |{b:8.2f}" for a, b in zip(found, exact, strict=True))
        print(f"{name:24}" + "".join(cells))


def print_dynamic(results: dict[str, Result]) -> None:
    reference = results["(a) struts"]
    print(f"\n{FORCE / 1e3:g} kN at {FREQUENCY:g} Hz, last period; impulse, {1e3 * PULSE:g} ms")
    titles = (
        ("unknowns", 9), ("stuck, Hz", 10), ("Hz", 6), ("end, um", 8), ("J per half", 11),
        ("Coulomb", 8), ("active, mm", 11), ("history", 9), ("| end, um", 10), ("J per half", 11),
        ("history", 9),
    )  # fmt: skip
    print(" " * 26 + "".join(f"{title:>{width}}" for title, width in titles))
    for name, result in results.items():
        a, b = active_lengths(result.model, result.coulomb)
        cells = (
            f"{result.model.system.n}",
            f"{resonance(result.model):.0f}",
            f"{resonance(result.model, result.coulomb):.0f}",
            f"{1e6 * np.abs(result.end).max():.1f}",
            f"{result.friction(result.harmonic):.3f}",
            f"{result.friction(result.coulomb):.3f}",
            f"{1e3 * a:.1f}" + (f" {1e3 * b:.1f}" if b else ""),
            f"{100 * difference(result.end, reference.end):.1f} %",
            f"| {1e6 * np.abs(result.pulse_end).max():.1f}",
            f"{result.friction(result.pulse):.3f}",
            f"{100 * difference(result.pulse_end, reference.pulse_end):.1f} %",
        )
        columns = zip(cells, titles, strict=True)
        print(f"{name:26}" + "".join(f"{cell:>{width}}" for cell, (_, width) in columns))


def draw(path: Path, slow_runs: dict[str, tuple[Model, Run]], results: dict[str, Result]) -> None:
    """Histories, the loop of the joint, and slip along it."""
    from matplotlib.figure import Figure

    styles: dict[str, dict[str, Any]] = {
        "(b) strut": {"color": "#b03a00", "lw": 1.8, "ls": "--"},
        "(a) struts": {"color": "#7fb2e5", "lw": 4.0},
        "(a) one half, in series": {"color": "#1a1a1a", "lw": 1.3, "ls": ":"},
        "(a) plates, plan": {"color": "#1f3f7f", "lw": 1.3, "ls": "-."},
        "(a) plates, side": {"color": "#2e7d32", "lw": 1.1},
    }
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    (harmonic, pulse), (loop, slip) = figure.subplots(2, 2)
    for name, style in styles.items():
        result = results[name]
        harmonic.plot(1e3 * result.harmonic.times, 1e6 * result.model.end_history(result.harmonic),
                      label=name, **style)  # fmt: skip
        pulse.plot(1e3 * result.pulse.times, 1e6 * result.pulse_end, **style)
        if name != "(a) one half, in series":  # its slip is half of that between the plates
            x, largest = slip_along(result.model, result.coulomb)
            slip.plot(1e3 * x, 1e6 * largest, **style)
        if name in slow_runs:
            run = slow_runs[name][1]
            loop.plot(1e6 * run.point("edge")[-201:], 1e-3 * run.amplitudes[-201:, 0], **style)
    harmonic.set(xlabel="time, ms", ylabel="displacement of the loaded end, µm",
                 title="87.5 kN at 500 Hz")  # fmt: skip
    pulse.set(xlabel="time, ms", ylabel="displacement of the loaded end, µm",
              title="impulse of 87.5 kN")  # fmt: skip
    loop.set(xlabel="displacement of the joint's edge against its middle, µm", ylabel="load, kN",
             title="loop of the joint, 5 Hz")  # fmt: skip
    slip.set(xlabel="distance from the joint's loaded edge, mm", ylabel="largest slip, µm",
             title="slip along the joint, 500 Hz, Coulomb")  # fmt: skip
    for panel in (harmonic, pulse, loop, slip):
        panel.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=5, frameon=False)
    figure.savefig(path, dpi=120)


def write_paraview(path: Path, model: Model, run: Run) -> None:
    """Both plates as blocks, with slip state, traction and friction work."""
    from skfem_joint.plate_vtk import LoadHistory, PlateField, write_load, write_series

    structure, system = model.structure, model.system
    assert structure is not None
    (patch,) = structure.patches
    stored = slice(None, None, 4)
    u, v, sigma = run.u[stored], run.v[stored], run.sigma[stored]
    frames, count = len(u), structure.n_nodes
    field = PlateField(
        "full", structure.expand(u), structure.expand(v), np.zeros((frames, count, 2)),
        np.full((frames, count), -1, dtype=np.int8), np.zeros((frames, count)),
    )  # fmt: skip
    limit = FRICTION * (patch.normal_force / patch.area)[:, np.newaxis]
    field.traction[:, patch.nodes] = -limit * sigma.reshape(frames, -1, 2)
    field.slip_state[:, patch.nodes] = slip_state(system.slip_norm((system.B @ v.T).T), system.beta)
    field.friction_work[:, patch.nodes] = run.friction_work_rows[stored] / patch.area
    pressure = np.zeros(count)
    pressure[patch.nodes] = patch.normal_force / patch.area
    write_series(path, structure, run.field_times[stored], [field], pressure)
    write_load(path, LoadHistory(run.times, {"lower_end": run.amplitudes[:, 0]}))


def main(folder: Path) -> None:
    begin = time.perf_counter()
    folder.mkdir(parents=True, exist_ok=True)
    struts = (strut_b(), strut_a(), strut_in_series())
    slow_runs = {model.name: (model, slow(model)) for model in struts}
    print_slow(slow_runs)
    results = {model.name: run_all(model) for model in struts}
    strong = with_amplitudes(struts[1].system, lambda force: Harmonic(2 * force, FREQUENCY))
    twice = run_all(replace(struts[1], system=strong))
    held = strut_a(held=True)
    results[held.name] = run_all(held, cycles=12)
    for model in (plate_b(), plate_a(), plate_b(side=True), plate_a(side=True)):
        results[model.name] = run_all(model, save=Save(fields=model.halves == 2))
    print_dynamic(results)
    print(
        f"(a) struts under {2e-3 * FORCE:g} kN, as (b) half of what friction can hold: end "
        f"{1e6 * np.abs(twice.end).max():.1f} um, {twice.friction(twice.harmonic):.2f} J per half"
    )
    side = results["(a) plates, side"]
    across, pull = opening(side.model, side.harmonic)
    print(
        "(a) plates, side: J per half in each period "
        + ", ".join(f"{joule:.2f}" for joule in side.harmonic.cycles.friction / 2)
        + f"; bent by up to {1e3 * across:.1f} mm; pull on the contact at its edges "
        f"{1e-6 * pull[[0, -1]].max():.0f} MPa, elsewhere {1e-6 * pull[1:-1].max():.0f} MPa"
    )
    draw(folder / "two_plates.png", slow_runs, results)
    plan = results["(a) plates, plan"]
    write_paraview(folder / "two_plates.pvd", plan.model, plan.harmonic)
    print(f"\nwrote two_plates.png and two_plates.pvd to {folder}, "
          f"{time.perf_counter() - begin:.0f} s in all")  # fmt: skip


if __name__ == "__main__":
    main(Path(os.environ.get("OUT", "out")))
