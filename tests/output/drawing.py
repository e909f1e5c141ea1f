"""Mark of tests that draw bodies with VTK, which needs a GL library."""

import pytest

from skfem_joint.ground.errors import InputError
from skfem_joint.output.drawing.offscreen import offscreen


def can_draw() -> bool:
    try:
        with offscreen():
            return True
    except InputError:
        return False


draws = pytest.mark.skipif(not can_draw(), reason="no GL library: apt-get install libosmesa6")
