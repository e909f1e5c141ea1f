"""Models with many unknowns say what PARDISO would save, where it is not installed."""

import pytest

from skfem_joint.structure import doubts


@pytest.mark.parametrize(("installed", "n", "said"), [
    (False, 20_001, True), (False, 20_000, False), (True, 20_001, False),
])  # fmt: skip
def test_large_models_name_the_extra_that_makes_their_factors_fast(installed, n, said, monkeypatch):
    monkeypatch.setattr(doubts, "pardiso", lambda: object() if installed else None)
    (sentence,) = [*doubts.without_pardiso(n)] or [""]
    assert ('pip install "skfem-joint[solids]"' in sentence) == said
