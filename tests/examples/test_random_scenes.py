"""Scenes drawn at random for the estimates: drawn again alike, loaded as said, judged right."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from benchmarks import estimates
from benchmarks.estimates import Row, report, table
from benchmarks.scenes import CLASSES, LOADS, draw
from benchmarks.shapes import share_of_slip

from skfem_joint.results.history import QUANTITIES

ROOT = Path(__file__).parents[2]
#: Classes whose scenes take a second each; two of them are drawn below.
DEAR = ("solids", "plates-bolted", "laps-opening")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("drawn")


@pytest.fixture(scope="module")
def drawn(folder):
    """Number 1 of the scenes of a class, drawn once."""
    return cache(lambda kind: draw(kind, 1, 1, folder))


@cache
def of_seed_11(kind, number):
    """Rows of a scene, measured once."""
    return estimates.measured(kind, 11, number, ("full", "reduced"))


@pytest.mark.parametrize("kind", [kind for kind in CLASSES if kind not in DEAR])
def test_a_scene_is_drawn_by_its_class_seed_and_number_alone(kind, drawn, folder):
    one, again = (found.scene for found in (drawn(kind), draw(kind, 1, 1, folder)))
    assert one.model_dump(warnings=False) == again.model_dump(warnings=False)
    assert one.system().contact.count > 0


def test_another_seed_has_another_scene(drawn, folder):
    one, other = (found.scene for found in (drawn("bars"), draw("bars", 2, 1, folder)))
    assert one.model_dump(warnings=False) != other.model_dump(warnings=False)


def test_all_kinds_of_load_are_drawn_alike(tmp_path):
    drawn = [draw("matrices", 4, number, tmp_path).load for number in range(len(LOADS))]
    assert sorted(drawn) == sorted(LOADS)


@pytest.mark.parametrize("kind", ["bars", "plates-bolted", "solids"])
def test_loads_are_the_share_of_slip_that_was_drawn(kind, drawn):
    """The load that makes a joint slip is found within two percent where friction alone holds."""
    found = drawn(kind)
    assert share_of_slip(found.scene) == pytest.approx(found.share, rel=0.02)


def test_the_page_describes_all_classes_and_no_others():
    page = (ROOT / "docs" / "verification" / "estimates.md").read_text(encoding="utf-8")
    assert re.findall(r"(?m)^\| `([a-z-]+)` \|", page) == [*CLASSES]


def _row(stated, true, doubt=0.0, **others):
    values = {"kind": "bars", "seed": 1, "number": 0, "model": "full", "load": "table"} | others
    by_name = [dict(zip(QUANTITIES, x, strict=True)) for x in (stated, true, 4 * [doubt])]
    return Row(*values.values(), share=0.5, stated=by_name[0], true=by_name[1], doubt=by_name[2])


def test_shares_of_the_table_are_those_of_the_rows():
    rows = [
        _row([0.01, 0.004, 0.02, 0.001], [0.01, 0.01, 0.005, 0.002]),  # good, below, above; small
        _row([0.01, 0.01, 0.01, 0.01], [0.01, 0.01, 0.01, 0.0005], number=1),  # below 0.1 %: not
        _row([0.001, 0.01, 0.01, 0.01], [0.05, 0.01, 0.01, 0.01], number=2),
        _row(4 * [0.01], 4 * [0.5], doubt=0.2, number=3),  # the truth has not converged
        Row("bars", 1, 4, "full", "table", 0.5, refused="InputError: no"),
    ]
    cells = [cell.strip() for cell in table(rows)[2].strip("|").split("|")]
    assert cells[:5] == ["bars", "full", "5", "1", "10"]
    assert cells[5:9] == ["70 %", "20 %", "10 %", "33 % of 3"]
    assert cells[9:] == ["100 % of 1", "1 of 1", "0.02", "4"]
    text = "\n".join(report(rows))
    assert "stated 0.1 % of 5 %, displacement rms: bars --seed 1 --only 2, full, table" in text
    assert "refused 1 times: InputError: no (the first: bars --seed 1 --only 4, full)" in text


def test_accuracies_are_met_nearly_met_missed_and_refused():
    errors = [(0.009, "met"), (0.014, "nearly"), (0.03, "missed")]
    rows = [_row(4 * [0.01], [error, 0.0, 0.0, 0.0], number=k, model="accuracy 1 %")
            for k, (error, _) in enumerate(errors)]  # fmt: skip
    rows.append(Row("bars", 1, 3, "accuracy 1 %", "", 0.0, refused="ConvergenceError: no"))
    said = report(rows)
    assert "| bars | 1 % | 4 | 33 % | 33 % | 33 % | 25 % |" in said
    assert "- missed by 3: bars --seed 1 --only 2, accuracy 1 %, table" in said


def test_the_command_runs_scenes_by_their_numbers_alone(capsys):
    estimates.main(["bars", "--seed", "11", "--model", "full", "--only", "1"])
    made, _ = of_seed_11("bars", 1)
    said = capsys.readouterr().out
    assert said.count("| bars | full | 1 |") == 1
    assert all(f"/{100.0 * error:.2f}" in said for error in made.true.values() if error is not None)


@pytest.mark.parametrize(("kind", "count"), [("bars", 3), ("matrices", 2)])
def test_scenes_at_random_state_their_errors(kind, count):
    rows = [row for n in range(count) for row in of_seed_11(kind, n)]
    pairs = [pair for row in rows for pair in row.pairs()]
    assert len(pairs) >= 8
    assert np.mean([0.5 * true <= stated <= 3.0 * true for _, stated, true in pairs]) >= 0.8
