"""What an item of the paper (a table, a figure, a section) yields when it is reproduced."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """One number of an item.

    Attributes
    ----------
    quantity : str
        What it is, with its unit.
    published : float, str or None
        As printed in the paper; a string for statements such as ``< 1 %``.
    full, reduced : float, str or None
        Ours.
    difference : str
        Of ours from the published value, in words or percent.
    verdict : str
        ``agrees``, ``better than published``, ``differs: why``, ...
    form : str
        Format of our numbers.
    """

    quantity: str
    published: float | str | None
    full: float | str | None = None
    reduced: float | str | None = None
    difference: str = ""
    verdict: str = ""
    form: str = ".4g"


@dataclass
class Item:
    """A reproduced table, figure or section.

    Attributes
    ----------
    key : str
        As on the command line: ``table3``, ``fig19``, ``section7.5``.
    title : str
    rows : list of Row
    notes : list of str
        Paragraphs: what was assumed, what the paper leaves out or contradicts, how much it matters.
    pictures : list of Path
        Names of PNG files inside the output folder.
    curves : dict
        CSV tables by file name: column name (with unit) -> values of one length.
    """

    key: str
    title: str
    rows: list[Row] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    pictures: list[Path] = field(default_factory=list)
    curves: dict[str, dict[str, FloatArray]] = field(default_factory=dict)


@cache
def published() -> dict[str, Any]:
    """Published values by item; see ``published.toml``."""
    return tomllib.loads(files("skfem_joint.paper").joinpath("published.toml").read_text("utf-8"))


def percent(ours: float, reference: float) -> float:
    """Difference of ``ours`` from ``reference``, percent."""
    return 100.0 * (ours / reference - 1.0)


def against(
    quantity: str,
    printed: float,
    full: float | None,
    *,
    within: float,
    reduced: float | None = None,
    otherwise: str = "differs",
    form: str = ".4g",
) -> Row:
    """Row of a published number: it agrees if ours (the full model's) is within its rounding.

    Parameters
    ----------
    within : float
        Half a unit of the last printed digit, or the tolerance that the paper itself states.
    otherwise : str
        Verdict when it does not agree: say why.
    """
    ours = full if full is not None else reduced
    if ours is None:
        raise ValueError(f"{quantity}: no value of ours")
    agrees = abs(ours - printed) <= within * (1.0 + 1e-12)
    return Row(
        quantity,
        printed,
        full,
        reduced,
        difference=f"{percent(ours, printed):+.2g} %" if printed else f"{ours - printed:+.3g}",
        verdict="agrees" if agrees else otherwise,
        form=form,
    )
