"""The elastic body of any dimension: nodes, mass, stiffness and stress on a mesh.

A body of dimension 1, 2 or 3 has the strain energy ``across (lambda tr(eps)^2 / 2 + mu eps : eps)``
by length, area or volume of the mesh, and the mass ``across rho``. ``across`` is the area of a
bar's section, the thickness of a plate, or 1 for a solid. Under plane stress lambda is replaced by
2 lambda mu / (lambda + 2 mu). A bar has lambda = E and mu = 0, so that only axial strain counts.
The weak form and its assembly are in :mod:`skfem_joint.body.assembly`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np
import skfem
from scipy import sparse

from skfem_joint.body import assembly
from skfem_joint.body.checks import one_of, overlap, wrong_name
from skfem_joint.body.nodes import Nodes
from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray, Matrix
from skfem_joint.ground.errors import refuse
from skfem_joint.ground.values import POISSON, POSITIVE, check_kind, problems
from skfem_joint.mesh.named import bar_axis
from skfem_joint.system.unknowns import congruent

#: Names of the sizes across the mesh, by the dimension of the body.
SECTION = {1: ("width", "thickness"), 2: ("thickness",), 3: ()}


@dataclass(frozen=True)
class Material:
    """Linear elastic, isotropic material.

    Attributes
    ----------
    E : float
        Young's modulus, Pa.
    density : float
        Mass by volume, kg/m3.
    poisson : float, optional
        Poisson's ratio; bars do not need it.
    """

    E: float
    density: float
    poisson: float | None = None


@dataclass(frozen=True)
class Body(Nodes):
    """One or several elastic bodies on a mesh, without supports and joints.

    Attributes
    ----------
    mesh : NamedMesh
        Of dimension 1, 2 or 3, with named regions, boundaries and points.
    material : Material
    width : float, optional
        Of a bar, m.
    thickness : float, optional
        Of a bar or a plate, m.
    plane : {"stress", "strain"}
        State of a plate across its plane.
    mass : {"consistent", "lumped"}
        Integrals of products of shape functions, or their row sums on the diagonal.
    regions : mapping
        ``{region: {"E": ..., "thickness": ...}}``: values that differ in a region.
    incompatible : bool
        Whether quadrilaterals and hexahedra of first order have incompatible modes, without which
        they bend too stiffly. Other elements have none: it does nothing for bars, triangles,
        tetrahedra and elements of second order.

    Raises
    ------
    InputError
        For values out of range, missing sizes, and names that are no regions of the mesh.
    """

    material: Material
    plane: str = "stress"
    mass: str = "consistent"
    regions: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    incompatible: bool = True
    _last: list[Matrix] = field(init=False, repr=False, compare=False, default_factory=list)

    def __post_init__(self) -> None:
        check_kind("material", self.material, Material)
        refuse([*_value_problems(self), *_override_problems(self)])

    @cached_property
    def properties(self) -> dict[str, FloatArray]:
        """E, density, poisson, width and thickness of each element, shape (elements,) each."""
        values = {**vars(self.material), "width": self.width, "thickness": self.thickness}
        absent = {"poisson": 0.0, "width": 1.0, "thickness": 1.0}
        fields = {
            name: np.full(self.mesh.n_elements, float(absent[name] if value is None else value))
            for name, value in values.items()
        }
        for region, overrides in self.regions.items():
            for name, value in overrides.items():
                fields[name][self.mesh.regions[region]] = value
        return fields

    @property
    def section(self) -> tuple[FloatArray, FloatArray]:
        """Width and thickness of each element, (elements,) each, m."""
        return self.properties["width"], self.properties["thickness"]

    @property
    def size(self) -> float:
        """Largest extent of the mesh, m."""
        return self.mesh.size

    @property
    def across(self) -> FloatArray:
        """Extent across the mesh: section area (m2), thickness (m) or 1, shape (elements,)."""
        width, thickness = self.section
        return width * thickness

    @cached_property
    def total_mass(self) -> float:
        """Mass of all bodies, kg."""
        return float(self.basis.dx.sum(axis=1) @ (self.properties["density"] * self.across))

    def lame(self, E: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Elastic constants lambda and mu for this dimension, Pa, shape (elements,) each.

        ``E`` (elements,) are other Young's moduli than those of the material.
        """
        E = self.properties["E"] if E is None else E
        nu = self.properties["poisson"]
        if self.dim == 1:
            return E, np.zeros_like(E)
        mu = E / (2.0 * (1.0 + nu))
        plane_stress = self.dim == 2 and self.plane == "stress"
        return 2.0 * mu * nu / (1.0 - nu if plane_stress else 1.0 - 2.0 * nu), mu

    def matrices(self) -> tuple[sparse.csr_array, sparse.csr_array]:
        """Mass (kg) and stiffness (N/m) of all nodes, without supports, shape (dim N, dim N).

        Degrees of freedom are ``dim * node + component``. The matrices are assembled once.
        """
        return self._matrices

    @cached_property
    def _matrices(self) -> tuple[sparse.csr_array, sparse.csr_array]:
        mass = assembly.mass(self.basis, self.properties["density"] * self.across)
        if self.mass == "lumped":
            mass = sparse.csr_array(sparse.diags_array(np.asarray(mass.sum(axis=1)).ravel()))
        if self.dim > 1:
            mass = sparse.csr_array(sparse.kron(mass, sparse.eye_array(self.dim)))
        first, second = (constant * self.across for constant in self.lame())
        return mass, self._stiffness(first, second)

    def _stiffness(
        self, first: FloatArray, second: FloatArray, elements: IntArray | None = None
    ) -> sparse.csr_array:
        """Stiffness of elements, by default all, with their constants times ``across``."""
        constants = first, second, elements
        return assembly.stiffness(
            self._strain_basis, *constants, incompatible=self.has_incompatible_modes
        )

    @property
    def has_incompatible_modes(self) -> bool:
        """Whether the elements have incompatible modes: such as can have them, unless unwanted."""
        can = any(part.kind.bends for part in self.mesh.parts)
        return self.incompatible and can and self.mesh.order == 1

    def in_unknowns(self, T: sparse.csr_array) -> tuple[Matrix, Matrix]:
        """Mass and stiffness in the unknowns q of u = T q; those of the last T are kept."""
        last, parts = self._last, ("indptr", "indices", "data")
        if not last or not (
            last[0].shape == T.shape
            and all(np.array_equal(getattr(last[0], part), getattr(T, part)) for part in parts)
        ):
            last[:] = T, *(congruent(A, T) for A in self._matrices)
        return last[1], last[2]

    def elements_of_modulus(self, region: str | None = None) -> BoolArray:
        """Elements, (elements,), whose Young's modulus is that of a region, or the material's."""
        given = {name: "E" in values for name, values in self.regions.items()}
        own = np.full(self.mesh.n_elements, region is None)
        for name in (name for name, differs in given.items() if differs):
            own[self.mesh.regions[name]] = name == region
        return own

    def stiffness_by_modulus(self, region: str | None = None) -> sparse.csr_array:
        """Derivative of the stiffness by Young's modulus, m, shape (dim N, dim N).

        By that of a ``region``, or by that of the material, which all other elements have. The
        stiffness is linear in both.
        """
        own = self.elements_of_modulus(region)
        modulus = self.properties["E"]
        if own.all():
            return sparse.csr_array(self._matrices[1] / modulus[0])
        if not own.any():
            return sparse.csr_array(self._matrices[1].shape)
        elements = np.flatnonzero(own)
        first, second = ((c * self.across)[own] for c in self.lame(np.ones_like(modulus)))
        return self._stiffness(first, second, elements)

    @property
    def _strain_basis(self) -> skfem.Basis:
        """Basis whose quadrature is exact for products of gradients of the shape functions.

        Gradients on simplices are polynomials of lower order, so that fewer points suffice. For
        bars another basis would cost more than it saves.
        """
        if not self.is_simplex or self.dim == 1:
            return self.basis
        order = 2 * (self.mesh.order - 1)
        return skfem.Basis(self.mesh.mesh, self.element, intorder=order)

    def unpacked(self, x: FloatArray) -> FloatArray:
        """Vectors of all nodes, shape (..., N, dim), from degrees of freedom, (..., dim N)."""
        return x.reshape(*x.shape[:-1], self.n_nodes, self.dim)

    @cached_property
    def axes(self) -> FloatArray:
        """Directions in space of the mesh's coordinates, (dim, 3); a bar may be inclined."""
        if self.dim > 1:
            return np.eye(3)[: self.dim]
        _, along = bar_axis(self.mesh)
        return np.asarray(along / np.linalg.norm(along))[np.newaxis]

    def in_space(self, vectors: FloatArray) -> FloatArray:
        """Vectors in space, (..., 3), from vectors in the mesh's coordinates, (..., dim)."""
        return np.asarray(vectors @ self.axes)

    @cached_property
    def positions(self) -> FloatArray:
        """Positions of the nodes in space, (N, 3), m."""
        if self.dim == 1:
            return self.mesh.coordinates
        return np.pad(self.nodes, ((0, 0), (0, 3 - self.dim)))

    @cached_property
    def _mean_gradients(self) -> FloatArray:
        """Means over the elements of the shape functions' gradients, (functions, dim, elements)."""
        dx = self.basis.dx / self.basis.dx.sum(axis=1, keepdims=True)
        return np.array([np.sum(shape.grad * dx, axis=2) for (shape,) in self.basis.basis])

    def gradient(self, displacement: FloatArray) -> FloatArray:
        """Mean gradient in each element, (elements, dim, dim), of a displacement (N, dim)."""
        u = displacement[self.basis.element_dofs]
        return np.asarray(np.einsum("aek,ale->ekl", u, self._mean_gradients))

    def stress(self, displacement: FloatArray) -> FloatArray:
        """Mean elastic stress of each element in space, from the displacement of all nodes.

        Incompatible modes add nothing: the mean of their gradients over the element is zero.

        Parameters
        ----------
        displacement : ndarray, shape (N, dim)
            In m.

        Returns
        -------
        ndarray, shape (elements, 6)
            Components XX, YY, ZZ, XY, YZ and XZ, Pa.
        """
        gradient = self.gradient(displacement)
        first, second = self.lame()
        volume = first * np.trace(gradient, axis1=1, axis2=2)
        shear = second[:, None, None] * (gradient + gradient.transpose(0, 2, 1))
        inside = volume[:, None, None] * np.eye(self.dim) + shear
        tensor = self.axes.T @ inside @ self.axes
        if self.dim == 2 and self.plane == "strain":
            tensor[:, 2, 2] = volume
        return np.asarray(tensor[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]])


def _value_problems(body: Body) -> Iterator[str]:
    """What is wrong with sizes, material and choices of a body."""
    needed = SECTION[body.dim]
    what = {1: "a bar", 2: "a plate", 3: "a solid"}[body.dim]
    for name in ("width", "thickness"):
        value = getattr(body, name)
        if value is None and name in needed:
            yield f"section.{name}: missing, {what} needs it, in m"
        elif value is not None and name not in needed:
            yield f"section.{name}: found {value}, but {what} has none; leave it out"
        elif value is not None:
            yield from problems(f"section.{name}", value, POSITIVE)
    if body.dim != 2 and body.plane == "strain":
        yield f"section.plane: found 'strain', but {what} has none; leave it out"
    material = body.material
    yield from problems("material.E", material.E, POSITIVE)
    yield from problems("material.density", material.density, POSITIVE)
    if body.dim > 1 and material.poisson is None:
        yield f"material.poisson: missing, {what} needs Poisson's ratio"
    if material.poisson is not None:
        yield from problems("material.poisson", material.poisson, POISSON)
    yield from one_of("plane", body.plane, ("stress", "strain"))
    yield from one_of("mass", body.mass, ("consistent", "lumped"))
    if body.mass == "lumped" and body.mesh.order > 1:
        yield (
            "material.mass_matrix: found 'lumped' beside elements of second order, whose row sums "
            "are zero or negative at some nodes; use 'consistent'"
        )


def _override_problems(body: Body) -> Iterator[str]:
    """What is wrong with the values that differ in regions."""
    known = ("E", "density", "poisson", *SECTION[body.dim])
    regions = body.mesh.regions
    for region, values in body.regions.items():
        where = f"regions.{region}"
        yield from wrong_name(body.mesh, region, ("region",), where)
        check_kind(where, values, Mapping)
        for name, value in values.items():
            yield from one_of(f"{where}: property", name, known)
            kind = POISSON if name == "poisson" else POSITIVE
            yield from problems(f"{where}.{name}", value, kind)
    for (name, first), (other, second) in combinations(body.regions.items(), 2):
        both = sorted(set(first) & set(second))
        if both and overlap(regions.get(name, ()), regions.get(other, ())):
            yield (
                f"regions.{other}: found {' and '.join(both)}, which region {name!r} also sets; "
                "the two regions share elements, so only one may"
            )
