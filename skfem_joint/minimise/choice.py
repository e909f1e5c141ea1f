"""Choice of the method for a step problem, by the structure of its matrix and slips.

`skfem_joint.stepping.arrangement.arranged` finds the kind of a system; `step_problem` takes it:

- a chain (H tridiagonal, each slip an unknown):
  :class:`~skfem_joint.minimise.front_elimination.FrontElimination`;
- any other H with each slip an unknown:
  :class:`~skfem_joint.minimise.contact_newton.ContactNewton`, or
  :class:`~skfem_joint.minimise.condensed_newton.CondensedNewton` where that is cheaper, and always
  where contact opens;
- dense H with slips that depend on each other, as in reduced models:
  :class:`~skfem_joint.minimise.primal_dual_newton.PrimalDualNewton`;
- no friction at all: :class:`~skfem_joint.minimise.problem.LinearProblem`.
"""

from __future__ import annotations

from typing import Any

from skfem_joint.linalg.schur import condensing_pays
from skfem_joint.minimise.problem import ContactPoints, LinearProblem, StepProblem


def step_problem(H: Any, points: ContactPoints, kind: str, condense: bool = True) -> StepProblem:
    """Step problem by the method for a kind of matrices.

    Parameters
    ----------
    H : ndarray or csr_array, shape (n, n), or its compiled form
        Symmetric positive definite; N s/m for the velocity.
    points : ContactPoints
    kind : str
        "linear", "chain", "contact" or "dense", see
        :func:`skfem_joint.stepping.arrangement.arranged`. Only the last three load the compiler.
    condense : bool
        Whether a problem of kind "contact" may be condensed to the contact. That pays if it is
        minimised more than once.
    """
    if kind == "linear":
        return LinearProblem(H, points)
    if kind == "chain":
        from skfem_joint.minimise.front_elimination import FrontElimination

        return FrontElimination(H, points)
    if kind == "dense":
        from skfem_joint.minimise.primal_dual_newton import PrimalDualNewton

        return PrimalDualNewton(H, points)
    from skfem_joint.minimise.condensed_newton import CondensedNewton
    from skfem_joint.minimise.contact_newton import ContactNewton

    opens = points.normal is not None
    pays = opens or (condense and condensing_pays(H, points.limited))
    return CondensedNewton(H, points) if pays else ContactNewton(H, points)
