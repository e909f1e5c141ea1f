"""Large matrices by each of the libraries."""

import pytest

from skfem_joint.linalg import factors


@pytest.fixture(params=["SuperLU", "PARDISO"])
def library(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Large matrices by each of the libraries."""
    if request.param == "PARDISO":
        pytest.importorskip("pypardiso")
        monkeypatch.setattr(factors, "LARGE", 1)
    else:
        monkeypatch.setattr(factors, "pardiso", lambda: None)
    return str(request.param)
