"""Factories of scikit-fem forms for struts and plates: stiffness, mass and even loads.

Strong form of the strut in its axial displacement u(x, t), with friction traction q per length:
rho A u'' - (E A u_x)_x + q = f. Coefficients come as fields of the form's parameters, so that they
may differ from element to element (pass ``basis0.interpolate(values)`` for one value an element).
"""

from __future__ import annotations

from typing import Any

from skfem import BilinearForm, LinearForm
from skfem.helpers import ddot, dot, grad, sym_grad, trace


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


def plate_stiffness() -> BilinearForm:
    """Stiffness form of a plate in its plane, from the strains of both displacements.

    Integral of ``first`` tr(eps(u)) tr(eps(v)) + 2 ``second`` eps(u) : eps(v), where ``first`` and
    ``second`` (N/m) are Lamé's constants times the thickness.
    """

    @BilinearForm
    def stiffness(u: Any, v: Any, p: Any) -> Any:
        of_u, of_v = sym_grad(u), sym_grad(v)
        return p.first * trace(of_u) * trace(of_v) + 2.0 * p.second * ddot(of_u, of_v)

    return stiffness


def plate_mass() -> BilinearForm:
    """Consistent mass form of a plate, integral of ``mass_per_area`` (rho t, kg/m2) u . v."""

    @BilinearForm
    def mass(u: Any, v: Any, p: Any) -> Any:
        return p.mass_per_area * dot(u, v)

    return mass


def unit_load() -> LinearForm:
    """Integral of v: what one unit spread evenly gives to each shape function."""

    @LinearForm
    def load(v: Any, _: Any) -> Any:
        return 1.0 * v

    return load
