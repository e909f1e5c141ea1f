"""Incompatible modes of quadrilaterals and hexahedra of first order (QM6), condensed by element.

With its corners' shape functions alone such an element cannot bend: it answers a moment by shear.
Its displacement therefore has an inner part, the sum over the directions k of ``N_k a_k`` with the
modes N_k = 1 - xi_k^2 of the coordinates xi from -1 to 1 and a vector a_k for each. A mode ends
inside the element and so does not meet those of its neighbours. With J the Jacobian matrix and J_0
that at the centre, its gradient is taken as

    grad N_k = (det J_0 / det J) J_0^-T d N_k / d xi,

so that the integral of the gradient over the element vanishes whatever its shape, and with it the
work of a constant stress on the modes: the patch test holds (Taylor, Beresford and Wilson, 1976).
In the weak form of :mod:`skfem_joint.body.assembly` the modes stand beside the corners' functions,
with the matrices K_ua between corners and modes, and K_aa of the modes alone. No force acts on the
modes, K_au u + K_aa a = 0, which leaves to the corners

    K_uu - K_ua K_aa^-1 K_au,

whose second part `softening` gives. Inertia and loads act on the corners alone.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.mesh.cells import cell_of
from skfem_joint.mesh.collapsed import is_collapsed

#: Elements whose matrices are in memory at the same time.
_PIECE = 4096


def softening(
    basis: Any, first: FloatArray, second: FloatArray, elements: IntArray | None = None
) -> dict[tuple[int, int], sparse.csr_array]:
    """Stiffness that the modes take away, ``K_ua K_aa^-1 K_au``, N/m.

    Parameters
    ----------
    basis, first, second, elements
        As for `skfem_joint.body.assembly.stiffness`, of quadrilaterals or hexahedra of first order.
        Collapsed ones, triangles and prisms, have no modes.

    Returns
    -------
    dict
        Scalar blocks, shape (N, N) each, of component i of v and j of u by (i, j) with i <= j.
    """
    if elements is None:
        elements = np.arange(basis.mesh.nelements)
    whole = ~is_collapsed(cell_of(basis.mesh)[0], basis.mesh.t[:, elements])
    elements, first, second = elements[whole], first[whole], second[whole]
    blocks: dict[tuple[int, int], Any] = {}
    for piece in np.array_split(np.arange(elements.size), 1 + elements.size // _PIECE):
        of_elements = _of_elements(basis, first[piece], second[piece], elements[piece])
        nodes = basis.element_dofs[:, elements[piece]].T
        rows, columns = (
            at.ravel() for at in np.broadcast_arrays(nodes[:, :, None], nodes[:, None])
        )
        for i, j in combinations_with_replacement(range(of_elements.shape[2]), 2):
            entries = of_elements[:, :, i, :, j].ravel(), (rows, columns)
            block = sparse.csr_array(sparse.coo_array(entries, shape=(basis.N, basis.N)))
            blocks[i, j] = blocks[i, j] + block if (i, j) in blocks else block
    return blocks


def _of_elements(
    basis: Any, first: FloatArray, second: FloatArray, elements: IntArray
) -> FloatArray:
    """Matrices ``K_ua K_aa^-1 K_au`` by element, (elements, corners, dim, corners, dim)."""
    of_corners = np.array([shape.grad[:, elements] for (shape,) in basis.basis])
    of_modes, dx = mode_gradients(basis, elements), basis.dx[elements]
    K_ua = _between(of_corners, of_modes, dx, first, second)
    K_aa = _between(of_modes, of_modes, dx, first, second)
    n, corners, dim, modes, _ = K_ua.shape
    K_ua = K_ua.reshape(n, corners * dim, modes * dim)
    K_aa = K_aa.reshape(n, modes * dim, modes * dim)
    condensed = K_ua @ np.linalg.solve(K_aa, K_ua.transpose(0, 2, 1))
    return np.asarray(condensed.reshape(n, corners, dim, corners, dim))


def mode_gradients(basis: Any, elements: IntArray) -> FloatArray:
    """Gradients of the modes at the points of quadrature, (modes, dim, elements, points), 1/m."""
    mapping, X = basis.mapping, basis.X
    centre = np.full((len(X), 1), 0.5)  # scikit-fem's coordinates X = (1 + xi) / 2 go from 0 to 1
    scale = mapping.detDF(centre, elements) / mapping.detDF(X, elements)
    slopes = 4.0 - 8.0 * X  # of 1 - xi_k^2 = 4 X_k (1 - X_k) along X_k
    to_space = mapping.invDF(centre, elements)[..., 0]
    return np.asarray(np.einsum("kq,kje,eq->kjeq", slopes, to_space, scale))


def _between(
    of_v: FloatArray, of_u: FloatArray, dx: FloatArray, first: FloatArray, second: FloatArray
) -> FloatArray:
    """Elastic energy between functions with gradients (functions, dim, elements, points).

    The scalar blocks of :mod:`skfem_joint.body.assembly`, by element, function of v, its component
    i, function of u and its component j.
    """
    products = np.einsum("aieq,bjeq->eaibj", of_v * dx, of_u)  # integrals of d_i psi d_j phi
    traces = np.einsum("eakbk,ij->eaibj", products, np.eye(of_v.shape[1]))
    lam, mu = (constant.reshape(-1, 1, 1, 1, 1) for constant in (first, second))
    return np.asarray(lam * products + mu * (products.swapaxes(2, 4) + traces))
