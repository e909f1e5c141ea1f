"""Mark of tests that draw bodies with VTK, which needs a GL library."""

from functools import cache

import pytest

from skfem_joint.ground.errors import InputError
from skfem_joint.output.drawing.offscreen import offscreen


@cache
def can_draw() -> bool:
    try:
        with offscreen():
            return True
    except InputError:
        return False


# A text is evaluated where a test begins: the module alone opens no window.
draws = pytest.mark.skipif(
    "not __import__('drawing').can_draw()", reason="no GL library: apt-get install libosmesa6"
)
