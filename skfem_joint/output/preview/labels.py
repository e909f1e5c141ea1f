"""Labels above a preview's drawing, in rows in which they do not overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import isotonic_regression

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.output.preview import colours
from skfem_joint.output.preview.drawing import Reach
from skfem_joint.output.preview.marks import Preview
from skfem_joint.output.preview.projection import Projection

#: Distance of labels from both sides of the sheet, inches.
_AWAY = 0.2


@dataclass(frozen=True)
class Labels:
    """Where the labels of a preview's marks stand, in inches.

    Attributes
    ----------
    places : ndarray, shape (marks, 2)
        What they point at, mm.
    middles : ndarray, shape (marks,)
        Their middles, from the left side of the sheet.
    rows : ndarray of int, shape (marks,)
        Their rows, from the lowest up.
    heights : list of float
        Height of each row.
    """

    places: FloatArray
    middles: FloatArray
    rows: IntArray
    heights: list[float]

    @staticmethod
    def of(preview: Preview, projection: Projection, reach: Reach, width: float) -> Labels:
        """Labels on a sheet of a width in inches, as near to their places as fits."""
        places = np.array([reach.anchor(projection, mark) for mark in preview.marks])
        at = (places - reach.low) / (reach.high - reach.low) * reach.frame
        texts = [mark.text.split("\n") for mark in preview.marks]
        widths = np.array([0.25 + 0.077 * max(map(len, lines)) for lines in texts])
        wanted = at[:, 0] + 0.5 * (width - reach.frame[0]) - _AWAY
        counts = [len(lines) for lines in texts]
        middles, rows, heights = placed(wanted, widths, counts, width - 2 * _AWAY)
        return Labels(places, middles + _AWAY, rows, heights)

    def draw(self, preview: Preview, panel: Any, size: tuple[float, float], bottom: float) -> None:
        """Write the labels above a height of the sheet, with a line to each place.

        ``size`` is that of the sheet.
        """
        from matplotlib.patheffects import withStroke

        on_white = withStroke(linewidth=2.2, foreground="white", alpha=0.75)  # on dark joints too
        bottoms = bottom + np.cumsum([0.0, *self.heights])
        for mark, place, middle, row in zip(
            preview.marks, self.places, self.middles, self.rows, strict=True
        ):
            colour = colours.OF_KIND[mark.kind]
            at = (middle / size[0], (bottoms[row] + 0.05) / size[1])
            line = panel.annotate(
                "", xy=place, xytext=at, textcoords="figure fraction", zorder=10,
                annotation_clip=False,
                arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.7, "shrinkA": 0.0,
                            "shrinkB": 0.0},
            )  # fmt: skip
            line.arrow_patch.set_path_effects([on_white])
            panel.figure.text(  # above all lines
                *at, mark.text, parse_math=False, ha="center", va="bottom", fontsize=9,
                color=colour, bbox={"boxstyle": "round,pad=0.12", "facecolor": "white",
                                    "edgecolor": "none", "alpha": 0.9},
            )  # fmt: skip
            panel.scatter(*place, s=14, color=colour, edgecolors="white", linewidths=0.6,
                          zorder=11, clip_on=False)  # fmt: skip


def placed(
    wanted: FloatArray, widths: FloatArray, lines: Sequence[int], width: float
) -> tuple[FloatArray, IntArray, list[float]]:
    """Middles (inches) and rows of labels that do not overlap, and the height of each row.

    ``wanted`` are the best middles, ``lines`` the numbers of lines.
    """
    rows = int(np.ceil(widths.sum() / (0.9 * width))) or 1
    while True:
        row, middle = np.zeros(len(wanted), np.intp), wanted.copy()
        order = np.argsort(wanted, kind="stable")
        row[order] = np.arange(len(wanted)) % rows
        fits = True
        for number in range(rows):
            own = order[row[order] == number]
            fits &= bool(widths[own].sum() <= width)
            middle[own] = _side_by_side(wanted[own], widths[own], width)
        if fits or rows >= len(wanted):
            break
        rows += 1
    heights = [0.17 * max([lines[int(k)] for k in np.flatnonzero(row == r)], default=0) + 0.14
               for r in range(rows)]  # fmt: skip
    return middle, row, heights


def _side_by_side(wanted: FloatArray, widths: FloatArray, width: float) -> FloatArray:
    """Middles of labels of given widths in a row, as near to the ascending wanted ones as fits."""
    before = np.cumsum(widths) - 0.5 * widths  # of labels that stand edge to edge
    shifts = isotonic_regression(wanted - before).x if wanted.size else before
    return np.asarray(before + np.clip(shifts, 0.0, max(width - widths.sum(), 0.0)))
