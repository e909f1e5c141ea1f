"""The figure of a preview: where everything stands on it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.files import needed
from skfem_joint.output.plots import new_figure
from skfem_joint.output.preview import colours
from skfem_joint.output.preview.bodies import draw_bodies
from skfem_joint.output.preview.drawing import Drawing, Reach
from skfem_joint.output.preview.faces import PANEL, ROW, draw_face, faces_of
from skfem_joint.output.preview.labels import Labels
from skfem_joint.output.preview.marks import Preview
from skfem_joint.output.preview.projection import Projection
from skfem_joint.output.preview.scales import draw_scales
from skfem_joint.output.preview.symbols import draw_symbols
from skfem_joint.output.preview.words import headings_of, legend_of, notes_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Width of the sheet, and what panels keep from its sides, inches.
_WIDTH, _MARGIN = 14.0, 0.75
#: Distance between two faces of joints side by side, inches.
_BETWEEN = 0.9


def preview_figure(preview: Preview) -> Figure:
    """Draw a preview.

    Raises
    ------
    InputError
        Without matplotlib, and for solids without pyvista or a GL library.
    """
    needed("matplotlib", "plot")
    return _Sheet(preview).figure


class _Sheet:
    """The figure of a preview, with lengths in inches from its lower left corner."""

    def __init__(self, preview: Preview) -> None:
        self.preview, projection = preview, Projection(preview.structure)
        reach = Reach.of(preview, projection, _WIDTH - 2 * _MARGIN)
        labels = Labels.of(preview, projection, reach, _WIDTH)
        self.notes, self.faces = notes_of(preview, projection, reach), faces_of(preview)
        # From below: notes, legend, faces of joints, drawing, labels, headings.
        self.bottom = 1.05 + 0.2 * len(self.notes)
        self.face_rows = int(np.ceil(len(self.faces) / 2))
        drawing_bottom = self.bottom + ROW * self.face_rows + 0.6
        labels_bottom = drawing_bottom + reach.frame[1] + 0.3
        self.height = labels_bottom + sum(labels.heights) + 0.75
        self.figure = new_figure(_WIDTH, self.height, layout=None)
        panel = self._panel(0.5 * (_WIDTH - reach.frame[0]), drawing_bottom, *reach.frame)
        panel.set_xlim(reach.low[0], reach.high[0])
        panel.set_ylim(reach.low[1], reach.high[1])
        norm = colours.scale_of_pressures(preview)
        self.drawing = Drawing(preview, projection, reach, panel, norm)
        draw_bodies(self.drawing)
        draw_symbols(self.drawing)
        draw_scales(self.drawing)
        labels.draw(preview, panel, (_WIDTH, self.height), labels_bottom)
        self._draw_faces()
        self._write_words()
        self._draw_legend()

    def _panel(self, left: float, bottom: float, wide: float, tall: float) -> Any:
        """Panel at a place."""
        box = (left / _WIDTH, bottom / self.height, wide / _WIDTH, tall / self.height)
        return self.figure.add_axes(box)

    def _draw_faces(self) -> None:
        """Draw the faces of joints of solids, two a row."""
        columns = min(2, len(self.faces))
        for number, mark in enumerate(self.faces):
            row, column = divmod(number, 2)
            wide = (_WIDTH - 2 * _MARGIN - _BETWEEN * (columns - 1)) / columns
            bottom = self.bottom + 0.5 + ROW * (self.face_rows - 1 - row)
            panel = self._panel(_MARGIN + column * (wide + _BETWEEN), bottom, wide, PANEL)
            draw_face(self.drawing, panel, mark)

    def _write_words(self) -> None:
        """Write headings and notes."""

        def write(x: float, y: float, text: str, **more: Any) -> None:
            self.figure.text(x / _WIDTH, y / self.height, text, parse_math=False, **more)

        title, overview = headings_of(self.preview)
        write(0.3, self.height - 0.33, title, fontsize=14, weight="bold")
        write(0.3, self.height - 0.58, overview, fontsize=10)
        for number, note in enumerate(self.notes):
            write(0.3, 0.15 + 0.2 * number, note, fontsize=9, color="#4a4f55")

    def _draw_legend(self) -> None:
        """Draw the legend, and the scale of the pressures."""
        from matplotlib.cm import ScalarMappable

        handles, level = legend_of(self.preview), (self.bottom - 0.45) / self.height
        self.figure.legend(handles=handles, loc="center left", ncols=len(handles), frameon=False,
                           bbox_to_anchor=(0.2 / _WIDTH, level), fontsize=9.5)  # fmt: skip
        if self.preview.of_kind("joint"):
            scale = self._panel(_WIDTH - 4.3, self.bottom - 0.5, 3.6, 0.14)
            mapped = ScalarMappable(self.drawing.norm, colours.of_pressures())
            bar = self.figure.colorbar(mapped, cax=scale, orientation="horizontal")
            bar.ax.set_title("pressure on the joints, MPa", fontsize=9.5)
            bar.ax.tick_params(labelsize=8.5)
