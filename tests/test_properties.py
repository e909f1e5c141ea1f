"""Any valid scene keeps the invariants; any invalid one is refused by the name of its key."""

import math
import random
from typing import Any

import numpy as np
import pytest
from stability.checks import law_checks
from stability.mutated import Tables, drawn

import skfem_joint as sj
from skfem_joint.ground.key_paths import key_path
from skfem_joint.scene import scene_from

ROUND_OFF = 1e-9
Path = tuple[int | str, ...]


def valid(rng: random.Random) -> tuple[Tables, sj.NamedMesh]:
    """Tables of a valid scene of bars or plates, and its mesh: laws of any steepness, or none."""
    tables, bodies = drawn(rng)
    (joint,) = tables["joint"]
    if len(bodies) == 1:  # nothing but friction holds the second
        joint["friction"] *= rng.choice([0.0, 1.0, 1.0, 1.0])
    if "beta" in joint:
        joint["beta"] = 10.0 ** rng.uniform(1.0, 10.0)
    if rng.random() < 0.5:
        regions = {"joint": {"E": 1e-3 * tables["material"]["E"], "density": 3e4}}
        on_cells = "joint" in bodies[-1].regions
        tables["material"]["regions"] = regions if on_cells else {"rest": regions["joint"]}
    if len(bodies) == 1 and rng.random() < 0.2:
        del tables["joint"]
    tables["models"] = {"run": ["full"]}
    tables.pop("reduction", None)
    return tables, sj.merged(bodies) if len(bodies) > 1 else bodies[0]


def in_parts(count: int) -> pytest.MarkDecorator:
    """So many parts of the scenes drawn at random; all but the first are slow cases."""
    slow = [pytest.param(part, marks=pytest.mark.slow) for part in range(1, count)]
    return pytest.mark.parametrize("part", [0, *slow])


@in_parts(6)
def test_any_valid_scene_keeps_the_invariants(part):
    for seed in range(25 * part, 25 * part + 25):
        scene = scene_from(*valid(random.Random(seed)))
        system = scene.system()
        run = sj.integrate(
            system,
            step=scene.time_step,
            n_steps=scene.n_steps,
            scheme=sj.generalized_alpha(scene.time.rho_infinity),
            save=sj.Save(every=scene.output.every, fields=True),
            cycle_steps=scene.cycle_steps,
        )
        for values in (run.u, run.v, run.sigma, run.point_u, run.point_v, run.amplitudes):
            assert np.all(np.isfinite(values)), seed
        assert run.energy_residual < 1e-8, seed
        assert [said for holds, said in law_checks(run) if not holds] == [], seed
        # A joint takes power at every moment.
        power = system.contact.by_point(run.sigma * (system.contact.B @ run.v.T).T)
        assert np.all(power >= 0.0), seed
        if scene.time.rho_infinity == 1.0:
            # Otherwise displacement and velocity part within a step, and works have no sign of
            # their own: only their balance holds.
            end = run.stored_energy[1]
            in_play = max(float(np.abs(run.input_work).sum()), end)
            assert np.all(run.friction_work >= -ROUND_OFF * in_play), seed
            assert run.viscous_work >= -ROUND_OFF * in_play, seed
            assert abs(run.scheme_work) <= ROUND_OFF * in_play, seed
            assert end <= run.input_work.sum() + ROUND_OFF * in_play, seed
        assert run.times[-1] <= scene.n_steps * scene.time_step * (1.0 + 1e-12)
        assert run.counters.steps == scene.n_steps


def leaves(value: Any, path: Path = ()) -> list[Path]:
    """Paths of all numbers and words in tables."""
    if isinstance(value, dict):
        return [leaf for key, item in value.items() for leaf in leaves(item, (*path, key))]
    if isinstance(value, list):
        return [leaf for i, item in enumerate(value) for leaf in leaves(item, (*path, i))]
    return [path]


def at(value: Any, path: Path) -> Any:
    for part in path:
        value = value[part]
    return value


def refusal(tables: Tables, mesh: sj.NamedMesh) -> list[str]:
    """Problems of a scene without its name, which starts every one."""
    with pytest.raises(sj.InputError) as caught:
        scene_from(tables, mesh)
    assert all(problem.startswith("scene: ") for problem in caught.value.problems)
    return [problem.removeprefix("scene: ") for problem in caught.value.problems]


#: How the structure's builder starts what it says of names that the mesh does not have.
BUILDER = {"on": ("joint '", "load on"), "against": "joint '", "fixed": "support.fixed",
           "points": "points"}  # fmt: skip
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


@in_parts(6)
def test_one_wrong_value_is_refused_by_the_name_of_its_key(part):
    for seed in range(50 * part, 50 * part + 50):
        rng = random.Random(seed)
        tables, mesh = valid(rng)
        path = rng.choice(leaves(tables))
        key = [part for part in path if isinstance(part, str)][-1]
        wrong = rng.choice(wrong_values(key, at(tables, path)))
        at(tables, path[:-1])[path[-1]] = wrong
        where, problems = key_path(path), refusal(tables, mesh)
        assert any(
            problem.startswith((where, *np.atleast_1d(BUILDER.get(key, where))))
            for problem in problems
        ), (seed, where, wrong, problems)


REQUIRED = {"material", "load", "time", "file", "E", "density", "pressure", "friction", "positions",
            "values", "kind", "amplitude", "frequency", "components", "peak",
            "rise_time"}  # fmt: skip


@in_parts(5)
def test_an_unknown_and_a_missing_key_are_refused_by_name(part):
    for seed in range(50 * part, 50 * part + 50):
        rng = random.Random(seed)
        tables, mesh = valid(rng)
        inside = {leaf[:k] for leaf in leaves(tables) for k in range(len(leaf))}
        places = sorted(
            (p for p in inside if isinstance(at(tables, p), dict) and p[-1:] != ("regions",)),
            key=str,
        )
        path = rng.choice(places)
        table = at(tables, path)
        needed = [] if "regions" in path else sorted(REQUIRED & set(table))
        name = rng.choice(["x", "É", "a b", "0", '"', "two\nlines", "colour", "\0", "ꙮ", "E "])
        table[name] = 1.0
        wanted = [f"{key_path((*path, name))}: unknown key"]
        if needed:
            missing = rng.choice(needed)
            del table[missing]
            wanted.append(f"{key_path((*path, missing))}: missing")
            if missing == "kind":  # nothing is known of the keys of such a load
                del wanted[0]
        problems = refusal(tables, mesh)
        assert all(any(problem.startswith(text) for problem in problems) for text in wanted), (
            seed,
            problems,
        )
