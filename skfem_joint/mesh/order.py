"""Order of the elements that a mesh is computed with: second order where the first one locks.

A triangle or tetrahedron of first order has one strain in all of it, a prism across its axis, and
bends too stiffly by tens of per cent on any mesh that can be paid for. Its displacement may be
quadratic on the same straight mesh, since scikit-fem keeps mesh and element apart: that makes 4
(plates) to 7 times (solids) as many unknowns and errs by less than one per cent. Quadrilaterals and
hexahedra have incompatible modes instead (`skfem_joint.body.incompatible`). Triangles or prisms
among them lock the mesh too: with 60 % of the cells of a cantilever, 12 x 6 x 4 of them, cut into
prisms, its first frequency is 54 % too high.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from skfem_joint.ground.errors import InputError
from skfem_joint.linalg.schur import physical_memory
from skfem_joint.mesh.collapsed import ElementsOfKind
from skfem_joint.mesh.named import NamedMesh


def of_order(
    mesh: NamedMesh, order: Any, *, lumped: bool = False, in_parts: bool = False
) -> tuple[NamedMesh, list[str]]:
    """Mesh with elements of the order asked for, and sentences on what that changed.

    Parameters
    ----------
    mesh : NamedMesh
    order : {"auto", 1, 2}
        With "auto" meshes with triangles, tetrahedra or prisms of first order get quadratic
        displacements, unless the mass is lumped, which second order does not allow, or a factor of
        their matrix would take more than half of the memory. All others stay as they are.
    lumped : bool
        Whether the mass is lumped.
    in_parts : bool
        Whether the matrix is factorised in parts, so that the memory for its factor does not count.

    Raises
    ------
    InputError
        For another order, and for bars of second order.
    """
    if isinstance(order, bool) or order not in ("auto", 1, 2):
        raise InputError(f"mesh.order: found {order!r}, must be 'auto', 1 or 2")
    if order == 2 and mesh.dim == 1:
        raise InputError(
            "mesh.order: found 2 for a bar, whose elements are of first order; leave it out"
        )
    many = _listed(mesh.parts)
    if order == mesh.order:
        return mesh, []
    if order == 1:
        return mesh.other_order, [
            f"The {many} of second order are computed with linear displacements, as mesh.order = 1 "
            "asks for."
        ]
    if order == 2:
        return mesh.other_order, []
    stiff = [part for part in mesh.parts if not part.kind.bends]
    if mesh.order > 1 or mesh.dim == 1 or not stiff or lumped:
        return mesh, []
    some = _listed(stiff) if len(stiff) < len(mesh.parts) else ""
    needed, there = mesh.other_order.factor_bytes, physical_memory()
    if needed > 0.5 * there and not in_parts:
        return mesh, [
            f"The {many} stay of first order, {f'of which {some}' if some else 'which'} bend too "
            "stiffly: with quadratic displacements a factor would take "
            f"{needed / 2**30:.2g} GiB of the {there / 2**30:.2g} GiB of memory. Mesh with fewer "
            "elements, computed with quadratic displacements they err less; or factorise in parts, "
            "by models.parts = 4 of a scene, in Python by Structure(..., parts=sj.Parts(4))."
        ]
    return mesh.other_order, [
        f"The {many} of first order are computed with quadratic displacements on the same mesh, "
        f"since linear {some or 'ones'} bend too stiffly; mesh.order = 1 keeps them linear."
    ]


def _listed(parts: Sequence[ElementsOfKind]) -> str:
    """Kinds of elements in words."""
    return " and ".join(part.kind.plural for part in parts)
