"""Picture of a ParaView series without a display: bodies coloured by their friction traction.

    python examples/render.py out/fields.pvd picture.png

Needs the extra ``vtk`` and a GL library; Debian's libosmesa6 does without a display.
"""

import sys

import numpy as np
import pyvista

from skfem_joint.output.pictures import offscreen

TITLE = "friction traction, MPa"


def render(series: str, picture: str, share: float = 0.35) -> None:
    """Draw the frame at a ``share`` of the series, the models one behind the other."""
    reader = pyvista.PVDReader(series)
    reader.set_active_time_value(reader.time_values[int(share * (len(reader.time_values) - 1))])
    blocks = dict(zip([one.group for one in reader.active_datasets], reader.read(), strict=True))
    size = np.ptp(np.vstack([block.points for block in blocks.values()]), axis=0).max()
    largest = max(np.linalg.norm(block["displacement"], axis=1).max() for block in blocks.values())
    factor = 10.0 ** np.floor(np.log10(0.1 * size / largest)) if largest > 0.0 else 1.0
    models = list(dict.fromkeys(name.split(": ")[0] for name in blocks))
    plotter = pyvista.Plotter(off_screen=True, window_size=(1500, 700))
    plotter.set_background("white")
    largest = max(1e-6 * block["friction_traction"].max() for block in blocks.values())
    for name, block in blocks.items():
        row = models.index(name.split(": ")[0])
        block[TITLE] = 1e-6 * np.linalg.norm(block["friction_traction"], axis=1)
        shape = block.warp_by_vector("displacement", factor=factor)
        shape.translate((0.0, -0.25 * size * row, 0.0), inplace=True)
        plotter.add_mesh(shape.extract_feature_edges(30), color="black", line_width=2)
        bar = {"title": f"{TITLE}\n ", "color": "black", "position_x": 0.3, "fmt": "%.3g"}
        plotter.add_mesh(
            shape, scalars=TITLE, clim=(0.0, largest), scalar_bar_args=bar, ambient=0.5
        )
    text = f"t = {1e3 * reader.active_time_value:.2f} ms, displacement x {factor:g}"
    text += f"\nfrom behind: {', '.join(models)}" if len(models) > 1 else ""
    plotter.add_text(text, font_size=12, color="black")
    plotter.view_vector((0.0, -0.5, 0.9), viewup=(0.0, 1.0, 0.0))
    plotter.enable_parallel_projection()
    plotter.camera.zoom(1.6)
    plotter.screenshot(picture)


if __name__ == "__main__":
    with offscreen():
        render(*sys.argv[1:3])
