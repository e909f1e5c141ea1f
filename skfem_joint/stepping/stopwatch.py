"""Wall time with the time of compilation apart."""

from __future__ import annotations

import sys
import time


class Stopwatch:
    """Wall time since it was made, s, and what the compilation of loops in this process took of it.

    Compilation happens once on a machine; later processes load the loops from a cache. It is no
    cost of a model.
    """

    def __init__(self) -> None:
        self._begin, self._compiled = time.perf_counter(), _compilation()

    def read(self) -> tuple[float, float]:
        """Time without compilation, and time of compilation, s."""
        compilation = _compilation() - self._compiled
        return time.perf_counter() - self._begin - compilation, compilation


def _compilation() -> float:
    """Time that this process has spent in compilation so far, s."""
    # Imported by what needs it: systems without friction do without the compiler.
    module = sys.modules.get("skfem_joint.ground.compiling")
    clock = getattr(module, "COMPILING", None)
    return float(clock.duration) if clock is not None and clock.done else 0.0
