"""Mass and stiffness of an elastic body, assembled by scikit-fem from scalar blocks.

A displacement u and a virtual displacement v have components that are combinations of the same
scalar shape functions. With the constants lambda and mu of the body and its extent across the mesh
(area of a bar's section, thickness of a plate, 1 for a solid) the weak form is

    integral of  across (lambda div u div v + 2 mu eps(u) : eps(v)) + across rho u . v.

Written for the component i of v and the component j of u, with u = phi e_j and v = psi e_i, the
stiffness falls apart into scalar blocks

    K_ij = integral of  across (lambda d_i psi d_j phi + mu d_j psi d_i phi
                                + delta_ij mu grad psi . grad phi),

each a sum of the products ``d_i psi d_j phi`` that `skfem.asm` assembles. Degrees of freedom are
``dim * node + component``. Quadrilaterals and hexahedra of first order may also have inner modes,
which :mod:`skfem_joint.body.incompatible` takes out of the matrix again, element by element.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import sparse
from skfem import BilinearForm, CellBasis, asm

from skfem_joint.body.incompatible import softening
from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.mesh.cells import same_columns


def mass(basis: Any, density: FloatArray) -> sparse.csr_array:
    """Consistent mass matrix of one component, ``integral of density psi phi``, shape (N, N).

    Parameters
    ----------
    basis : skfem.Basis
        Scalar basis whose N degrees of freedom are the nodes.
    density : ndarray, shape (elements,)
        Mass by length, area or volume of the mesh: kg/m, kg/m2 or kg/m3.
    """
    form = BilinearForm(lambda u, v, w: w.density * (u * v))
    return _symmetric(asm(form, basis, density=density[:, np.newaxis]))


def stiffness(
    basis: Any,
    first: FloatArray,
    second: FloatArray,
    elements: IntArray | None = None,
    *,
    incompatible: bool = False,
) -> sparse.csr_array:
    """Stiffness matrix, N/m, shape (dim N, dim N), exactly symmetric.

    Parameters
    ----------
    basis : skfem.Basis
        Scalar basis whose N degrees of freedom are the nodes.
    first, second : ndarray, shape (elements,)
        The constants lambda and mu times the extent across the mesh; mu is zero for bars.
    elements : ndarray of int, optional
        Elements that count, which the constants belong to; all of the basis if not given.
    incompatible : bool
        Whether the elements, quadrilaterals or hexahedra of first order, have incompatible modes.
    """
    axes = range(int(basis.mesh.dim()))
    sums: dict[tuple[int, int], Any] = {}
    firsts, part_of = same_columns(np.stack([first, second]))
    every = np.arange(basis.mesh.nelements) if basis.tind is None else basis.tind
    for part, element in enumerate(firsts):
        of_part = basis
        if firsts.size > 1 or elements is not None:
            own = np.flatnonzero(part_of == part)
            of_part = on_elements(basis, (every if elements is None else elements)[own])
        products, lam, mu = gradient_products(of_part), first[element], second[element]
        for (i, j), product in products.items():
            block = lam * product if mu == 0.0 else lam * product + mu * product.T
            if i == j and mu != 0.0:
                block += mu * sum((products[k, k] for k in axes if k != i), product)
            sums[i, j] = sums[i, j] + block if part else block
    if incompatible:
        for (i, j), block in softening(basis, first, second, elements).items():
            sums[i, j] = sums[i, j] - block
    blocks = {
        (i, j): _symmetric(A) if i == j else sparse.csr_array(A) for (i, j), A in sums.items()
    }
    blocks |= {(j, i): sparse.csr_array(A.T) for (i, j), A in blocks.items() if i < j}
    return interleaved([[blocks[i, j] for j in axes] for i in axes])


def on_elements(basis: Any, elements: IntArray) -> Any:
    """Basis on some elements, with the same numbers of nodes, which scikit-fem's would forget."""
    same = {"mapping": basis.mapping, "quadrature": basis.quadrature, "dofs": basis.dofs}
    return CellBasis(basis.mesh, basis.elem, elements=elements, **same)


def gradient_products(basis: Any) -> dict[tuple[int, int], sparse.csr_array]:
    """Scalar blocks ``integral of d_i psi d_j phi``, shape (N, N) each, by (i, j) with i <= j.

    The block of (j, i) is the transpose of that of (i, j).
    """
    axes = range(int(basis.mesh.dim()))
    pairs = [(i, j) for i in axes for j in axes[i:]]
    return {(i, j): sparse.csr_array(asm(_gradient_product(i, j), basis)) for i, j in pairs}


def _gradient_product(i: int, j: int) -> BilinearForm:
    """The form ``d_i v d_j u``."""
    return BilinearForm(lambda u, v, _: u.grad[j] * v.grad[i])


def interleaved(blocks: Sequence[Sequence[sparse.csr_array]]) -> sparse.csr_array:
    """Matrix on ``dim * node + component`` from its scalar blocks (i, j), given row by row.

    Each row of the matrix takes the entries of its row in the blocks (i, 0), (i, 1), ... in turn:
    compressed rows are written in place, which takes half the time of ``scipy.sparse.kron``.
    """
    if len(blocks) == 1:
        return blocks[0][0]
    dim, n = len(blocks), blocks[0][0].shape[0]
    counts = np.array([[np.diff(block.indptr) for block in row] for row in blocks])
    indptr = np.concatenate([[0], np.cumsum(counts.sum(axis=1).T)])
    indices, data = np.empty(indptr[-1], dtype=np.int32), np.empty(indptr[-1])
    for i, row in enumerate(blocks):
        start = indptr[i:-1:dim].copy()
        for j, block in enumerate(row):
            place = np.repeat(start - block.indptr[:-1], counts[i, j]) + np.arange(block.nnz)
            indices[place], data[place] = dim * block.indices + j, block.data
            start += counts[i, j]
    matrix = sparse.csr_array((data, indices, indptr), shape=(dim * n, dim * n))
    matrix.eliminate_zeros()
    matrix.sort_indices()
    return matrix


def _symmetric(block: Any) -> sparse.csr_array:
    """Exactly symmetric block: round-off makes the two halves of a sum differ."""
    A = sparse.csr_array(block)
    return sparse.csr_array(0.5 * (A + A.T))
