"""Harmonic runs of the jointed structure and their friction energy (section 7.3)."""

from __future__ import annotations

from functools import cache
from math import inf
from typing import Any

from skfem_joint.paper.cases import PLAIN, study
from skfem_joint.paper.items import Row, against, percent, published
from skfem_joint.paper.structure_case import CASE, CHOICES
from skfem_joint.study import Study

CYCLES, STEPS = 12, 200
LAWS = {1e5: "beta 1e5 s/m", 1e7: "beta 1e7 s/m", inf: "Coulomb"}
#: Steepest law that stands for Coulomb in a reduced model, s/m.
STEEPEST = 1e7


@cache
def harmonic(beta: float, plain: bool, modes: int = 5) -> Study:
    """Full and reduced structure at 500 Hz, with the fields for ParaView."""
    choice: dict[str, Any] = PLAIN | {"beta": min(beta, STEEPEST)} if plain else {}
    return study(
        CASE,
        time={"cycles": CYCLES, "steps_per_cycle": STEPS},
        run=("full", "reduced"),
        reduction=choice | {"modes": modes},
        beta=beta,
        output={"vtk": True, "frames": 240},
    )


def friction(study: Study, model: str) -> float:
    """Friction energy of a model in the last cycle, J."""
    return float(study.models[model].run.cycles.friction[-1])


def meshes(quick: bool) -> tuple[int, ...]:
    """Elements in the joint, and as many in the linear region."""
    return (50, 100) if quick else (25, 50, 100, 200)


def energies_by_mesh(quick: bool) -> list[float]:
    """Friction energy of the full model with Coulomb friction, by mesh and lumping, J."""
    runs = [
        study(
            CASE,
            time={"cycles": CYCLES, "steps_per_cycle": STEPS},
            beta=inf,
            elements=elements,
            normal_force=lumping,
        )
        for elements in meshes(quick)
        for lumping in ("equal", "consistent")
    ]
    return [friction(run, "full") for run in runs]


def energy_rows(runs: dict[tuple[float, bool], Study], spread: tuple[float, float]) -> list[Row]:
    """Rows of the friction energies; ``spread`` is what mesh and lumping make of it, J."""
    printed = published()["section7.3"]
    full, reduced = printed["friction_energy_full"], printed["friction_energy_reduced"]
    rows = [
        against(
            f"friction energy per cycle, full, {law}, J",
            full,
            friction(runs[beta, True], "full"),
            within=0.005,
            otherwise=f"differs: mesh and lumping, not printed, leave {spread[0]:.3f} to "
            f"{spread[1]:.3f} J with Coulomb, and a regularised law adds to it",
        )
        for beta, law in LAWS.items()
    ]
    rows += [
        against(
            f"friction energy per cycle, reduced, {law}, {CHOICES[plain]}, J",
            reduced,
            None,
            reduced=friction(runs[beta, plain], "reduced"),
            within=0.05,
        )
        for plain in CHOICES
        for beta, law in LAWS.items()
    ]
    stated = printed["friction_energy_error_percent"]
    for plain in CHOICES:
        for beta, law in LAWS.items():
            error = percent(
                friction(runs[beta, plain], "reduced"), friction(runs[beta, plain], "full")
            )
            rows.append(
                Row(
                    f"friction energy, reduced against full, {law}, {CHOICES[plain]}, %",
                    stated,
                    reduced=error,
                    difference=f"{error - stated:+.2g} points",
                    verdict="better than published" if abs(error) < stated else "differs",
                    form=".2g",
                )
            )
    implied = percent(reduced, full)
    rows.append(
        Row(
            "the same from the two printed energies, %",
            stated,
            reduced=implied,
            difference=f"{implied - stated:+.2g} points",
            verdict="agrees"
            if abs(implied - stated) <= 0.5
            else f"cannot be right: {reduced:.2f} / {full:.2f} is {implied:.1f} %",
            form=".2g",
        )
    )
    return rows
