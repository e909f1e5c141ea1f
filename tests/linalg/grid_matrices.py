"""Matrices for the tests of factors, and the libraries that factorise them."""

import numpy as np
from scipy import sparse


def eye(n: int) -> sparse.csr_array:
    return sparse.csr_array(sparse.eye_array(n))


def grid(shape: tuple[int, ...]) -> sparse.csr_array:
    """Laplacian of a grid of one to three dimensions, numbered at random."""
    A = sparse.eye_array(1)
    for m in shape:
        line = sparse.diags_array([2.1, -1.0, -1.0], offsets=[0, 1, -1], shape=(m, m))
        n = A.shape[0]
        A = sparse.kron(A, sparse.eye_array(m)) + sparse.kron(sparse.eye_array(n), line)
    order = np.random.default_rng(5).permutation(A.shape[0])
    return sparse.csr_array(A)[order][:, order]
