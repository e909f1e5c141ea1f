"""Stated over true errors of results, for scenes drawn at random by class.

    python examples/benchmarks/estimates.py plates-bolted --seed clock --count 40 --jobs 2
    python examples/benchmarks/estimates.py bars solids --seed 7 --model full reduced
    python examples/benchmarks/estimates.py plates-bolted --seed 7 --model accuracy
    python examples/benchmarks/estimates.py plates-side solids --seed 7 --model mesh
    python examples/benchmarks/estimates.py bars --seed 7 --only 12

Each model of a scene is run alone, as its user would, and compared with the truth: the full model
at 8 times the steps, extrapolated from half as many. That is on the mesh of the scene: errors by
the mesh are judged apart, with ``--model mesh``, by quadratic elements on a mesh refined once, in
the same steps.
"""

import argparse
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks.scenes import CLASSES, Drawn, draw

# isort: split

import numpy as np

from skfem_joint import run_scene
from skfem_joint.accuracy.estimate import verification_run
from skfem_joint.ground.errors import JointError
from skfem_joint.ground.processes import Spawn
from skfem_joint.mesh import refined
from skfem_joint.reduction.condensed import condense
from skfem_joint.results.history import QUANTITIES, Results, difference, extrapolation, results
from skfem_joint.scene import Scene
from skfem_joint.study.models import plan_of

MODELS = ("full", "reduced", "condensed")
#: What else ``--model`` takes.
OTHERS = ("accuracy", "mesh")
#: Errors by the mesh are stated for the full model; those above this are judged.
OF_MESH, COARSE = "mesh", 2e-2
#: Contact points up to which a condensed model is faster than a full one.
FEW = 300
#: Largest errors that are asked for with ``--model accuracy``.
ASKED = (0.02, 0.01, 0.005)
#: True errors above the first are judged; those down to the second, and above the third, apart.
JUDGED, SMALL, LARGE = 3e-3, 1e-3, 2e-2
#: Stated over true error that counts as good, and as far too small.
GOOD, BAD = (0.5, 3.0), 0.3
#: Share of its error up to which the truth of a quantity may be in doubt.
SURE = 0.25
#: Steps of the truth for each step of the scene; estimates take 4.
FINER = 8
#: An accuracy that is missed by less than this factor is nearly met.
NEARLY = 1.5
Errors = dict[str, float | None]


@dataclass(frozen=True)
class Row:
    """One model of one scene.

    Attributes
    ----------
    kind, seed, number : str, int, int
        Class, seed and number of the scene.
    model : str
        Its name, or "accuracy" and what was asked for.
    load : str
        Kind of load.
    share : float
        Load over the one that makes a joint slip as a whole.
    stated, true : dict of str to float or None
        Errors by quantity; empty if the scene was refused.
    doubt : dict of str to float or None
        Difference of the truth from its finest run, relative.
    refused : str
        Why there is no result.
    seconds : float
        Processor time of the model with its estimate, s.
    truth_seconds : float
        Processor time of the truth, s.
    """

    kind: str
    seed: int
    number: int
    model: str
    load: str
    share: float
    stated: Errors = field(default_factory=dict)
    true: Errors = field(default_factory=dict)
    doubt: Errors = field(default_factory=dict)
    refused: str = ""
    seconds: float = 0.0
    truth_seconds: float = 0.0

    @property
    def scene(self) -> str:
        """Class, seed and number, as the command takes them."""
        return f"{self.kind} --seed {self.seed} --only {self.number}"

    def pairs(self, low: float = JUDGED, high: float = np.inf) -> list[tuple[str, float, float]]:
        """Quantity, stated and true error of those with a sure truth between two bounds."""
        found = []
        for name in QUANTITIES:
            stated, true = self.stated.get(name), self.true.get(name)
            if stated is None or true is None or not low < true <= high:
                continue
            if self.is_sure(name):
                found.append((name, stated, true))
        return found

    def is_sure(self, name: str) -> bool:
        """Whether the truth of a quantity has itself converged."""
        return (self.doubt.get(name) or 0.0) <= SURE * (self.true.get(name) or 0.0)


# %% Measuring


@dataclass(frozen=True)
class Truth:
    """Results that hardly err, and how far the finest run behind them is from them."""

    results: Results
    doubt: Errors


def truth_of(scene: Scene) -> Truth:
    """Results of the full model with far smaller steps, extrapolated."""
    system, plan = scene.system(), plan_of(scene)
    rough, fine = (results(verification_run(system, plan.finer(k))) for k in (FINER // 2, FINER))
    best = fine.plus(extrapolation(2.0**2) - 1.0, fine, rough)
    return Truth(best, difference(best, fine))


def truth_of_mesh(scene: Scene) -> Truth:
    """Results on far smaller elements of second order, or, of bars, of first order."""
    mesh, plan = scene.named_mesh, plan_of(scene)
    fine = refined(refined(mesh)) if mesh.dim == 1 else replace(mesh, order=2)
    tables = {"output": {"points": scene.output_points}}
    if mesh.dim > 1:  # elements of second order are not lumped
        tables["material"] = {"mass_matrix": "consistent"}
    systems = (scene.changed(mesh=m, **tables).system() for m in (fine, refined(fine)))
    rough, best = (
        results(verification_run(condense(s) if s.contact.count < FEW else s, plan))
        for s in systems
    )
    change = difference(best, rough)  # about half of which is left
    return Truth(best, {name: None if e is None else 0.5 * e for name, e in change.items()})


def judged(scene: Scene, truth: Truth | None = None, of_mesh: bool = False) -> Row:
    """Run the only model of a scene and compare its stated errors with the truth.

    Errors ``of_mesh`` are those of the mesh alone, others those without it. The truth is computed
    if it is not given, with the steps that the model took.
    """
    (name,) = scene.models.run
    begin = time.process_time()
    try:
        model = run_scene(scene).models[name]
    except JointError as error:
        refused = f"{type(error).__name__}: {error}"
        return Row("", 0, 0, name, "", 0.0, refused=refused, seconds=time.process_time() - begin)
    seconds, begin = time.process_time() - begin, time.process_time()
    truth = truth or truth_of(scene)
    every = (len(model.run.point_u) - 1) // max(len(truth.results.point_u) - 1, 1)
    found = results(model.run, max(every, 1))  # steps that were halved for an accuracy
    stated = {} if model.estimate is None else model.estimate.on_its_mesh
    if of_mesh:
        stated = {} if model.estimate is None else model.estimate.parts.get(OF_MESH, {})
    return Row(
        *("", 0, 0, name, "", 0.0),
        stated=stated,
        true=difference(truth.results, found),
        doubt=truth.doubt,
        seconds=seconds,
        truth_seconds=time.process_time() - begin,
    )


def judged_mesh(scene: Scene) -> Row:
    """The same for errors by the mesh alone; of no scene whose steps a finer mesh does not take."""
    try:
        truth = truth_of_mesh(scene)
    except JointError as error:
        return Row("", 0, 0, OF_MESH, "", 0.0, refused=f"{type(error).__name__}: {error}")
    return judged(scene, truth, of_mesh=True)


def measured(kind: str, seed: int, number: int, models: tuple[str, ...]) -> list[Row]:
    """Rows of one scene."""
    with TemporaryDirectory() as folder:
        begin = time.process_time()
        try:
            drawn = draw(kind, seed, number, Path(folder))
            truth = truth_of(drawn.scene) if {*models} - {OF_MESH} else None
        except JointError as error:
            refused = f"{type(error).__name__}: {error}"
            return [Row(kind, seed, number, m, "", 0.0, refused=refused) for m in models]
        spent, rows = time.process_time() - begin, []
        for name, scene in _variants(drawn, models):
            made = judged_mesh(scene) if name == OF_MESH else judged(scene, truth)
            of_scene = {"kind": kind, "seed": seed, "number": number, "truth_seconds": spent}
            of_load = {"load": drawn.load, "share": drawn.share}
            rows.append(replace(made, model=name, **of_scene, **of_load))
    return rows


def _variants(drawn: Drawn, models):
    """Names and scenes of a model each; for accuracies the reduced model, once for each."""
    for name in models:
        if name == OF_MESH:
            yield name, drawn.scene.changed(models={"run": ["full"]})
            continue
        if name != "accuracy":
            yield name, drawn.scene.changed(models={"run": [name]})
            continue
        for asked in ASKED:
            accuracy = {"displacement": asked, "energy": asked}
            scene = drawn.scene.changed(models={"run": ["reduced"]}, accuracy=accuracy)
            yield f"accuracy {100 * asked:g} %", scene


# %% Tables


def _percent(part, whole):
    return "-" if not whole else f"{100.0 * part / whole:.0f} %"


def table(rows: list[Row]) -> list[str]:
    """Table in Markdown of how far stated errors hold, a line for each class and model."""
    columns = ("class", "model", "scenes", "refused", "quantities with errors above 0.3 %")
    columns += ("stated at 0.5 to 3 times the truth", "below 0.5", "above 3")
    columns += ("scenes with all of them there", "0.1 to 0.3 %: stated there")
    columns += ("above 2 %: below 0.3", "smallest", "truth in doubt")
    lines = [_cells(columns), _cells(["---"] * len(columns))]
    for kind, model in dict.fromkeys((row.kind, row.model) for row in rows):
        of = [row for row in rows if (row.kind, row.model) == (kind, model)]
        lines.append(_cells([kind, model, *_counts(of)]))
    if len({row.kind for row in rows}) > 1:
        for model in dict.fromkeys(row.model for row in rows):
            of = [row for row in rows if row.model == model]
            lines.append(_cells(["all", model, *_counts(of)]))
    return lines


def _cells(values):
    return f"| {' | '.join(map(str, values))} |"


def _good(stated, true):
    return GOOD[0] * true <= stated <= GOOD[1] * true


def _spread(ratios):
    """Number of ratios of stated to true errors, and the shares that are good, below and above."""
    found = np.asarray(ratios)
    below, above = found < GOOD[0], found > GOOD[1]
    yield found.size
    yield from (_percent(np.sum(some), found.size) for some in (~(below | above), below, above))


def _doubtful(rows, least):
    """Number of errors above a least one whose truth is in doubt."""
    return sum(
        (row.true.get(name) or 0.0) > least and not row.is_sure(name)
        for row in rows
        for name in QUANTITIES
    )


def _counts(rows):
    """Cells of a line of the table."""
    scenes = [pairs for row in rows if (pairs := row.pairs())]
    ratios = [a / b for pairs in scenes for _, a, b in pairs]
    small = [(a, b) for row in rows for _, a, b in row.pairs(SMALL, JUDGED)]
    large = [a / b for row in rows for _, a, b in row.pairs(LARGE)]
    whole = sum(all(_good(a, b) for _, a, b in pairs) for pairs in scenes)
    return [
        len(rows),
        sum(bool(row.refused) for row in rows),
        *_spread(ratios),
        f"{_percent(whole, len(scenes))} of {len(scenes)}",
        f"{_percent(sum(_good(*pair) for pair in small), len(small))} of {len(small)}",
        f"{sum(ratio < BAD for ratio in large)} of {len(large)}",
        f"{min(large):.2f}" if large else "-",
        _doubtful(rows, JUDGED),
    ]


def accuracies(rows: list[Row]) -> list[str]:
    """Table in Markdown of accuracies that were asked for."""
    columns = (
        "class",
        "asked",
        "scenes",
        "met",
        "missed by at most 1.5",
        "missed by more",
        "refused",
    )
    lines = [_cells(columns), _cells(["---"] * len(columns))]
    for kind, model in dict.fromkeys((row.kind, row.model) for row in rows):
        of = [row for row in rows if (row.kind, row.model) == (kind, model)]
        run = [row for row in of if not row.refused]
        over = np.array([_excess(row) for row in run])
        cells = [_percent(n, len(run)) for n in (
            np.sum(over <= 1.0), np.sum((over > 1.0) & (over <= NEARLY)), np.sum(over > NEARLY)
        )]  # fmt: skip
        cells.append(_percent(len(of) - len(run), len(of)))
        lines.append(_cells([kind, model.removeprefix("accuracy "), len(of), *cells]))
    return lines


def meshes(rows: list[Row]) -> list[str]:
    """Table in Markdown of errors by the mesh, of all quantities and of friction energy."""
    columns = ("class", "scenes", "refused", "too large to be stated", "errors above 2 %")
    columns += ("stated at 0.5 to 3 times the truth", "below 0.5", "above 3")
    columns += ("friction energy: errors above 2 %", "stated there", "truth in doubt")
    lines = [_cells(columns), _cells(["---"] * len(columns))]
    for kind in [*dict.fromkeys(row.kind for row in rows), "all"]:
        of = [row for row in rows if kind in (row.kind, "all")]
        pairs = [pair for row in of for pair in row.pairs(COARSE)]
        energy = [_good(a, b) for name, a, b in pairs if name == "friction_energy"]
        cells = [
            len(of),
            sum(bool(row.refused) for row in of),
            sum(not row.refused and not row.stated for row in of),
            *_spread([a / b for _, a, b in pairs]),
            len(energy),
            _percent(sum(energy), len(energy)),
            _doubtful(of, COARSE),
        ]
        lines.append(_cells([kind, *cells]))
    return lines


def _excess(row):
    """Largest true error over the accuracy asked for, of quantities with a sure truth."""
    asked = float(row.model.split()[1]) / 100.0
    sure = [e for name in QUANTITIES if (e := row.true.get(name)) and row.is_sure(name)]
    return max(sure, default=0.0) / asked


def cases(rows: list[Row]) -> list[str]:
    """Lines on what was refused, and on each case that is stated far too small or missed by far."""
    lines = []
    for row in rows:
        if row.model.startswith("accuracy"):
            if not row.refused and _excess(row) > NEARLY:
                lines.append(
                    f"- missed by {_excess(row):.2g}: {row.scene}, {row.model}, {row.load}"
                )
            continue
        lines += [
            f"- stated {100 * a:.2g} % of {100 * b:.2g} %, {name.replace('_', ' ')}: {row.scene}, "
            f"{row.model}, {row.load}, {100 * row.share:.0f} % of slip"
            for name, a, b in row.pairs(LARGE)
            if a < BAD * b
        ]
    reasons = Counter(_reason(row.refused) for row in rows if row.refused)
    first = {_reason(row.refused): row for row in reversed(rows) if row.refused}
    lines += [
        f"- refused {count} times: {reason} (the first: {first[reason].scene}, "
        f"{first[reason].model})"
        for reason, count in reasons.most_common()
    ]
    return lines


def _reason(message):
    """What a refusal says, without its numbers and the name of the scene's file."""
    words = message.split("scene.toml: ")[-1] if "scene.toml: " in message else message
    return "".join("…" if c.isdigit() else c for c in words)[:110].replace("\n", " ")


def parts(rows: list[Row]) -> list[str]:
    """Lines on the shares of good statements by load and by quantity."""
    lines = []
    for model in dict.fromkeys(row.model for row in rows):
        of = [(row.load, *pair) for row in rows if row.model == model for pair in row.pairs()]
        for what, column in (("load", 0), ("quantity", 1)):
            said = []
            for name in sorted({each[column] for each in of}):
                good = [_good(*each[2:]) for each in of if each[column] == name]
                share = _percent(sum(good), len(good))
                said.append(f"{name.replace('_', ' ')} {share} of {len(good)}")
            if said:
                lines.append(f"- {model}, by {what}: {', '.join(said)}")
    return lines


def report(rows: list[Row]) -> list[str]:
    """All tables and cases of rows."""
    plain = [row for row in rows if not row.model.startswith(OTHERS)]
    coarse = [row for row in rows if row.model == OF_MESH]
    asked = [row for row in rows if row.model.startswith("accuracy")]
    lines = []
    if plain:
        lines += [*table(plain), "", *parts(plain)]
    if asked:
        lines += [*([""] if lines else []), *accuracies(asked), ""]
    if coarse:
        lines += [*([""] if lines else []), *meshes(coarse), ""]
    return lines + cases(rows)


# %% The command


def _line(row: Row) -> str:
    """One row as it comes: stated and true errors of each quantity, in percent."""
    said = row.refused.replace("\n", " ")[-100:]
    if not said:
        both = ((row.stated.get(name), row.true.get(name)) for name in QUANTITIES)
        said = "  ".join("/".join("-" if e is None else f"{100 * e:.2f}" for e in p) for p in both)
    return (
        f"{row.kind} {row.seed} {row.number} {row.model} [{row.load}]: {said} {row.seconds:.1f} s"
    )


def _seed(word):
    return int(time.time_ns() // 1000 % 10**9) if word == "clock" else int(word)


def main(arguments=None):
    """Draw, run, judge and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    named = f"all, or any of {', '.join(CLASSES)}"
    parser.add_argument(
        "classes", nargs="+", choices=("all", *CLASSES), metavar="CLASS", help=named
    )
    clock = "numbers, or 'clock' for one from the clock, which is printed"
    parser.add_argument("--seed", nargs="+", type=_seed, default=[1], metavar="SEED", help=clock)
    parser.add_argument("--count", type=int, default=40, help="scenes of each class and seed")
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER", help="only these scenes")
    parser.add_argument("--model", nargs="+", choices=(*MODELS, *OTHERS), default=MODELS)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    options = parser.parse_args(arguments)
    begin = time.perf_counter()
    kinds = tuple(CLASSES) if "all" in options.classes else tuple(options.classes)
    numbers = range(options.count) if options.only is None else options.only
    scenes = sorted((kind, seed, n) for kind in kinds for seed in options.seed for n in numbers)
    print(f"seeds {' '.join(map(str, options.seed))}, scenes of {', '.join(kinds)}", flush=True)
    rows, judge = [], partial(measured, models=tuple(options.model))
    with ProcessPoolExecutor(options.jobs, mp_context=Spawn()) as pool:
        for found in pool.map(judge, *zip(*scenes, strict=True)):
            rows += found
            print(*map(_line, found), sep="\n", flush=True)
    order = {name: k for k, name in enumerate(kinds)}
    models = {name: k for k, name in enumerate(MODELS)}
    rows.sort(key=lambda r: (order[r.kind], models.get(r.model, 9), r.seed, r.number))
    spent = sum(row.seconds for row in rows)
    spent += sum({(r.kind, r.seed, r.number): r.truth_seconds for r in rows}.values())
    print("", *report(rows), "", sep="\n")
    print(f"Seeds {' '.join(map(str, options.seed))}; {time.perf_counter() - begin:.0f} s, "
          f"{spent:.0f} s of processor time.")  # fmt: skip


if __name__ == "__main__":
    main()
