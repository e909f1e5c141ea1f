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
