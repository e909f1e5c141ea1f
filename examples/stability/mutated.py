"""Scenes drawn at random, and damaged ones: no traceback, no hang, no invariant broken.

    python examples/stability/mutated.py --out DIR [--count 20000] [--seed 0]

Every second scene is valid: bars and plates, one or two bodies, any values, order of tables, names
and units. It is run, its energy must balance and no friction exceed its limit, and the same
structure mirrored, with all forces and masses doubled, or in millimetres and tonnes must give the
same motion. In the others the bytes of the scene or of its mesh are damaged: they are refused
with a message, or run. What breaks this is kept in DIR; the exit status is then 1.
"""

import copy
import faulthandler
import io
import json
import random
import re
import sys
import time
import traceback
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from math import pi, sqrt
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np

from skfem_joint import InputError, build_bar, build_plate, cli, load_scene, run_scene
from skfem_joint.ground.errors import JointError
from skfem_joint.mesh import write_mesh
from stability.checks import ENERGY, law_checks, passivity_checks
from stability.launch import command_line

Tables = dict[str, Any]

#: Share of the largest displacement by which the same motion may differ.
SAME = 1e-6
#: What a damaged value may become.
TOKENS = ("nan", "inf", "-1", "0", "1e308", "true", "[]", "{}", "''", "[[joint]]", "=", "é", "\x00")


# Valid scenes


def drawn(rng):
    """Tables of a valid scene of any size, and the meshes of its bodies."""
    kind = rng.choice(["bar", "bars", "plate", "side", "plates"])
    bars, two, side = "bar" in kind, kind.endswith("s"), kind == "side"
    length, joint = 10.0 ** rng.uniform(-2.0, 1.0), rng.uniform(0.2, 0.8)
    width, thickness = length * rng.uniform(0.05, 0.3), length * rng.uniform(0.01, 0.1)
    bodies = _bodies(rng, bars, two, side, length, joint, width)
    E, density = 10.0 ** rng.uniform(9.0, 12.0), 10.0 ** rng.uniform(3.0, 4.2)
    # Of the contact across the length, and across that.
    depth, height = (thickness, width) if side else (width, thickness)
    friction, strain = rng.uniform(0.05, 1.0), 10.0 ** rng.uniform(-7.0, -4.0)
    limit = strain * E * depth * height  # N, so that strains stay small
    pressure = limit / (friction * depth * joint * length)
    if rng.random() < 0.3 and not two:
        at = [0.0, *sorted(rng.uniform(0.0, joint * length) for _ in range(3)), joint * length]
        pressure = {"positions": at, "values": [pressure * rng.uniform(0.0, 2.0) for _ in at]}
    frequency = sqrt(E / density) / (4.0 * length) * rng.uniform(0.1, 2.0)
    law = rng.choice(["arctan", "coulomb"])
    joined = {"on": "joint", "pressure": pressure, "friction": friction, "law": law}
    if law == "arctan":
        joined["beta"] = 10.0 ** rng.uniform(0.0, 3.0) / (strain * length * frequency)
    joined["normal_force"] = rng.choice(["equal", "consistent"])
    joined |= {"against": "lower"} if two else {}
    section = {"thickness": thickness} | ({"width": width} if bars else {})
    masses = ["consistent", "lumped"][: 2 if bars else 1]
    material = {"E": E, "density": density, "mass_matrix": rng.choice(masses)}
    load = {"on": "free_end"}
    if not bars:
        material["poisson"] = rng.uniform(0.0, 0.4)
        section["plane"] = rng.choice(["stress", "strain"])
        load["direction"] = [1.0, rng.choice([0.0, 0.2])]
    loads, timing = _loads(rng, load, limit * rng.uniform(0.1, 1.2), frequency)
    tables = {
        "title": rng.choice(["", "any", "Ünïcode"]),
        "mesh": {"file": [f"body_{number}.msh" for number in range(len(bodies))]},
        "material": material,
        "section": section,
        "support": {"fixed": ["fixed"]},
        "joint": [joined],
        "damping": {"stiffness": 10.0 ** rng.uniform(-3.0, -1.0) / (2.0 * pi * frequency)},
        "load": loads,
        "time": timing | {"rho_infinity": rng.choice([0.0, 0.5, 0.8, 1.0, 1.0])},
        "models": {"run": ["full"]},
        "output": {"every": rng.choice([1, 3]), "points": ["free_end"], "frames": 5, "vtk": True},
    }
    if rng.random() < 0.1 and law == "arctan":
        tables["models"] = {"run": ["full", "reduced"]}
        tables["reduction"] = {"friction_points": rng.choice(["auto", "all"])}
    return tables, bodies


def _bodies(rng, bars, two, side, length, share, width):
    """Meshes with the names `joint`, `fixed` and `free_end`; of two bodies also `lower`."""
    counts = [rng.randint(1, 30 if bars else 6) for _ in range(3)]
    across = width, rng.randint(1, 3)
    shape = {"kind": rng.choice(["triangle", "quadrilateral"]), "order": rng.choice([1, 2])}
    pressed, beside = share * length, length - share * length
    rest = "rest", beside, counts[1]

    def body(strips, fixed=True, free=True, start=0.0):
        if bars:
            points = {"fixed": 0.0} if fixed else {}
            points |= {"free_end": strips[0][1] + strips[1][1]} if free else {}
            return build_bar(strips, points, origin=(start, 0.0, 0.0))
        edges = ({"fixed": "left"} if fixed else {}) | ({"free_end": "right"} if free else {})
        edges |= {"joint": ("bottom", "pressed")} if side else {}
        return build_plate(strips, *across, boundaries=edges, origin=(start, 0.0), **shape)

    if not two:
        return [body([("pressed" if side else "joint", pressed, counts[0]), rest])]
    lower = ("lower", pressed, counts[0 if bars else 2])  # nodes of bars must match
    return [
        body([("held", *rest[1:]), ("joint", pressed, counts[0])], free=False),
        body([lower, rest], fixed=False, start=beside),
    ]


def _loads(rng, load, force, frequency):
    """Loads of one shape, and the times that resolve them."""
    shape = rng.choice(["harmonic", "multi_harmonic", "triangle", "half_sine", "ramp_and_hold"])
    if shape == "harmonic":
        waves = {"amplitude": force, "frequency": frequency, "phase": rng.choice([0.0, pi])}
        steps = {"cycles": rng.randint(1, 2), "steps_per_cycle": rng.randint(30, 60)}
        return [load | {"kind": shape} | waves], steps
    if shape == "multi_harmonic":
        parts = [{"amplitude": force / k, "frequency": k * frequency} for k in (1, 3)]
        return [load | {"kind": shape, "components": parts}], {"cycles": 1, "steps_per_cycle": 90}
    rise = 0.5 / frequency
    pulse = load | {"kind": shape, "peak": force, "rise_time": rise, "start": rng.random() * rise}
    return [pulse], {"duration": 3.0 * rise, "step": rise / rng.randint(20, 40)}


# The same structure described otherwise

# Each gives tables, mesh files, and two factors of the motion: of all of it, and of it along x.


def mirrored(tables, texts):
    """Mirror a structure along x.

    Positions of bars then count from the other end, those of plates in the other direction.
    """
    flipped = copy.deepcopy(tables)
    plane = "direction" in tables["load"][0]
    (load,), table = flipped["load"], flipped["joint"][0]["pressure"]
    if plane:
        load["direction"][0] *= -1.0
    if isinstance(table, dict) and plane:
        table["axis"] = [-1.0, 0.0]
    elif isinstance(table, dict):
        end = max(float(x) for x in re.findall(r"(?m)^(\S+) 0\.0 0\.0$", texts[0]))
        table["positions"] = [end - at for at in reversed(table["positions"])]
        table["values"] = table["values"][::-1]
    return flipped, [moved(text, (-1.0, 1.0, 1.0)) for text in texts], 1.0, -1.0


def doubled(tables, texts):
    """Double all forces, stiffness, mass and friction, which leaves the motion the same."""
    return scaled(tables, force=2.0, length=1.0), texts, 1.0, 1.0


def in_millimetres(tables, texts):
    """Describe a structure in millimetres, tonnes and seconds, and so in newtons."""
    texts = [moved(text, (1e3, 1e3, 1e3)) for text in texts]
    return scaled(tables, force=1.0, length=1e3), texts, 1e3, 1.0


def scaled(tables, force, length):
    """Tables in units of force and length that are smaller by these factors."""
    pressure = force / length**2
    factors = {"E": pressure, "pressure": pressure, "values": pressure, "beta": 1.0 / length}
    factors |= {"density": force / length**4, "amplitude": force, "peak": force}
    factors |= dict.fromkeys(("width", "thickness", "positions"), length)

    def change(name, value):
        return value * factors[name] if name in factors else value

    return walked("", tables, change)


def walked(key, value, change, order=list):
    """Copy with each value changed by the key that it stands under, and keys in another order."""
    if isinstance(value, dict):
        return {key: walked(key, part, change, order) for key, part in order(value.items())}
    if isinstance(value, list):
        return [walked(key, part, change, order) for part in value]
    return change(key, value)


def moved(text, factors):
    """Mesh file with each coordinate times a factor; nodes are the lines of three decimals."""

    def line(match):
        words = zip(match[0].split(" "), factors, strict=True)
        return " ".join(repr(float(word) * factor) for word, factor in words)

    return re.sub(r"(?m)^\S*[.e]\S* \S*[.e]\S* \S*[.e]\S*$", line, text)


def renamed(rng, tables, texts):
    """Tables and mesh files with other names of groups, and other orders of tables and keys."""
    words = ["Füße", "a b", "x'y", "0", "fixed_x", "on", "A" * 60, "结合", "-", "[joint]"]
    rng.shuffle(words)
    names = dict(zip(("joint", "fixed", "free_end", "lower"), words, strict=False))
    for name, word in names.items():
        texts = [text.replace(f'"{name}"', f'"{word}"') for text in texts]

    def change(key, value):
        return names.get(value, value) if key in ("on", "against", "fixed", "points") else value

    return walked("", tables, change, lambda items: rng.sample(list(items), len(items))), texts


def toml(tables):
    lines = []
    for name, value in tables.items():
        if not isinstance(value, dict | list):
            lines.insert(0, f"{name} = {_inline(value)}")
            continue
        for table in value if isinstance(value, list) else [value]:
            lines.append(f"[[{name}]]" if isinstance(value, list) else f"[{name}]")
            lines += [f"{key} = {_inline(part)}" for key, part in table.items()]
    return "\n".join(lines) + "\n"


def _inline(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_inline(part)}" for key, part in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


# Damage


def damaged(data, rng, tokens=TOKENS):
    """Copy of a file with a few bytes, words or lines changed, cut, doubled or exchanged."""
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        lines = data.split(b"\n")
        i, j = (rng.randrange(len(lines)) for _ in range(2))
        at = rng.randrange(len(data) + 1)
        digits = [k for k, byte in enumerate(data) if 48 <= byte < 58] or [at]
        how = rng.choice(["byte", "bit", "digit", "insert", "hole", "cut", "line", *["word"] * 5])
        if how == "byte":
            data = data[:at] + rng.randbytes(1) + data[at + 1 :]
        elif how == "bit" and at < len(data):
            data = data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
        elif how == "digit":
            place = rng.choice(digits)
            data = data[:place] + rng.choice([b"0", b"7", b".", b"-", b"e"]) + data[place + 1 :]
        elif how == "insert":
            data = data[:at] + rng.randbytes(rng.randrange(1, 8)) + data[at:]
        elif how == "hole":
            data = data[:at] + data[at + rng.randrange(1, 60) :]
        elif how == "cut":
            data = data[:at]
        elif how == "line":
            lines[i : i + 1] = rng.choice([[], [lines[i]] * 2, [lines[j]], [lines[j], lines[i]]])
            data = b"\n".join(lines)
        else:
            key, equals, _ = lines[i].partition(b"=")
            words = lines[i].split(b" ")
            words[rng.randrange(len(words))] = rng.choice(tokens).encode()
            value = key + b"= " + rng.choice(tokens).encode()
            lines[i] = value if equals and rng.random() < 0.5 else b" ".join(words)
            data = b"\n".join(lines)
    return data


# Judging


class BrokenError(Exception):
    """An invariant does not hold."""


def hold(invariant, said):
    if not invariant:
        raise BrokenError(said)


def study_of(folder, scene, bodies):
    """Results of a scene of these texts; None beyond 500,000 unknowns times steps."""
    for path in folder.glob("body_*"):
        path.unlink()
    for number, data in enumerate(bodies):
        (folder / f"body_{number}.msh").write_bytes(data)
    (folder / "scene.toml").write_bytes(scene)
    loaded = load_scene(folder / "scene.toml")
    fits = loaded.n_steps * max(1, loaded.system().n) <= 500_000
    return run_scene(loaded).finished() if fits else None


def check(study):
    """Check that a run's energy balances, and that friction keeps its law and takes energy."""
    for name, model in study.models.items():
        run = model.run
        finite = all(np.isfinite(x).all() for x in (run.point_u, run.peak, run.sigma))
        hold(finite, f"{name}: not finite")
        hold(run.energy_residual < ENERGY, f"{name}: energy open by {run.energy_residual:.3g}")
        for holds, said in [*law_checks(run), *passivity_checks(run, ENERGY)]:
            hold(holds, f"{name}: {said}")


def same(first, second, factor, along):
    """Check that two runs are the same motion, but for a factor and another factor along x."""
    a, b = (study.models["full"].run for study in (first, second))
    factors = [factor * (along if name.endswith(".x") else 1.0) for name in a.system.points]
    largest = np.abs(a.point_u).max()
    difference = np.abs(b.point_u / factors - a.point_u).max()
    said = f"differs by {difference / (largest or 1.0):.3g} of the displacement"
    hold(difference <= SAME * largest, said)


def judge(number, seed, folder):
    """Draw a scene by its number and judge it; returns the outcome in a word."""
    rng = random.Random(f"{seed} {number}")
    tables, bodies = drawn(rng)
    texts = []
    for mesh in bodies:
        write_mesh(mesh, folder / "drawn.msh")
        texts.append((folder / "drawn.msh").read_text(encoding="utf-8"))
    if number % 2:
        files = [toml(tables).encode(), *(text.encode() for text in texts)]
        damaged_file = rng.choice([0, 0, *range(len(files))])
        files[damaged_file] = damaged(files[damaged_file], rng)
        try:
            study = study_of(folder, files[0], files[1:])
        except JointError as error:
            hold(str(error).strip(), "refused without a word")
            return "damaged: refused"
        if study is None:
            return "damaged: read"
        check(study)
        return "damaged: run"
    way = rng.choice([mirrored, doubled, in_millimetres])
    described = renamed(rng, tables, texts) if rng.random() < 0.5 else (tables, texts)
    try:
        study = _valid(folder, *described)
    except InputError as error:
        if "reduced model cannot follow" in str(error):  # and says what to do
            return "valid, reduction refused"
        raise
    check(study)
    if number % 20 == 0:
        _by_command(folder)
    changed, moved_texts, factor, along = way(tables, texts)
    same(study, _valid(folder, changed | {"models": {"run": ["full"]}}, moved_texts), factor, along)
    return f"valid, {way.__name__.replace('_', ' ')}"


def _valid(folder, tables, texts):
    study = study_of(folder, toml(tables).encode(), [text.encode() for text in texts])
    hold(study is not None, "too large a scene was drawn")
    return study


def _by_command(folder):
    """Run the scene by the command line too, with files for ParaView."""
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        status = cli.main(["run", str(folder / "scene.toml"), "--out", str(folder / "out")])
    hold(status == 0, f"the command ends with {status}: {said.getvalue()}")


def main(arguments=None, judging=judge):
    """Judge scenes by their numbers; returns 1 if any of them breaks something."""
    options = command_line(__doc__, count=20_000, first=0, seed=0).parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    outcomes, broken, begin = Counter(), 0, time.perf_counter()
    for number in range(options.first, options.first + options.count):
        # A scene that takes five minutes is taken to hang.
        faulthandler.dump_traceback_later(300.0, exit=True, file=sys.__stderr__)
        try:
            outcomes[judging(number, options.seed, options.out)] += 1
        except Exception as error:  # noqa: BLE001 - anything that is not a message is a finding
            broken += 1
            kind = "refused" if isinstance(error, InputError) else type(error).__name__
            outcomes[f"BROKEN: {kind}"] += 1
            kept = options.out / f"broken_{number}"
            kept.mkdir(exist_ok=True)
            for path in [*options.out.glob("*.toml"), *options.out.glob("body_*.msh")]:
                (kept / path.name).write_bytes(path.read_bytes())
            (kept / "error.txt").write_text(traceback.format_exc(), encoding="utf-8")
            print(f"scene {number}: {type(error).__name__}: {error}"[:300], flush=True)
        finally:
            faulthandler.cancel_dump_traceback_later()
        done = number + 1 - options.first
        if done % 1000 == 0:
            print(f"{done} of {options.count} scenes, {broken} broken", file=sys.stderr, flush=True)
    for word, count in sorted(outcomes.items()):
        print(f"{word}: {count}")
    print(f"{options.count} scenes in {time.perf_counter() - begin:.0f} s, {broken} broken")
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main())
