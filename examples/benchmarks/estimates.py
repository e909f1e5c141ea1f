"""Stated over true errors of results, for scenes drawn at random.

    python examples/benchmarks/estimates.py SEED COUNT            reduced models, COUNT scenes
    python examples/benchmarks/estimates.py SEED COUNT full       time steps of full models
    python examples/benchmarks/estimates.py SEED COUNT accuracy   1 % and 2 % asked for

Bars with one to three joints and plates, loaded at ends and inside by one harmonic or several, by
pulses that may set in late, near resonance and in gross slip too; reduced by 1 to 20 modes. The
truth is the full model at an eighth of the step, of plates at a quarter.
"""

import os
import sys
import time
from dataclasses import dataclass
from typing import get_args

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import numpy as np

from skfem_joint import build_bar, build_plate, run_scene
from skfem_joint.analysis.estimate import verification_run
from skfem_joint.analysis.history import QUANTITIES, difference, results
from skfem_joint.analysis.scene_plan import plan_of
from skfem_joint.errors import JointError
from skfem_joint.modes import straining_modes
from skfem_joint.scene import scene_from, tables

#: Errors below the first are not judged; large and huge errors are reported apart.
JUDGED, LARGE, HUGE = 3e-3, 2e-2, 0.2
WIDTH = 0.05  # m
REFERENCES = get_args(tables.ReductionTable.model_fields["reference"].annotation)
#: Steps in a period or rise of full models.
STEPS = (8, 12, 20, 40, 80, 150, 400)


def _bar(rng):
    """Bar of one to three joints with plain parts between; names of joints and of loaded points."""
    regions, ends, joints, x = [], {}, [], 0.0
    for k in range(rng.integers(1, 4)):
        beside = rng.choice([0.0, 1.0], p=(0.3, 0.7))
        for name in (f"joint_{k}", f"plain_{k}") if beside else (f"joint_{k}",):
            length = round(float(rng.uniform(0.05, 0.25)), 3)
            regions.append((name, length, int(rng.integers(10, 31))))
            ends[f"end_{name}"] = x = x + length
        joints.append(f"joint_{k}")
    return build_bar(regions, {"fixed": 0.0} | ends), joints, list(ends)


def _shape(rng, force, natural, steps):
    """Tables of load and time of a scene whose first natural frequency is ``natural`` (Hz)."""
    ratios = [rng.uniform(0.03, 0.7), rng.uniform(0.9, 1.1), rng.uniform(1.2, 2.5)]
    base = float(rng.choice(ratios, p=(0.6, 0.2, 0.2))) * natural
    kind = rng.choice(["harmonic", "multi_harmonic", "pulse"], p=(0.45, 0.2, 0.35))
    cycles = {"cycles": int(rng.integers(3, 9))}
    cycles["steps_per_cycle"] = steps or int(rng.choice([60, 100, 200]))
    if kind == "harmonic":
        return {"kind": kind, "amplitude": force, "frequency": base}, cycles
    if kind == "multi_harmonic":
        parts = [(1, 0.7), (int(rng.integers(2, 5)), 0.4)]
        component = [
            {"amplitude": a * force, "frequency": n * base / 2.0, "phase": rng.uniform(0, 6.28)}
            for n, a in parts
        ]
        if steps:
            cycles["steps_per_cycle"] = steps * parts[1][0]
        return {"kind": kind, "components": component}, cycles
    rise = rng.uniform(0.05, 0.6) / natural
    start = float(rng.choice([0.0, 3.0], p=(0.7, 0.3))) / natural
    step = rise / (steps or rng.integers(10, 41))
    shape = str(rng.choice(["triangle", "half_sine", "versine"]))
    load = {"kind": shape, "peak": force, "rise_time": rise, "start": start}
    return load, {"duration": start + rng.uniform(3.0, 8.0) / natural, "step": float(step)}


def natural_frequency(scene):
    """Lowest natural frequency with the contact held, Hz."""
    system = scene.system()
    held = np.unique(system.B.indices)
    if held.size == system.n:  # a bar in contact throughout: as if half of it moved
        held = np.arange(system.n // 2)
    return float(straining_modes(system.K, system.M, held, 1)[0][0])


def scenes(seed, count, steps=()):
    """Scenes drawn at random; the steps in a period or rise are drawn from ``steps``, if given."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        flat = rng.random() < 0.2
        if flat:
            long, wide = int(rng.integers(8, 17)), int(rng.integers(2, 4))
            strips = [("joint", 0.2, long // 2), ("linear", 0.2, long // 2)]
            mesh, joints, places = build_plate(strips, WIDTH, wide), ["joint"], ["right"]
        else:
            mesh, joints, places = _bar(rng)
        pressed = {"pressure": rng.uniform(2e6, 2e7), "friction": 0.7}
        arctan = rng.random() >= 0.15
        pressed |= {"beta": 10 ** rng.uniform(3.5, 6)} if arctan else {"law": "coulomb"}
        pull = {"on": places[0], "kind": "harmonic", "amplitude": 1.0, "frequency": 1.0}
        values = {
            "mesh": {"file": "none"},
            "material": {"E": 200e9, "density": 8000.0} | ({"poisson": 0.3} if flat else {}),
            "section": {"thickness": 0.01} | ({} if flat else {"width": WIDTH}),
            "support": {"fixed": ["left" if flat else "fixed"]},
            "joint": [{"on": on} | pressed for on in joints],
            "damping": {"stiffness": 10 ** rng.uniform(-6.5, -5)},
            "load": [pull | ({"direction": [1.0, 0.0]} if flat else {})],
            "time": {"cycles": 1},
        }
        plain = scene_from(values, mesh)
        place = str(rng.choice(places[-2:] if rng.random() < 0.7 else places))
        direction = {"direction": [1.0, float(rng.choice([0.0, 0.3]))]} if flat else {}
        level = rng.uniform(1.05, 1.5) if rng.random() < 0.12 else rng.uniform(0.1, 0.9)
        limit = float(plain.system().w.sum()) * (1.0 if flat else 1.0 / len(joints))
        per_cycle = int(rng.choice(steps)) if steps else None
        load, times = _shape(rng, level * limit, natural_frequency(plain), per_cycle)
        modes = int(rng.integers(1, 21))
        apart = not flat and {f"end_plain_{k}" for k in range(len(joints) - 1)} <= set(places)
        reference = str(rng.choice([name for name in REFERENCES if name != "paper" or apart]))
        most = 12 if reference == "paper" else 20
        reduction = {"reference": reference, "modes": min(modes, most)}
        reduction |= {"interface_modes": int(rng.integers(0, 4))} if rng.random() < 0.4 else {}
        reduction |= {"friction_points": "all"} if rng.random() < 0.3 else {}
        values |= {"load": [{"on": place} | direction | load], "time": times}
        values |= {"reduction": reduction, "models": {"run": ["full" if steps else "reduced"]}}
        yield scene_from(values, mesh)


@dataclass(frozen=True)
class Judged:
    """Stated and true errors of a scene's results by quantity; empty if the scene was refused."""

    what: str
    stated: dict[str, float | None]
    true: dict[str, float | None]
    refused: str = ""

    def ratios(self):
        """Stated over true error, and the true error, where that is large enough to be judged."""
        pairs = ((self.stated.get(name), self.true.get(name)) for name in QUANTITIES)
        return [(a / b, b) for a, b in pairs if None not in (a, b) and b > JUDGED]


def judged(scene):
    """Run the only model of a scene, and the truth: the full model with far smaller steps."""
    (name,), reduction = scene.models.run, scene.reduction
    what = f"{scene.load[0].kind:14s} {scene.system().n:4d} unknowns {scene.n_steps:5d} steps"
    if name == "reduced":
        what += f" {reduction.reference:5s} {reduction.modes!s:>4s} + "
        what += f"{reduction.interface_modes!s:4s} modes"
    try:
        study = run_scene(scene)
    except JointError as error:
        return Judged(what, {}, {}, str(error))
    model, asked = study.models[name], study.scene
    finer = 8 if asked.named_mesh.dim == 1 else 4
    truth = results(verification_run(asked.system(), plan_of(asked).finer(finer)))
    said = {q: model.estimate and model.estimate.of("total", q) for q in QUANTITIES}
    return Judged(what, said, difference(truth, results(model.run)))


def report(all_judged):
    """Shares of quantities and of scenes by their ratios of stated to true error."""
    some = [ratios for judgement in all_judged if (ratios := judgement.ratios())]
    flat = [pair for ratios in some for pair in ratios]
    refused = sum(bool(judgement.refused) for judgement in all_judged)
    said = f"{len(all_judged)} scenes, {refused} refused, {len(some)} with an error above"
    lines = [f"{said} {JUDGED:.1%}"]
    if flat:
        shares = np.array([ratio for ratio, _ in flat])
        large = [ratio for ratio, true in flat if true > LARGE]
        huge = [ratio * true for ratio, true in flat if true > HUGE]
        inside = np.mean([(shares >= 0.5) & (shares <= 3.0)])
        whole = np.mean([all(0.5 <= r <= 3.0 for r, _ in ratios) for ratios in some])
        lines += [
            f"stated between 0.5 and 3 times the truth: {inside:.0%} of quantities, and all "
            f"quantities of {whole:.0%} of scenes",
            f"above 3 times: {np.mean(shares > 3.0):.0%}; stated over true: smallest "
            f"{shares.min():.2f}, largest {shares.max():.2f}",
            f"smallest where the truth exceeds {LARGE:.0%}: {min(large, default=1.0):.2f}",
            f"smallest stated error where the truth exceeds {HUGE:.0%}: "
            f"{min(huge, default=1.0):.0%}",
        ]
    return lines


def _percent(value):
    return "      -" if value is None else f"{100 * value:7.2f}"


def main(arguments):
    seed, count, kind = int(arguments[0]), int(arguments[1]), "".join(arguments[2:3])
    judgements, begin = [], time.perf_counter()
    for scene in scenes(seed, count, STEPS if kind == "full" else ()):
        if kind == "accuracy":
            accuracy = {"displacement": 0.01, "energy": 0.02}
            keys = scene.model_dump(exclude_unset=True) | {"accuracy": accuracy}
            scene = scene_from(keys, scene.named_mesh)
        judgements.append(judgement := judged(scene))
        pairs = ((judgement.stated.get(q), judgement.true.get(q)) for q in QUANTITIES)
        cells = "  ".join(f"{_percent(a)} /{_percent(b)}" for a, b in pairs)
        print(f"{judgement.what:62s} {judgement.refused[:90] or cells}", flush=True)
    print(*report(judgements), f"{time.perf_counter() - begin:.0f} s", sep="\n")


if __name__ == "__main__":
    main(sys.argv[1:])
