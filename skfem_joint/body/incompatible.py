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
modes, K_au u + K_aa a = 0 or a = A u, which leaves to the corners

    K_uu - K_ua K_aa^-1 K_au,

whose second part `softening` gives. The modes move with the corners and have inertia, of which
`inertia` gives, as Guyan (1965) condenses it,

    M_ua A + A^T M_au + A^T M_aa A.

Without it frequencies of coarse meshes are too high. Loads, also those of an accelerated
base, act on the corners alone.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations_with_replacement
from math import ceil
from typing import Any

import numpy as np
from scipy import sparse
from skfem.quadrature import get_quadrature

from skfem_joint.ground.arrays import FloatArray, IntArray

Blocks = dict[tuple[int, int], sparse.csr_array]

#: Elements whose matrices are in memory at the same time.
_PIECE = 4096


def softening(
    basis: Any, first: FloatArray, second: FloatArray, elements: IntArray | None = None
) -> Blocks:
    """Stiffness that the modes take away, ``K_ua K_aa^-1 K_au``, N/m.

    Parameters
    ----------
    basis, first, second, elements
        As for `skfem_joint.body.assembly.stiffness`, of quadrilaterals or hexahedra of first order.

    Returns
    -------
    dict
        Scalar blocks, shape (N, N) each, of component i of v and j of u by (i, j) with i <= j.
    """

    def of(own: IntArray, part: IntArray) -> FloatArray:
        K_ua, amplitudes = _amplitudes(basis, first[own], second[own], part)
        return np.asarray(-np.einsum("eaimk,emkbj->eaibj", K_ua, amplitudes, optimize=True))

    return _blocks(basis, elements, of)


def inertia(basis: Any, density: FloatArray, first: FloatArray, second: FloatArray) -> Blocks:
    """Mass that the modes add, ``M_ua A + A^T M_au + A^T M_aa A``, kg; blocks as in `softening`.

    Parameters
    ----------
    basis, density, first, second
        As for `skfem_joint.body.assembly.mass` and `skfem_joint.body.assembly.stiffness`.
    """
    X, W = get_quadrature(basis.elem, 4)  # exact for squares of the modes on parallelepipeds
    modes = 4.0 * X * (1.0 - X)  # 1 - xi_k^2, (modes, points)
    corners = np.array([basis.elem.lbasis(X, k)[0] for k in range(basis.Nbfun)])

    def of(own: IntArray, part: IntArray) -> FloatArray:
        _, amplitudes = _amplitudes(basis, first[own], second[own], part)
        dx = np.abs(basis.mapping.detDF(X, part)) * W * density[own, np.newaxis]
        M_ua = np.einsum("aq,mq,eq->eam", corners, modes, dx, optimize=True)
        M_aa = np.einsum("mq,nq,eq->emn", modes, modes, dx, optimize=True)
        moved = np.einsum("eam,emibj->eaibj", M_ua, amplitudes)
        alone = np.einsum("emkai,emn,enkbj->eaibj", amplitudes, M_aa, amplitudes, optimize=True)
        return np.asarray(moved + moved.transpose(0, 3, 4, 1, 2) + alone)

    return _blocks(basis, None, of)


def _blocks(
    basis: Any, elements: IntArray | None, of: Callable[[IntArray, IntArray], FloatArray]
) -> Blocks:
    """Sums of matrices (elements, corners, dim, corners, dim) over the elements.

    ``of`` gives the matrices from places in ``elements`` and the elements there.
    """
    if elements is None:
        elements = np.arange(basis.mesh.nelements)
    blocks: dict[tuple[int, int], Any] = {}
    for piece in np.array_split(np.arange(elements.size), ceil(elements.size / _PIECE)):
        of_elements = of(piece, elements[piece])
        nodes = basis.element_dofs[:, elements[piece]].T
        rows, columns = (
            at.ravel() for at in np.broadcast_arrays(nodes[:, :, None], nodes[:, None])
        )
        for i, j in combinations_with_replacement(range(of_elements.shape[2]), 2):
            entries = of_elements[:, :, i, :, j].ravel(), (rows, columns)
            block = sparse.csr_array(sparse.coo_array(entries, shape=(basis.N, basis.N)))
            blocks[i, j] = blocks[i, j] + block if (i, j) in blocks else block
    return blocks


def _amplitudes(
    basis: Any, first: FloatArray, second: FloatArray, elements: IntArray
) -> tuple[FloatArray, FloatArray]:
    """``K_ua`` (elements, corners, dim, modes, dim) and ``A = -K_aa^-1 K_au`` of a = A u."""
    of_corners = np.array([shape.grad[:, elements] for (shape,) in basis.basis])
    of_modes, dx = mode_gradients(basis, elements), basis.dx[elements]
    K_ua = _between(of_corners, of_modes, dx, first, second)
    K_aa = _between(of_modes, of_modes, dx, first, second)
    n, corners, dim, modes, _ = K_ua.shape
    K_au = K_ua.reshape(n, corners * dim, modes * dim).transpose(0, 2, 1)
    amplitudes = -np.linalg.solve(K_aa.reshape(n, modes * dim, modes * dim), K_au)
    return K_ua, np.asarray(amplitudes.reshape(n, modes, dim, corners, dim))


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
