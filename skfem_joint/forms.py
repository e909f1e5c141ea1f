"""Factories of scikit-fem forms for struts: stiffness, mass and pressure in a contact.

Strong form of the strut in its axial displacement u(x, t), with friction traction q per length:
rho A u'' - (E A u_x)_x + q = f. Coefficients come as fields of the form's parameters, so that they
may differ from element to element (pass ``basis0.interpolate(values)`` for one value an element).
"""

from __future__ import annotations

from typing import Any

from skfem import BilinearForm, LinearForm
from skfem.helpers import dot, grad


def strut_stiffness() -> BilinearForm:
    """Stiffness form, integral of ``axial_stiffness`` (E A, N) u_x v_x."""

    @BilinearForm
    def stiffness(u: Any, v: Any, p: Any) -> Any:
        return p.axial_stiffness * dot(grad(u), grad(v))

    return stiffness


def strut_mass() -> BilinearForm:
    """Consistent mass form, integral of ``mass_per_length`` (rho A, kg/m) u v."""

    @BilinearForm
    def mass(u: Any, v: Any, p: Any) -> Any:
        return p.mass_per_length * u * v

    return mass


def line_load() -> LinearForm:
    """Load form, integral of ``force_per_length`` (N/m) v."""

    @LinearForm
    def load(v: Any, p: Any) -> Any:
        return p.force_per_length * v

    return load
