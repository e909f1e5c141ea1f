"""Basis of a reduced model by its options; only this module knows the paper's scaled modes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skfem_joint.reduction.basis import Basis, Options
from skfem_joint.reduction.sources import make_basis
from skfem_joint.stepping.plan import Plan
from skfem_joint.structure import AnyStructure
from skfem_joint.system import System

if TYPE_CHECKING:
    from skfem_joint.stepping.quasi_static import QuasiStatic


def make_reduced(
    structure: AnyStructure,
    system: System,
    options: Options,
    plan: Plan,
    *,
    enriched: bool = False,
    path: QuasiStatic | None = None,
) -> Basis:
    """Basis of a structure by its options; makes the path or runs that it needs.

    Parameters and errors are those of `skfem_joint.reduction.sources.make_basis`. The reference
    "paper" needs a structure with a mesh.
    """
    if options.reference != "paper":
        return make_basis(system, options, plan, enriched=enriched, path=path)
    from skfem_joint.reduction.scaled.basis import paper_basis  # few scenes need it

    return paper_basis(structure, system, options, plan, enriched=enriched)
