"""The example of the two plates of Fig. 18(a) gives the numbers that its page speaks of."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skfem_joint import cli

EXAMPLES = Path(__file__).parent.parent / "examples"
PAGE = (EXAMPLES / "two_plates.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def example() -> dict[str, Any]:
    return runpy.run_path(str(EXAMPLES / "two_plates.py"))


@pytest.fixture(scope="module")
def struts(example: dict[str, Any]) -> list[Any]:
    models = [example[name]() for name in ("strut_b", "strut_a", "strut_in_series")]
    return [example["run_all"](model) for model in models]


def row(name: str) -> list[float]:
    """Numbers of a row of the page's table."""
    line = next(line for line in PAGE.splitlines() if line.startswith(f"| {name} |"))
    cells = (re.match(r" *([\d.]+)", cell) for cell in line.split("|")[2:-1])
    return [float(cell.group(1)) if cell else np.nan for cell in cells]


def test_the_page_has_the_numbers_of_the_struts(example: dict[str, Any], struts: list[Any]) -> None:
    for result in struts:
        resonance, end, friction, active, _, pulse = row(result.model.name)
        slipping = example["active_lengths"](result.model, result.coulomb)[0]
        assert example["resonance"](result.model, result.coulomb) == pytest.approx(resonance, abs=1)
        assert 1e6 * np.abs(result.end).max() == pytest.approx(end, abs=0.1)
        assert result.friction(result.harmonic) == pytest.approx(friction, abs=2e-3)
        assert 1e3 * slipping == pytest.approx(active, abs=0.1)
        assert result.friction(result.pulse) == pytest.approx(pulse, abs=2e-3)


def test_the_simplified_model_is_stiffer_and_loses_four_times_as_much(struts: list[Any]) -> None:
    simple, actual, _ = struts
    assert np.abs(simple.end).max() / np.abs(actual.end).max() == pytest.approx(0.945, abs=0.003)
    assert simple.friction(simple.harmonic) / actual.friction(actual.harmonic) == pytest.approx(
        4.0, abs=0.05
    )


def test_half_of_the_joint_in_series_is_the_whole(
    example: dict[str, Any], struts: list[Any]
) -> None:
    _, whole, half = struts
    for name in ("end", "pulse_end"):
        assert example["difference"](getattr(half, name), getattr(whole, name)) < 1e-8
    assert half.friction(half.pulse) == pytest.approx(whole.friction(whole.pulse), rel=1e-6)


def test_a_slow_load_meets_the_closed_form(
    example: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    models = [example[name](100, 10) for name in ("strut_b", "strut_a")]
    runs = {model.name: (model, example["slow"](model)) for model in models}
    example["print_slow"](runs)
    lines = capsys.readouterr().out.splitlines()[2:]
    assert len(lines) == 2
    for line in lines:
        numbers = [float(number) for number in re.findall(r"\d+\.\d+", line)]
        np.testing.assert_allclose(numbers[0:6:2], numbers[1:6:2], rtol=0.01)
        assert numbers[6] == pytest.approx(numbers[7], abs=1.5)


def test_pulled_plates_are_antisymmetric(example: dict[str, Any]) -> None:
    """In plan view, where nodes match: turned about the joint's middle the plates change places."""
    model = example["plate_a"]()
    run = example["integrate"](
        model.system, step=2e-5, n_steps=10, save=example["Save"](fields=True)
    )
    nodes = model.structure.nodes
    turned = np.array([1.2, 0.05]) - nodes
    u = model.structure.expand(run.u)[-1]
    order, other = (np.lexsort(np.round(x, 6).T[::-1]) for x in (nodes, turned))
    body = model.structure.body
    for upper, lower in ((0, 1), (1, 0)):
        here, there = order[body[order] == upper], other[body[other] == lower]
        np.testing.assert_allclose(nodes[here], turned[there], atol=1e-9)
        np.testing.assert_allclose(u[here], -u[there], atol=1e-7 * np.abs(u).max())


def test_the_scene_is_sound(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", str(EXAMPLES / "two_plates.toml")]) == 0
    assert "3258" in capsys.readouterr().out
