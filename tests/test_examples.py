"""The examples give the numbers they speak of."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"
TABLE_1 = (86.55, 10.24, 1.70, 0.73, 0.29)  # percent


def run(name: str, run_name: str = "example") -> dict[str, Any]:
    return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name=run_name)


@pytest.fixture(scope="module")
def lap_joint() -> dict[str, Any]:
    return run("lap_joint")


@pytest.fixture(scope="module")
def reduced_structure() -> dict[str, Any]:
    return run("reduced_structure")


def test_lap_joint_has_the_proper_values_of_table_1(lap_joint: dict[str, Any]) -> None:
    assert lap_joint["proper"].proper_values[:5] == pytest.approx(TABLE_1, abs=0.1)


def test_lap_joint_moves_a_little_more_than_its_pseudo_static_closed_form(
    lap_joint: dict[str, Any],
) -> None:
    # Peak F^2 / (2 EA tau) with EA = 100 MN and tau = 0.7 x 8 MPa x 50 mm; inertia adds to it.
    assert lap_joint["peak_static"] == pytest.approx(63e3**2 / (2 * 100e6 * 280e3), rel=1e-12)
    assert 1.0 < lap_joint["peak"] / lap_joint["peak_static"] < 1.1


def test_lap_joint_balances_its_energies(lap_joint: dict[str, Any]) -> None:
    assert lap_joint["run"].energy_residual < 1e-12
    # Pseudo-static loss of a cycle, 2 F^3 / (3 EA tau), from Masing's loops.
    loss = 2 * 63e3**3 / (3 * 100e6 * 280e3)
    assert 1.0 < lap_joint["run"].cycles.friction[-1] / loss < 1.15


def test_active_length_of_the_structure_is_that_of_the_paper(
    reduced_structure: dict[str, Any],
) -> None:
    # Section 7.3: half of the 100 mm that a slow force would make slip, times 1.05.
    length = reduced_structure["guess"].length
    assert length / 50e-3 == pytest.approx(1.05, abs=0.005)
    assert reduced_structure["guess"].factors[-1] == pytest.approx(length / 50e-3, rel=1e-2)


def test_reduced_structure_is_small_and_close_to_the_full_one(
    reduced_structure: dict[str, Any],
) -> None:
    # Five modes, the static response and two interface modes; a Gauss rule of twelve points.
    reduced, full = reduced_structure["reduced_system"], reduced_structure["system"]
    assert (full.n, full.contact_points) == (200, 100)
    assert reduced.n == 8
    errors = reduced_structure["errors"]
    assert abs(errors.peak_displacement) < 0.005
    assert abs(errors.friction_energy_per_cycle) < 0.05


def test_lap_joint_as_a_script_prints_and_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OUT", str(tmp_path / "out"))
    run("lap_joint", "__main__")
    assert "[86.55 10.24  1.7   0.73  0.29]" in capsys.readouterr().out
    assert [path.name for path in tmp_path.rglob("*.png")] == ["lap_joint_loop.png"]


def test_reduced_structure_as_a_script_prints_its_sizes(capsys: pytest.CaptureFixture[str]) -> None:
    run("reduced_structure", "__main__")
    assert "unknowns: 200 full, 8 reduced" in capsys.readouterr().out
