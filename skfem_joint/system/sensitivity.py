"""Derivatives of a system's matrices, friction limits and contact by a parameter.

They are exact: a stiffness matrix is linear in Young's modulus, a friction limit in the coefficient
of friction and in a pressure, normal forces of a preload in the clamp forces as long as the same
nodes touch. :mod:`skfem_joint.structure.sensitivities` makes them for the keys of a structure,
:mod:`skfem_joint.vibration.backbone_sensitivity` takes them to damping curves.
"""

from __future__ import annotations

from dataclasses import dataclass

from skfem_joint.ground.arrays import FloatArray, Matrix


@dataclass(frozen=True)
class OpeningSensitivity:
    """Derivatives of contact that opens, see `skfem_joint.system.normal.NormalPart`.

    Each is None where it is zero.

    Attributes
    ----------
    gap : ndarray, shape (q,)
        Of the gaps at rest, m.
    force : ndarray, shape (q,)
        Of the normal forces at rest, N.
    gain : sparse array, shape (m, q)
        Of the friction limits by the normal forces.
    stiffness : ndarray, shape (q,)
        Of the stiffness of the pressure points, N/m; zero at rigid ones.
    """

    gap: FloatArray | None = None
    force: FloatArray | None = None
    gain: Matrix | None = None
    stiffness: FloatArray | None = None


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
    opening : OpeningSensitivity
        Of contact that opens.
    """

    name: str
    K: Matrix | None = None
    C: Matrix | None = None
    w: FloatArray | None = None
    stiffness: FloatArray | None = None
    opening: OpeningSensitivity | None = None
