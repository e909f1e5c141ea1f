"""Bands are as narrow as the structure, and their factors solve."""

import numpy as np
import pytest
from grid_matrices import eye
from scipy import sparse

from skfem_joint.linalg import bands
from skfem_joint.linalg.bands import Band


@pytest.mark.parametrize("apart", [1, 2])
@pytest.mark.parametrize("width", [5, 20, 80])
def test_a_strip_has_a_band_as_narrow_as_itself(width, apart):
    """Each point meets the eight around it; numbered at random, alone and beside another strip."""
    along, across = (
        sparse.diags_array(np.ones((3, m)), offsets=(-1, 0, 1), shape=(m, m)) for m in (100, width)
    )
    strips = sparse.block_diag([sparse.kron(along, across)] * apart)
    strips += 10.0 * eye(strips.shape[0])
    order = np.random.default_rng(8).permutation(strips.shape[0])
    A = sparse.csr_array(strips)[order][:, order]
    entries = A.tocoo()
    band = Band(*entries.coords, order.size)
    assert band.height <= max(width + 5, bands.NARROW)
    factor = band.factorised(entries.data)
    assert factor is not None
    x = np.sin(1.0 + np.arange(order.size))
    np.testing.assert_allclose(factor(A @ x), x, atol=1e-11)
    if width == 5:
        np.testing.assert_allclose(np.log(factor.pivots).sum(), np.linalg.slogdet(A.toarray())[1])


def test_no_band_is_sought_where_none_is_narrow(monkeypatch):
    """Within two connections of a point of this solid lie 125 points, of 3 unknowns each."""
    along = sparse.diags_array(np.ones((3, 12)), offsets=(-1, 0, 1), shape=(12, 12))
    points = sparse.kron(along, sparse.kron(along, along))
    A = sparse.csr_array(sparse.kron(points, np.ones((3, 3)))) + 99.0 * eye(3 * 12**3)

    def refused(*_):
        raise AssertionError("an order is sought")

    monkeypatch.setattr(bands, "reverse_cuthill_mckee", refused)
    assert Band.of(A) is None
    entries = A.tocoo()
    assert Band(*entries.coords, A.shape[0]).factorised(entries.data) is None
