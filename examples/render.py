"""Picture of a ParaView series, without a display: the swept bar coloured by friction force.

    python examples/render.py out/fields.pvd examples/pictures/structure.png

Needs the extra ``vtk`` and a GL library. On a machine without a display, Debian's libosmesa6 and
VTK_DEFAULT_OPENGL_WINDOW=vtkOSOpenGLRenderWindow do.
"""

import sys

import numpy as np
import pyvista


def render(series: str, picture: str) -> None:
    reader = pyvista.PVDReader(series)
    # The stored frame in which the reduced model moves most.
    peak, chosen = -1.0, 0.0
    for time in reader.time_values:
        reader.set_active_time_value(time)
        largest = max(np.abs(block["displacement"]).max() for block in reader.read())
        if largest > peak:
            peak, chosen = largest, time
    reader.set_active_time_value(chosen)
    blocks = reader.read()
    plotter = pyvista.Plotter(off_screen=True, window_size=(1500, 520))
    plotter.set_background("white")
    warp = 0.03 / peak
    for k, name in enumerate(blocks.keys()):
        block = blocks[name]
        block["friction force, N"] = block["friction_force"][:, 0]
        shape = block.warp_by_vector("displacement", factor=warp)
        shape.translate((0.0, -0.09 * k, 0.0), inplace=True)
        limit = np.abs(blocks[0]["friction_force"]).max()
        plotter.add_mesh(
            shape,
            scalars="friction force, N",
            cmap="RdBu_r",
            clim=(-limit, limit),
            show_edges=False,
            scalar_bar_args={
                "color": "black", "title_font_size": 22, "label_font_size": 20,
                "position_x": 0.3, "position_y": 0.02, "width": 0.4, "height": 0.12,
                "fmt": "%.0f",
            },
        )
        label = f"{name}, t = {1e3 * chosen:.2f} ms, displacement x {warp:.0f}"
        plotter.add_point_labels(
            [(0.0, -0.09 * k + 0.04, 0.012)], [label], font_size=22, shape=None,
            text_color="black", show_points=False, justification_horizontal="left",
        )
    plotter.view_vector((0.0, -0.6, 0.9), viewup=(0.0, 1.0, 0.0))
    plotter.camera.zoom(2.6)
    plotter.screenshot(picture)


if __name__ == "__main__":
    render(*sys.argv[1:3])
