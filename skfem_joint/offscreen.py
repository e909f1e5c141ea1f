"""Drawing with VTK without a display, and without its crash where there is no GL library."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from skfem_joint.errors import InputError

_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"

#: Kinds of window without a display, best first, as VTK names them; "" is VTK's own choice.
_WINDOWS = ("vtkOSOpenGLRenderWindow", "vtkEGLRenderWindow", "")

# VTK looks up its GL library when it draws first, and ends the process if there is none.
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

_found: dict[tuple[str, str], str | None] = {}


@contextmanager
def offscreen() -> Iterator[None]:
    """Let VTK draw into memory while the block runs.

    Which kind of window works is tried out in a process of its own, once: a second. A choice that
    the environment variable ``VTK_DEFAULT_OPENGL_WINDOW`` makes is kept.

    Raises
    ------
    InputError
        If none works, naming what to install.
    """
    before = os.environ.get(_VARIABLE)
    window = _working_window(before)
    try:
        if window:
            os.environ[_VARIABLE] = window
        yield
    finally:
        if before is None:
            os.environ.pop(_VARIABLE, None)
        else:
            os.environ[_VARIABLE] = before


def _working_window(chosen: str | None) -> str:
    """Kind of window that draws."""
    display = os.environ.get("DISPLAY", "")
    key = (chosen or "", display)
    if key not in _found:
        # With a display, and on systems that always have one, VTK's own choice is the right one.
        own = display or not sys.platform.startswith("linux")
        windows = (chosen,) if chosen else (_WINDOWS[::-1] if own else _WINDOWS)
        _found[key] = next((window for window in windows if _draws(window)), None)
    window = _found[key]
    if window is None:
        why = f" ({_VARIABLE} = {chosen!r} does not work)" if chosen else ""
        raise InputError(
            f"pictures: VTK cannot draw here{why}: there is no display and no GL library that does "
            "without; install OSMesa (Debian: apt-get install libosmesa6) or EGL (libegl1 "
            "libgl1-mesa-dri), or switch pictures off and open the series in ParaView elsewhere"
        )
    return window


def _draws(window: str) -> bool:
    """Whether a process of its own can draw with a kind of window."""
    environment = {**os.environ, _VARIABLE: window}
    if not window:
        del environment[_VARIABLE]
    try:
        ended = subprocess.run(
            [sys.executable, "-c", _PROBE], env=environment, capture_output=True, timeout=60.0
        )
    except (subprocess.TimeoutExpired, OSError):
        return False
    return ended.returncode == 0 and b"drawn" in ended.stdout
