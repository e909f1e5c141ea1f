"""Matrices by scikit-fem's own forms, as users assemble them; steel, SI units."""

from typing import Any

import numpy as np
import skfem
from skfem.helpers import dot
from skfem.models.elasticity import lame_parameters, linear_elasticity

from skfem_joint.body.nodes import Nodes


def basis_of(body: Any) -> Any:
    """Basis of displacement vectors with the elements and the quadrature of a named mesh."""
    nodes = Nodes(body)
    element = nodes.element if body.mesh.dim() == 1 else skfem.ElementVector(nodes.element)
    return skfem.Basis(body.mesh, element, intorder=nodes.quadrature)


def matrices(basis: Any, depth: float = 1.0) -> tuple[Any, Any]:
    """Mass and stiffness of a solid, or of plane strain over a depth (m)."""
    K = skfem.asm(linear_elasticity(*lame_parameters(200e9, 0.3)), basis)
    M = skfem.asm(skfem.BilinearForm(lambda u, v, _: 8000.0 * dot(u, v)), basis)
    return depth * M, depth * K


def even_force(basis: Any, boundary: str, component: int) -> np.ndarray:
    """Force of 1 N along a direction, spread evenly over a boundary."""
    facets = skfem.FacetBasis(basis.mesh, basis.elem, facets=boundary)
    vector = skfem.LinearForm(lambda v, _: v[component]).assemble(facets)
    return np.asarray(vector / facets.dx.sum())
