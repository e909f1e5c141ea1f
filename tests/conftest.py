"""Settings that hold for all tests."""

import os
import signal
from collections.abc import Iterator

import pytest

# The tests run in several processes, so linear algebra gets one thread in each. The variables are
# read when numpy and scipy are imported, which is after this file.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# A shell makes its background jobs ignore Ctrl-C, and so would every process that a test starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest of the slow tests, of four minutes, begins first: at the end it ran alone."""
    items.sort(key=lambda item: "measured_beam" not in item.name)


@pytest.fixture(autouse=True)
def _numbers_are_printed_as_numpy_does() -> Iterator[None]:
    """Restore numpy's options for printing, which pyyeti changes when it is imported."""
    import numpy as np  # after the variables above are set

    options = np.get_printoptions()
    yield
    np.set_printoptions(**options)


@pytest.fixture
def few_may_move(monkeypatch):
    """Steps work on the points that move, however few unknowns a model has."""
    monkeypatch.setattr("skfem_joint.minimise.condensed_newton.FEWEST_MOVING", 0)
