"""Picture of a ParaView series without a display: the swept bars coloured by friction force.

    python examples/render.py out/fields.pvd picture.png

Needs the extra ``vtk`` and a GL library. On a machine without a display, Debian's libosmesa6 and
VTK_DEFAULT_OPENGL_WINDOW=vtkOSOpenGLRenderWindow do.
"""

import sys
from pathlib import Path

import numpy as np
import pyvista


def render(series: str, picture: str, share: float = 0.35) -> None:
    """Draw the frame at a ``share`` of the series, the models one behind the other."""
    reader = pyvista.PVDReader(series)
    times = np.array(reader.time_values)
    reader.set_active_time_value(times[int(share * (times.size - 1))])
    names = [Path(dataset.path).stem.rsplit("_", 1)[0] for dataset in reader.active_datasets]
    blocks = [block.copy() for block in reader.read()]
    limit = max(np.abs(block["friction_force"]).max() for block in blocks)
    largest = max(np.abs(block["displacement"]).max() for block in blocks)
    factor = 10.0 ** np.floor(np.log10(0.06 / largest))
    plotter = pyvista.Plotter(off_screen=True, window_size=(1500, 560))
    plotter.set_background("white")
    for k, (name, block) in enumerate(zip(names, blocks, strict=True)):
        block["friction force on a node, N"] = block["friction_force"][:, 0]
        shape = block.warp_by_vector("displacement", factor=factor)
        shape.translate((0.0, -0.12 * k, 0.0), inplace=True)
        plotter.add_mesh(
            shape,
            scalars="friction force on a node, N",
            cmap="RdBu_r",
            clim=(-limit, limit),
            lighting=False,
            scalar_bar_args={
                "color": "black",
                "title_font_size": 22,
                "label_font_size": 22,
                "position_x": 0.3,
                "position_y": 0.01,
                "width": 0.4,
                "height": 0.18,
                "fmt": "%.0f",
            },
        )
        plotter.add_mesh(shape.extract_feature_edges(30), color="black", line_width=2)
        plotter.add_point_labels(
            [(0.0, -0.12 * k + 0.045, 0.005)],
            [name],
            font_size=28,
            shape=None,
            text_color="black",
            show_points=False,
            justification_horizontal="left",
        )
    plotter.add_text(
        f"t = {1e3 * reader.active_time_value:.2f} ms, displacement x {factor:.0f}",
        position=(0.62, 0.93),
        viewport=True,
        font_size=12,
        color="black",
    )
    plotter.view_vector((0.0, -0.5, 0.9), viewup=(0.0, 1.0, 0.0))
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = 0.125
    plotter.screenshot(picture)


if __name__ == "__main__":
    render(*sys.argv[1:3])
