"""Derivatives of a system's matrices, friction limits and contact by a parameter.

They are exact: a stiffness matrix is linear in Young's modulus, a friction limit in the coefficient
of friction and in a pressure, normal forces of a preload in the clamp forces as long as the same
nodes touch. :mod:`skfem_joint.structure.sensitivities` makes them for the keys of a structure,
:mod:`skfem_joint.vibration.backbone_sensitivity` takes them to damping curves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray, Matrix
from skfem_joint.system.contacts import Contact
from skfem_joint.system.system import System
from skfem_joint.system.unknowns import congruent


@dataclass(frozen=True)
class SystemSensitivity:
    """Derivatives of a `skfem_joint.System` by one parameter, in its unknowns.

    All units are those of the value over that of the parameter. Each is None where it is zero.

    Attributes
    ----------
    name : str
        Parameter, such as "joint[0].friction".
    K, C : sparse array, shape (n, n)
        Of the stiffness, N/m, and of the damping matrix, N s/m.
    w : ndarray, shape (m,)
        Of the friction limits, N; with contact that opens of those at rest.
    stiffness : ndarray, shape (m,)
        Of the springs in series with friction, N/m; zero where there are none.
    gap, force : ndarray, shape (q,)
        Of the gaps, m, and of the normal forces at rest, N, of contact that opens, see
        `skfem_joint.system.normal.NormalPart`.
    gain : sparse array, shape (m, q)
        Of the friction limits by the normal forces.
    normal_stiffness : ndarray, shape (q,)
        Of the stiffness of the pressure points, N/m; zero at rigid ones.
    """

    name: str
    K: Matrix | None = None
    C: Matrix | None = None
    w: FloatArray | None = None
    stiffness: FloatArray | None = None
    gap: FloatArray | None = None
    force: FloatArray | None = None
    gain: Matrix | None = None
    normal_stiffness: FloatArray | None = None

    def in_unknowns(self, *maps: Any) -> SystemSensitivity:
        """Same derivatives in the unknowns q of u = T q, of each of the ``maps`` T in turn."""
        K, C = self.K, self.C
        for T in maps:
            K, C = (None if A is None else congruent(A, T) for A in (K, C))
        return replace(self, K=K, C=C)

    def of_stuck_stiffness(self, contact: Contact) -> Matrix | None:
        """Derivative of `System.stuck_stiffness`, (n, n), N/m; None where it does not change."""
        if self.stiffness is None or not contact.has_springs:
            return self.K
        return _sum(self.K, contact.with_springs(np.where(contact.sprung, self.stiffness, 0.0)))


def of_closed_system(
    parameters: Sequence[SystemSensitivity], system: System
) -> list[SystemSensitivity]:
    """Derivatives of `System.closed`, in its unknowns."""
    contact, found = system.contact.normal, [*parameters]
    if not system.contact.opens:
        return found
    T, pressed = contact.closed_motions(), contact.force > 0.0
    for k, one in enumerate(found):
        if one.normal_stiffness is not None:
            springs = contact.with_springs(np.where(pressed, one.normal_stiffness, 0.0))
            one = replace(one, K=_sum(one.K, springs))
        found[k] = one.in_unknowns(T)
    return found


def _sum(K: Matrix | None, springs: Matrix) -> Matrix:
    """Derivative of a stiffness, which may be None, with that of springs."""
    return springs if K is None else K + springs
