"""Any valid scene keeps the invariants; any invalid one is refused by the name of its key."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from skfem_joint.errors import InputError
from skfem_joint.mesh import NamedMesh, build_bar, build_plate
from skfem_joint.scene import Scene, scene_from
from skfem_joint.scene.messages import key_path
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.stepping.resolution import check_resolution
from skfem_joint.stepping.schemes import generalized_alpha

Tables = dict[str, Any]
Case = tuple[Tables, NamedMesh]

ROUND_OFF = 1e-9
KINDS = ("harmonic", "multi_harmonic", "triangle", "half_sine", "versine", "ramp_and_hold",
         "rectangle", "table")  # fmt: skip
CHECKED = settings(
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


def powers(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers of any magnitude between two powers of ten."""
    return st.floats(low, high, allow_nan=False).map(lambda power: 10.0**power)


@st.composite
def a_load(draw: st.DrawFn, step: float, force: float, table: Path, kind: str) -> Tables:
    """One load that ``step`` resolves, about as large as ``force``."""
    amplitude = force * draw(st.sampled_from([-1.0, 0.0, 1e-6, 0.3, 0.99, 1.0, 1.5]))
    load: Tables = {"kind": kind, "on": draw(st.sampled_from(["free_end", "junction", "linear"]))}
    start = step * draw(st.sampled_from([0.0, 2.0, 2.3]))
    steps = draw(st.sampled_from([8.0, 11.4, 20.0, 33.3, 200.0]))
    if kind == "harmonic":
        return load | {"amplitude": amplitude, "frequency": 1.0 / (steps * step), "phase": 0.4}
    if kind == "multi_harmonic":
        parts = [
            {"amplitude": amplitude / k, "frequency": k / (4.0 * steps * step)} for k in (1, 2, 3)
        ]
        return load | {"components": parts}
    if kind == "rectangle":
        return load | {"peak": amplitude, "duration": steps * step, "start": start}
    if kind == "table":
        return load | {"file": table.name}
    return load | {"peak": amplitude, "rise_time": steps * step, "start": start}


@st.composite
def cases(draw: st.DrawFn, table: Path) -> Case:
    """A valid scene in its tables, and its mesh: three bars for each plate in plan."""
    length = draw(powers(-4.0, 3.0))
    share = draw(st.sampled_from([1.0, 0.5, 3.0]))
    dim = draw(st.sampled_from([1, 1, 1, 2]))
    most = 60 if dim == 1 else 6
    elements = draw(st.integers(1, most)), draw(st.integers(1, most))
    width, thickness = length * draw(powers(-2.0, -0.5)), length * draw(powers(-3.0, -1.0))
    strips = [("joint", length, elements[0]), ("linear", share * length, elements[1])]
    whole = length + share * length
    if dim == 1:
        mesh = build_bar(strips, {"fixed": 0.0, "junction": length, "free_end": whole})
    else:
        kind = draw(st.sampled_from(["triangle", "quadrilateral"]))
        sides = {"fixed": "left", "free_end": "right"}
        points = {"junction": (length, 0.0)}
        mesh = build_plate(strips, width, 2, kind=kind, boundaries=sides, points=points)
    E, density = draw(powers(8.0, 12.0)), draw(powers(2.0, 4.5))
    friction = draw(st.sampled_from([0.0, 0.1, 0.7, 2.0]))
    # The strain of a force at the friction limit is at most a thousandth.
    pressure = 1e-3 * E * thickness / length * draw(st.sampled_from([0.0, 1e-3, 1.0]))
    force = max(friction * pressure * width * length, 1e-6 * E * width * thickness)
    joint: Tables = {"on": "joint", "pressure": pressure, "friction": friction}
    if draw(st.booleans()):
        spots = [0.0, 0.3 * length, 1.1 * length]
        joint["pressure"] = {"positions": spots, "values": [pressure, 0.0, 2.0 * pressure]}
    joint["law"] = draw(st.sampled_from(["arctan", "coulomb"]))
    if joint["law"] == "arctan":
        joint["beta"] = draw(powers(1.0, 10.0))
    joint["normal_force"] = draw(st.sampled_from(["equal", "consistent"]))

    # The step takes a wave through anything from a tenth of an element to the whole bar.
    time = (1.0 + share) * length / math.sqrt(E / density)
    step = time * draw(powers(-3.0, 0.0))
    rho = draw(st.sampled_from([0.0, 0.5, 0.8, 1.0, 1.0, 1.0]))
    by_cycles = draw(st.booleans())
    kinds = KINDS[:2] if by_cycles else KINDS
    loads = [draw(a_load(step, force, table, draw(st.sampled_from(kinds))))]
    if by_cycles:
        steps = draw(st.integers(8, 30))
        timing: Tables = {"cycles": draw(st.integers(1, 3)), "steps_per_cycle": steps}
        if loads[0]["kind"] == "multi_harmonic":
            timing["steps_per_cycle"] = 3 * steps
    else:
        if draw(st.booleans()):
            loads.append(draw(a_load(step, force, table, draw(st.sampled_from(kinds)))))
        timing = {"duration": draw(st.integers(1, 80)) * step, "step": step}
    tables: Tables = {
        "title": "any",
        "mesh": {"file": "bar.msh"},
        "material": {
            "E": E,
            "density": density,
            "mass_matrix": draw(st.sampled_from(["consistent", "lumped"])),
        },
        "section": {"thickness": thickness} | ({"width": width} if dim == 1 else {}),
        "support": {"fixed": ["fixed"]},
        "joint": [joint],
        "damping": {
            "stiffness": time * draw(st.sampled_from([0.0, 1e-3, 10.0])),
            "mass": draw(st.sampled_from([0.0, 0.1])) / time,
        },
        "load": loads,
        "time": timing | {"rho_infinity": rho},
        "models": {"run": ["full"]},
        "output": {"every": draw(st.integers(1, 3)), "points": ["junction", "free_end"]},
    }
    if dim == 2:
        tables["material"]["poisson"] = draw(st.sampled_from([0.0, 0.3, 0.45]))
        for load in loads:
            load["direction"] = draw(st.sampled_from([[1.0, 0.0], [-3.0, 4.0]]))
    if draw(st.booleans()):
        tables["material"]["regions"] = {"linear": {"E": 1e-3 * E, "density": 10.0 * density}}
    if draw(st.integers(0, 4)) == 0:
        del tables["joint"]
    return tables, mesh


def scene_and_run(tables: Tables, mesh: NamedMesh, table: Path) -> tuple[Scene, Run]:
    scene = scene_from(tables, mesh, table.with_name("scene.toml"))
    system = scene.system()
    try:
        check_resolution(system, scene.time_step, scene.n_steps)
    except InputError:
        assume(False)  # the step is too long for the load: refused, and says which would do
    run = integrate(
        system,
        step=scene.time_step,
        n_steps=scene.n_steps,
        scheme=generalized_alpha(scene.time.rho_infinity),
        save=Save(every=scene.output.every, fields=True),
        cycle_steps=scene.time.steps_per_cycle if scene.time.cycles is not None else None,
    )
    return scene, run


@pytest.fixture(scope="session")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Table of forces that scenes of this file may name."""
    path = tmp_path_factory.mktemp("tables") / "force.csv"
    path.write_text("0, 0\n1e-6, 2.0\n1e-4, -3\n2.0, 5\n")
    return path


@settings(CHECKED, max_examples=150)
@given(data=st.data())
def test_any_valid_scene_keeps_the_invariants(data: st.DataObject, table: Path) -> None:
    scene, run = scene_and_run(*data.draw(cases(table)), table)
    system = run.system
    for values in (run.u, run.v, run.sigma, run.point_u, run.point_v, run.amplitudes):
        assert np.all(np.isfinite(values))
    assert run.energy_residual < 1e-8
    end = run.stored_energy[1]
    # A joint takes power at every moment, and friction keeps below its limit.
    slip = (system.B @ run.v.T).T
    power = system.by_point(run.sigma * slip)
    assert np.all(power >= 0.0)
    sigma = system.slip_norm(run.sigma)
    assert np.all(sigma <= 1.0 + 1e-12)
    if scene.time.rho_infinity == 1.0:
        # Otherwise displacement and velocity part within a step, and works have no sign of their
        # own: only their balance holds.
        in_play = max(float(np.abs(run.input_work).sum()), end)
        assert np.all(run.friction_work >= -ROUND_OFF * in_play)
        assert run.viscous_work >= -ROUND_OFF * in_play
        assert abs(run.scheme_work) <= ROUND_OFF * in_play
        assert end <= run.input_work.sum() + ROUND_OFF * in_play
    assert run.times[-1] <= scene.n_steps * scene.time_step * (1.0 + 1e-12)
    assert run.counters.steps == scene.n_steps
    held = (system.w > 0.0) & np.isinf(system.beta)
    speed = system.slip_norm(slip)
    # Coulomb: a point below its limit does not move, not even by round-off.
    assert np.all(speed[1:, held][sigma[1:, held] < 1.0 - 1e-12] == 0.0)
    # Arctan: the force is the law's at the slip velocity.
    law = (system.w > 0.0) & ~held
    expected = 2.0 / np.pi * np.arctan(system.beta[law] * speed[:, law])
    np.testing.assert_allclose(sigma[:, law], expected, atol=1e-6, rtol=0.0)


@settings(CHECKED, max_examples=40)
@given(data=st.data(), factor=st.sampled_from([-1.0, 2.0**20, 2.0**-30]))
def test_units_and_signs_of_force_do_not_matter(
    data: st.DataObject, factor: float, table: Path
) -> None:
    """Loads, stiffness, mass, damping and friction limits times one factor: the same motion."""
    tables, mesh = data.draw(cases(table))
    tables["load"] = [load for load in tables["load"] if load["kind"] != "table"] or [
        {"kind": "triangle", "on": "free_end", "peak": 1.0,
         "rise_time": 10.0 * scene_and_run(tables, mesh, table)[0].time_step}
        | ({"direction": [1.0, 0.0]} if mesh.dim == 2 else {})
    ]  # fmt: skip
    if "cycles" in tables["time"] and tables["load"][0]["kind"] == "triangle":
        return
    _, run = scene_and_run(tables, mesh, table)
    scaled = copy.deepcopy(tables)
    size = abs(factor)
    scaled["material"]["E"] *= size
    scaled["material"]["density"] *= size
    for region in scaled["material"].get("regions", {}).values():
        region["E"] *= size
        region["density"] *= size
    for joint in scaled.get("joint", []):
        if isinstance(joint["pressure"], dict):
            joint["pressure"]["values"] = [size * p for p in joint["pressure"]["values"]]
        else:
            joint["pressure"] *= size
    for load in scaled["load"]:
        for part in load.get("components", [load]):
            for key in ("amplitude", "peak"):
                if key in part:
                    part[key] *= factor
    _, other = scene_and_run(scaled, mesh, table)
    largest = np.abs(run.u).max()
    np.testing.assert_allclose(
        math.copysign(1.0, factor) * other.u, run.u, rtol=0.0, atol=1e-7 * largest
    )


# Invalid scenes


def leaves(value: Any, path: tuple[int | str, ...] = ()) -> list[tuple[int | str, ...]]:
    """Paths of all numbers and words in tables."""
    if isinstance(value, dict):
        return [leaf for key, item in value.items() for leaf in leaves(item, (*path, key))]
    if isinstance(value, list):
        return [leaf for i, item in enumerate(value) for leaf in leaves(item, (*path, i))]
    return [path]


def tables_in(value: Any, path: tuple[int | str, ...] = ()) -> list[tuple[int | str, ...]]:
    """Paths of all tables whose keys are fixed."""
    found = []
    if isinstance(value, dict):
        found = [path] if path[-1:] != ("regions",) else []
        found += [place for key, item in value.items() for place in tables_in(item, (*path, key))]
    elif isinstance(value, list):
        found = [place for i, item in enumerate(value) for place in tables_in(item, (*path, i))]
    return found


def at(value: Any, path: tuple[int | str, ...]) -> Any:
    for part in path:
        value = value[part]
    return value


def refusal(tables: Tables, mesh: NamedMesh, table: Path) -> list[str]:
    """Problems of a scene without its name, which starts every one."""
    with pytest.raises(InputError) as caught:
        scene_from(tables, mesh, table.with_name("scene.toml"))
    name = f"{table.with_name('scene.toml')}: "
    assert all(problem.startswith(name) for problem in caught.value.problems)
    return [problem.removeprefix(name) for problem in caught.value.problems]


#: How the structure's builder starts what it says of names that the mesh does not have.
BUILDER = {"on": ("joint '", "load on"), "fixed": "support.fixed", "points": "points"}
NOT_NUMBERS: tuple[Any, ...] = (math.nan, math.inf, -math.inf, "1", "", True, [], [1.0], {}, None,
                                10**400, 1j)  # fmt: skip
NOT_COUNTS: tuple[Any, ...] = (*NOT_NUMBERS, 0, -1, 2.5, 10**10, 2**80)
NOT_WORDS: tuple[Any, ...] = (3, 1.5, math.nan, False, [], ["x", ["x"]], {}, None, b"x")
NOT_NAMES = (*NOT_WORDS, "", "nonsense", "Free_end ", "\0", "free\nend", "é", "x" * 10_000)
#: Keys below which nothing may be negative, and those that must not be zero either.
NOT_NEGATIVE = {"pressure", "values", "friction", "stiffness", "mass", "start", "rho_infinity"}
POSITIVE = {"E", "density", "width", "thickness", "beta", "frequency", "rise_time", "duration",
            "step"}  # fmt: skip


def wrong_values(key: str, value: Any) -> tuple[Any, ...]:
    if isinstance(value, str):
        return NOT_WORDS if key in ("title", "file") else NOT_NAMES
    if isinstance(value, int):
        return NOT_COUNTS
    wrong = NOT_NUMBERS
    if key in POSITIVE | NOT_NEGATIVE:
        wrong += (-1.0, -1e-300)
    if key in POSITIVE:
        wrong += (0.0, -0.0)
    return wrong


@settings(CHECKED, max_examples=300)
@given(data=st.data())
def test_one_wrong_value_is_refused_by_the_name_of_its_key(
    data: st.DataObject, table: Path
) -> None:
    tables, mesh = data.draw(cases(table))
    path = data.draw(st.sampled_from(leaves(tables)))
    key = [part for part in path if isinstance(part, str)][-1]
    wrong = data.draw(st.sampled_from(wrong_values(key, at(tables, path))))
    at(tables, path[:-1])[path[-1]] = wrong
    where = key_path(path)
    found = refusal(tables, mesh, table)
    assert any(problem.startswith(BUILDER.get(key, where)) for problem in found) or any(
        problem.startswith(where) for problem in found
    ), (where, wrong, found)


OPTIONAL = {"mass", "joint", "scale", "poisson", "direction", "axis", "against", "plane", "width"}
REQUIRED = {"material", "load", "time", "file", "E", "density", "pressure", "friction", "positions",
            "values", "kind", "on", "amplitude", "frequency", "components", "peak",
            "rise_time"}  # fmt: skip


@settings(CHECKED, max_examples=250)
@given(data=st.data(), name=st.text(min_size=1, max_size=12))
def test_an_unknown_and_a_missing_key_are_refused_by_name(
    data: st.DataObject, name: str, table: Path
) -> None:
    tables, mesh = data.draw(cases(table))
    path = data.draw(st.sampled_from(tables_in(tables)))
    assume(name not in at(tables, path) and name not in OPTIONAL)
    needed = [] if "regions" in path else sorted(REQUIRED & set(at(tables, path)))
    if path[:1] == ("load",) and "on" in needed:  # or base, which is seen once all keys are known
        needed.remove("on")
    at(tables, path)[name] = 1.0
    wanted = [f"{key_path((*path, name))}: unknown key"]
    if needed:
        missing = data.draw(st.sampled_from(needed))
        del at(tables, path)[missing]
        wanted.append(f"{key_path((*path, missing))}: missing")
        if missing == "kind":  # nothing is known of the keys of such a load
            del wanted[0]
    found = refusal(tables, mesh, table)
    assert all(any(problem.startswith(text) for problem in found) for text in wanted)
