"""Results of all kinds of models, contact and analyses beside those of ``frozen.json``.

Where a change of the numbers is meant, and the commit explains it, the file is renewed by

    python examples/benchmarks/frozen.py --without-times --out examples/benchmarks/frozen.json
"""

import json

import pytest
from benchmarks import frozen

BEFORE = json.loads(frozen.FROZEN.read_text(encoding="utf-8"))
QUICK = "bar, natural modes"


def test_every_result_is_in_the_file():
    assert BEFORE.keys() == frozen.RESULTS.keys()


@pytest.mark.slow
@pytest.mark.parametrize("name", frozen.RESULTS)
def test_results_are_what_they_were(name):
    now = frozen.measured(name, timed=False)
    apart, where = frozen.difference(BEFORE[name]["numbers"], now["numbers"])
    assert apart <= frozen.TOLERANCES[name], (
        f"{where} was {BEFORE[name]['numbers'].get(where)}, is {now['numbers'].get(where)}; where "
        "that is meant, renew the file as the head of this one says"
    )


def test_changes_are_seen(tmp_path, capsys):
    """In numbers, bits, counters and time, each by itself."""
    file = tmp_path / "out.json"
    assert frozen.main([QUICK, "--out", str(file)]) == 0
    kept = json.loads(file.read_text(encoding="utf-8"))
    capsys.readouterr()
    assert frozen.main([QUICK, "--without-times", "--against", str(file)]) == 0
    assert f"| {QUICK} | equal | 0 |  | unchanged |  |  |  |" in capsys.readouterr().out
    one = kept[QUICK]
    one |= {"bits": "", "counters": {"steps": 2}, "time": 1e9, "least": 1e9}
    one["numbers"]["frequencies"][0] *= 1.0 + 1e-3
    file.write_text(json.dumps(kept), encoding="utf-8")
    assert frozen.main([QUICK, "--against", str(file)]) == 1
    (line,) = (x for x in capsys.readouterr().out.splitlines() if QUICK in x)
    _, name, bits, apart, judged, counters, _, ratio, least, _ = (
        x.strip() for x in line.split("|")
    )
    assert (name, bits, judged) == (QUICK, "differ", "above 1e-09")
    assert (counters, float(ratio), float(least)) == ("steps 2 > 0", 0.0, 0.0)
    # relative to the largest of the six frequencies
    size = one["numbers"]["frequencies"]
    assert float(apart.split()[0]) == pytest.approx(1e-3 * size[0] / size[-1], rel=0.05)


@pytest.mark.parametrize(
    ("before", "now"), [({"a": [1.0, 2.0]}, {"a": [1.0, 2.0, 3.0]}), ({"a": 1.0}, {"b": 1.0})]
)
def test_other_sizes_and_names_are_infinitely_apart(before, now):
    assert frozen.difference(before, now)[0] == float("inf")
