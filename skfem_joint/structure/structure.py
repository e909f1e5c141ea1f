"""A jointed structure of any dimension: bodies, supports and joints, assembled to a system.

A body of dimension 1, 2 or 3 has the strain energy ``across (lambda tr(eps)^2 / 2 + mu eps : eps)``
and the mass ``across rho``. ``across`` is the area of a bar's section, the thickness of a plate, or
1. Plane stress takes lambda' = 2 lambda mu / (lambda + 2 mu); a bar has lambda + 2 mu = E.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.arrays import BoolArray, FloatArray
from skfem_joint.errors import InputError, refuse
from skfem_joint.loads import Scaled
from skfem_joint.mesh import NamedMesh, load_meshes, named
from skfem_joint.mesh.named import bar_axis
from skfem_joint.structure import checks
from skfem_joint.structure.contact import Reactions, contact_rows, reactions
from skfem_joint.structure.load import Load, acting, loaded
from skfem_joint.structure.nodes import Nodes
from skfem_joint.structure.patch import Joint, Patch, check_shared, make_patch
from skfem_joint.structure.preload import Clamp, Preload, clamp_problems, cuts, preload
from skfem_joint.system import AppliedLoad, System
from skfem_joint.unknowns import (
    Arrangement,
    Contact,
    change_of_unknowns,
    congruent,
    expanded,
    selection,
)

#: Numbers of rows and of columns, along matrices of elements.
_ROW, _COLUMN = np.s_[:, :, np.newaxis], np.s_[:, np.newaxis, :]


@dataclass(frozen=True)
class Material:
    """Linear elastic, isotropic: Young's modulus (Pa), density (kg/m3), Poisson's ratio.

    Bars do without Poisson's ratio.
    """

    E: float
    density: float
    poisson: float | None = None


@dataclass(frozen=True)
class Structure(Nodes):
    """Bodies with joints.

    Attributes
    ----------
    mesh : NamedMesh or skfem.Mesh, or str or Path
        Of dimension 1, 2 or 3, with named regions, boundaries and points; or the file of one, see
        `load_meshes`.
    material : Material
    width : float, optional
        Of a bar, m; it lies on its base with it.
    thickness : float, optional
        Of a bar or a plate, m.
    plane : {"stress", "strain"}
        Of plates: thin in their plane, or slices of bodies long across it.
    fixed, fixed_x, fixed_y, fixed_z : sequence of str
        Regions, boundaries and points that are held in all directions or in one.
    joints : sequence of Joint
    bolts : sequence of Clamp
        That press the joints with ``pressure = "preload"``.
    stiffness_damping, mass_damping : float
        C = stiffness_damping K + mass_damping M, in s and 1/s.
    damping_ratio : float, optional
        Of the critical damping, in place of these two: see `System.with_damping_ratio`.
    mass : {"consistent", "lumped"}
        Integrals of shape functions, or their row sums on the diagonal.
    regions : mapping
        ``{region: {"E": ..., "thickness": ...}}``: values that differ in a region.
    free : bool
        Bodies may float; otherwise one that nothing holds is an error.

    Raises
    ------
    InputError
        For values out of range, names that the mesh does not have or that are of another kind,
        joints that overlap or whose bodies do not, and bodies that nothing holds.
    """

    material: Material
    width: float | None = None
    thickness: float | None = None
    plane: str = "stress"
    fixed: Sequence[str] = ()
    fixed_x: Sequence[str] = ()
    fixed_y: Sequence[str] = ()
    fixed_z: Sequence[str] = ()
    joints: Sequence[Joint] = ()
    bolts: Sequence[Clamp] = ()
    stiffness_damping: float = 0.0
    mass_damping: float = 0.0
    damping_ratio: float | None = None
    mass: str = "consistent"
    regions: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    free: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.mesh, str | Path):
            object.__setattr__(self, "mesh", load_meshes(self.mesh))
        elif not isinstance(self.mesh, NamedMesh):
            object.__setattr__(self, "mesh", named(self.mesh))
        for name in ("fixed", "fixed_x", "fixed_y", "fixed_z", "joints", "bolts"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        refuse(checks.problems_of(self) or clamp_problems(self))
        refuse(
            f"{body} is left unsupported: it can move or turn freely; hold it by a support, or "
            "by a joint with friction on a body that is held"
            for body in (() if self.free else checks.loose_bodies(self))
        )

    @cached_property
    def properties(self) -> dict[str, FloatArray]:
        """E, density, poisson, width and thickness, one value an element."""
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
    def size(self) -> float:
        """Largest extent, m."""
        return self.mesh.size

    @property
    def n_entries(self) -> int:
        """Number of entries that the matrices are made from."""
        in_element, elements = self.of_element.shape
        return int(elements * (self.dim * in_element) ** 2)

    @property
    def identity(self) -> list[Any]:
        """What tells its mesh from others."""
        named = self.mesh
        where = [named.mesh.p, named.mesh.t, named.order, named.coordinates]
        return [where, [named.regions, named.boundaries, named.points]]

    def unusual(self, system: System) -> list[str]:
        """Sentences about its mesh, values, size and waves: what looks like a slip."""
        found = *checks.unusual(self), *checks.waves(self, system), *checks.locking(self)
        return [*self.mesh.notes, *checks.straightened(self, system), *found]

    def spot(self, dof: int) -> str:
        """The node of a degree of freedom in a message."""
        node = dof // self.dim
        return f"node {node}, at ({', '.join(f'{x:.6g}' for x in self.nodes[node])}) m"

    @property
    def across(self) -> FloatArray:
        """Extent across the mesh: area of the section (m2), thickness (m) or 1, (elements,)."""
        return self.properties["width"] * self.properties["thickness"]

    def lame(self) -> tuple[FloatArray, FloatArray]:
        """Constants lambda and mu of the form of this dimension, Pa, (elements,) each."""
        E, nu = self.properties["E"], self.properties["poisson"]
        if self.dim == 1:
            return E, np.zeros_like(E)
        mu = E / (2.0 * (1.0 + nu))
        stress = self.dim == 2 and self.plane == "stress"
        # Plane stress has no stress across the plane, else lambda is Lame's.
        return 2.0 * mu * nu / (1.0 - nu if stress else 1.0 - 2.0 * nu), mu

    @cached_property
    def held(self) -> BoolArray:
        """Whether a support holds each displacement, (N, dim)."""
        held = np.zeros((self.n_nodes, self.dim), dtype=bool)
        for name in self.fixed:
            held[self.nodes_of(name)] = True
        for component, names in enumerate((self.fixed_x, self.fixed_y, self.fixed_z)):
            for name in names:
                held[self.nodes_of(name), component] = True
        return held

    @cached_property
    def preload(self) -> Preload | None:
        """What clamping bolts do at rest; None without."""
        return preload(self) if self.bolts else None

    @cached_property
    def patches(self) -> tuple[Patch, ...]:
        """Contact points of each joint."""
        problems: list[str] = []
        patches: list[Patch] = []
        numbering = np.full(self.n_nodes, -1, dtype=np.intp)
        p = self.properties
        pressed = [None] * len(self.joints) if self.preload is None else self.preload.joints
        for joint, by_bolts in zip(self.joints, pressed, strict=True):
            try:
                patch = make_patch(
                    self, joint, self.held, p["width"], p["thickness"], numbering, by_bolts
                )
                check_shared(self, patches, patch)
                patches.append(patch)
            except InputError as error:
                problems += error.problems
        refuse(problems)
        return tuple(patches)

    @cached_property
    def _contact(self) -> Contact:
        return contact_rows(self.patches, self.held) + self.cuts

    @cached_property
    def cuts(self) -> Contact:
        """Rows that hold cut shanks together."""
        return cuts(self)

    @cached_property
    def arrangement(self) -> Arrangement:
        """Unknowns from the displacements of all nodes, ``dim * node + component``, and back."""
        rows, fixed = self._contact, np.flatnonzero(self.held)
        return change_of_unknowns(self.held.size, fixed, rows.held, rows.B, rows.pivots)

    @property
    def T(self) -> sparse.csr_array:
        """Displacement of all nodes from the unknowns, (dim N, n)."""
        return self.arrangement.forward

    def expand(self, u: FloatArray) -> FloatArray:
        """Displacement of all nodes, (..., N, dim), from that of the unknowns, (..., n)."""
        return self.unpacked(expanded(self.T, u))

    def unpacked(self, x: FloatArray) -> FloatArray:
        """Vectors of all nodes, (..., N, dim), from what `System.expand` gives, (..., dim N)."""
        return x.reshape(*x.shape[:-1], self.n_nodes, self.dim)

    @cached_property
    def axes(self) -> FloatArray:
        """Directions in space of the mesh's coordinates, (dim, 3); a bar may be inclined."""
        if self.dim > 1:
            return np.eye(3)[: self.dim]
        _, along = bar_axis(self.mesh)
        return np.asarray(along / np.linalg.norm(along))[np.newaxis]

    def in_space(self, vectors: FloatArray) -> FloatArray:
        """Vectors in space, (..., 3), from those in the mesh's coordinates, (..., dim)."""
        return np.asarray(vectors @ self.axes)

    @cached_property
    def positions(self) -> FloatArray:
        """Positions of the nodes in space, (N, 3), m."""
        if self.dim == 1:
            return self.mesh.coordinates
        return np.pad(self.nodes, ((0, 0), (0, 3 - self.dim)))

    def matrices(self) -> tuple[sparse.csr_array, sparse.csr_array]:
        """Mass and stiffness of all nodes before supports and contact, (dim N, dim N), kg and N/m.

        They are assembled once.
        """
        return self._matrices

    @cached_property
    def _matrices(self) -> tuple[sparse.csr_array, sparse.csr_array]:
        """Elements' matrices are made all at once, of ``integral of d_k phi d_l psi``."""
        first, second = (constant * self.across for constant in self.lame())
        values = np.stack([np.asarray(one) for (one,) in self.basis.basis], axis=1)
        gradients = np.stack([one.grad for (one,) in self.basis.basis]).transpose(2, 0, 1, 3)
        (elements, functions, dim, _), dx = gradients.shape, self.basis.dx[:, np.newaxis]
        density = (self.properties["density"] * self.across)[:, np.newaxis, np.newaxis]
        mass = self._scattered((density * dx * values) @ values.transpose(0, 2, 1), 1)
        if self.mass == "lumped":
            mass = sparse.csr_array(sparse.diags_array(np.asarray(mass.sum(axis=1)).ravel()))
        flat = gradients.reshape(elements, functions * dim, -1)
        products = ((dx * flat) @ flat.transpose(0, 2, 1)).reshape(-1, *2 * (functions, dim))
        stiffness = first[:, None, None, None, None] * products
        products *= second[:, None, None, None, None]
        stiffness += products.transpose(0, 1, 4, 3, 2)
        laplacian = np.einsum("eakbk->eab", products)
        for i in range(dim if second.any() else 0):  # a bar has no shear
            stiffness[:, :, i, :, i] += laplacian
        M = sparse.csr_array(sparse.kron(mass, sparse.eye_array(dim)))
        return M, self._scattered(stiffness.reshape(elements, *2 * (functions * dim,)), dim)

    def _scattered(self, blocks: FloatArray, dim: int) -> sparse.csr_array:
        """Symmetric matrix on ``dim * node + component`` from those of the elements, (e, k, k)."""
        dofs = (dim * self.basis.element_dofs.T[:, :, np.newaxis] + np.arange(dim)).astype(np.int32)
        dofs, n = dofs.reshape(len(blocks), -1), dim * self.n_nodes
        row, column = (np.broadcast_to(dofs[at], blocks.shape).ravel() for at in (_ROW, _COLUMN))
        A = sparse.csr_array(sparse.coo_array((blocks.ravel(), (row, column)), shape=(n, n)))
        symmetric = sparse.csr_array(0.5 * (A + A.T))
        symmetric.eliminate_zeros()
        return symmetric

    @cached_property
    def _mean_gradients(self) -> FloatArray:
        """Means of the shape functions' gradients over the elements, (functions, dim, elements)."""
        dx = self.basis.dx / self.basis.dx.sum(axis=1, keepdims=True)
        return np.array([np.sum(one.grad * dx, axis=2) for (one,) in self.basis.basis])

    def gradient(self, displacement: FloatArray) -> FloatArray:
        """Mean gradient of displacements (N, dim) in each element, (elements, dim, dim)."""
        u = displacement[self.basis.element_dofs]
        return np.asarray(np.einsum("aek,ale->ekl", u, self._mean_gradients))

    def stress(self, displacement: FloatArray) -> FloatArray:
        """Elastic stress in space from the displacement of all nodes, (N, dim).

        Mean of each element: XX, YY, ZZ, XY, YZ and XZ in the columns, (elements, 6), Pa.
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

    def system(self, loads: Sequence[Load] = (), points: Sequence[str] | None = None) -> System:
        """System of equations, sparse; every row of ``B`` picks one unknown.

        Observed are ``points``, boundaries or regions, the latter two by their mean, and all points
        that can move if none are given. Rows of ``P``: one named as each load, the displacement
        that it works on (another direction at the same place gets ".2" and so on), then what is
        observed: "name" in one dimension, else "name.x" and so on. An accelerated base becomes the
        inertia force of all mass (N), named "mass_x": it works on the mean displacement by mass. A
        traction or pressure becomes its force on the whole area (N), a pressure on the mean
        displacement inwards.

        Raises
        ------
        InputError
            For unknown names, directions that do not fit, and loads on what cannot move.
        """
        refuse(checks.problems_of_places(self, loads, points))
        T, (M, _) = self.T, self.matrices()
        problems: list[str] = []
        rows: dict[str, FloatArray] = {}
        applied: list[AppliedLoad] = []
        notes: list[str] = []
        for load in loads:
            on = load.on or f"mass_{load.base}"
            vector, scale, note = acting(self, load, M)
            vector, amplitude = T.T @ vector, load.amplitude
            if note:
                notes += note
                amplitude = Scaled(amplitude, scale)
            if not np.any(vector):
                pressed = load.quantity == "pressure"
                along = "its normal" if pressed else load.unit(self.dim).tolist()
                problems.append(
                    f"{load.label}: a support holds it along {along}, a force there does nothing; "
                    "load a free part"
                )
            name = _free_name(on, vector, rows)
            rows[name] = vector
            applied.append(AppliedLoad(vector, amplitude, name))
        for name in self.free_points if points is None else dict.fromkeys(points):
            shares = self.even_shares(name)
            parts = [T.T @ np.outer(shares, axis).ravel() for axis in np.eye(self.dim)]
            if not np.any(parts):
                problems.append(f"points: {name!r} is supported and does not move")
            labels = [name] if self.dim == 1 else [f"{name}.{c}" for c in "xyz"[: self.dim]]
            rows |= dict(zip(labels, parts, strict=True))
        refuse(problems)
        return loaded(self, applied, rows, notes)

    def reactions(self, loads: Sequence[Load]) -> Reactions | None:
        """Change of the normal forces; None where no contact is closed."""
        rows = self._contact
        if rows.pivots is None or not rows.normal_force.any():
            return None
        M, K = self.matrices()
        F = np.stack([acting(self, load, M)[0] for load in loads], axis=1)
        cells = np.vstack([patch.cells for patch in self.patches if patch.normal is not None])
        # Of each node the degree of freedom that closed contact determines.
        dof = np.arange(self.n_nodes) * self.dim
        determined = rows.pivots[: rows.held.shape[0]]
        dof[determined // self.dim] = determined
        fixed = np.flatnonzero(self.held)
        return reactions(rows, fixed, (M, K), self.T, F, dof[cells])

    def pressed_at(self, dof: int) -> str:
        """Joint and node of a degree of freedom that closed contact determines."""
        names = [p.joint.name for p in self.patches if dof // self.dim in p.nodes]
        return f"joint {names[0]} around {self.spot(dof)}"

    @property
    def free_points(self) -> tuple[str, ...]:
        """Named points that can move."""
        moves = np.diff(self.T.indptr[:: self.dim]) > 0
        return tuple(name for name, node in self.mesh.points.items() if moves[node])

    @cached_property
    def unloaded(self) -> System:
        """System without loads, observed points and joints' names."""
        contact, new = self._contact, self.arrangement
        M, K = (congruent(A, new.forward) for A in self.matrices())
        return System(
            M=M,
            C=sparse.csr_array(self.stiffness_damping * K + self.mass_damping * M),
            K=K,
            B=selection(new.slips, K.shape[0]),
            w=contact.w,
            beta=contact.beta,
            directions=contact.directions,
            T=new.forward,
        )


def _free_name(on: str, vector: FloatArray, rows: Mapping[str, FloatArray]) -> str:
    """Name of a load's row: ``on``, or with a number where another direction has that."""
    names = chain([on], (f"{on}.{number}" for number in count(2)))
    return next(n for n in names if n not in rows or np.array_equal(rows[n], vector))
