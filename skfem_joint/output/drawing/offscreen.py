"""Windows of VTK that draw into memory, where there is no display too."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import needed
from skfem_joint.ground.processes import SAFE_PATH

_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"  # by which VTK chooses its kind of window
# VTK loads a GL library when it first draws, and ends the process if there is none.
_PROBE = """
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow
import vtkmodules.vtkRenderingOpenGL2
window = vtkRenderWindow()
window.SetOffScreenRendering(1)
window.SetSize(8, 8)
window.AddRenderer(vtkRenderer())
window.Render()
print("drawn" if window.SupportsOpenGL() else "no OpenGL")
"""


@contextmanager
def offscreen() -> Iterator[None]:
    """Let VTK draw into memory while the block runs.

    The first kind of window that works is taken. Each is tried once, in a process of its own, which
    takes a second. If the environment variable ``VTK_DEFAULT_OPENGL_WINDOW`` names a kind, only
    that one is tried. InputError if none works.
    """
    chosen = os.environ.get(_VARIABLE)
    window = _working_window(chosen, os.environ.get("DISPLAY", ""))
    if window is None:
        why = f" ({_VARIABLE} = {chosen!r} does not work)" if chosen else ""
        raise InputError(
            f"pictures: VTK cannot draw here{why}: there is no display and no GL library that does "
            "without; install OSMesa (Debian: apt-get install libosmesa6) or EGL (libegl1 "
            "libgl1-mesa-dri), or switch pictures off and open the series in ParaView elsewhere"
        )
    if window:
        os.environ[_VARIABLE] = window
    try:
        yield
    finally:
        if not chosen:
            os.environ.pop(_VARIABLE, None)


@cache
def _working_window(chosen: str | None, display: str) -> str | None:
    """First kind of window that draws; an empty name is VTK's own choice."""
    if chosen:
        windows: tuple[str, ...] = (chosen,)
    elif display or not sys.platform.startswith("linux"):
        windows = ("", "vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
    else:
        windows = ("vtkOSOpenGLRenderWindow", "vtkEGLRenderWindow", "")
    return next((window for window in windows if _draws(window)), None)


def _draws(window: str) -> bool:
    """Whether a process of its own can draw with a kind of window."""
    environment = {name: value for name, value in os.environ.items() if name != _VARIABLE}
    environment |= {_VARIABLE: window} if window else {}
    try:
        command = [sys.executable, SAFE_PATH, "-c", _PROBE]
        ended = subprocess.run(command, env=environment, capture_output=True, timeout=60.0)
    except (subprocess.TimeoutExpired, OSError):
        return False
    return ended.returncode == 0 and b"drawn" in ended.stdout


def plotter_of(axes: FloatArray, low: FloatArray, high: FloatArray, pixel: float) -> Any:
    """Plotter of pyvista that looks at a rectangle in parallel projection.

    Parameters
    ----------
    axes : ndarray, shape (3, 3)
        Unit vectors across the picture, up, and to the eye, as rows.
    low, high : ndarray, shape (2,)
        Corners of the rectangle, across and up, m.
    pixel : float
        Length of a pixel, m.
    """
    size = np.ceil((high - low) / pixel).astype(int).tolist()
    plotter = needed("pyvista", "vtk").Plotter(off_screen=True, window_size=size, border=False)
    camera, middle = plotter.camera, 0.5 * (low + high) @ axes[:2]
    camera.parallel_projection = True
    camera.focal_point, camera.position, camera.up = middle, middle + axes[2], axes[1]
    camera.parallel_scale = 0.5 * size[1] * pixel
    return plotter


def drawn(plotter: Any) -> Any:
    """Image of what a plotter has, seen from outside of all of it."""
    camera = plotter.camera
    away = 10.0 * plotter.length * np.array(camera.direction)
    camera.position = np.array(camera.focal_point) - away
    plotter.renderer.reset_camera_clipping_range()
    return plotter.screenshot(return_img=True)
