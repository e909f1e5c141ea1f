"""A jointed bar: mesh, materials, sections, supports and joints, assembled to a system."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.contact import PressureTable, nodal_normal_forces
from skfem_joint.errors import InputError
from skfem_joint.forms import line_load, strut_mass, strut_stiffness
from skfem_joint.loads import Load
from skfem_joint.meshing import BarMesh
from skfem_joint.system import AppliedLoad, System

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Joint:
    """A region of the bar pressed on a rigid base.

    Attributes
    ----------
    region : str
        Name of the region.
    pressure : float or PressureTable
        Clamping pressure, Pa.
    friction : float
        Coefficient of friction.
    beta : float
        Scaling constant of the arctan law, Eq. (2), s/m; ``inf`` is Coulomb.
    normal_force : {"consistent", "equal"}
        How the pressure is lumped, see :mod:`skfem_joint.contact`.
    """

    region: str
    pressure: float | PressureTable
    friction: float
    beta: float = 1e5
    normal_force: str = "consistent"


@dataclass(frozen=True)
class Structure:
    """A bar with joints; all arrays hold one value an element.

    Attributes
    ----------
    bar : BarMesh
    E : ndarray
        Young's modulus, Pa.
    density : ndarray
        kg/m3.
    width, thickness : ndarray
        m.
    fixed : tuple of str
        Names of the supported points.
    joints : tuple of Joint
    stiffness_damping, mass_damping : float
        C = stiffness_damping K + mass_damping M, in s and 1/s.
    lumped_mass : bool
        Row-sum lumping instead of the consistent mass.
    """

    bar: BarMesh
    E: FloatArray
    density: FloatArray
    width: FloatArray
    thickness: FloatArray
    fixed: tuple[str, ...]
    joints: tuple[Joint, ...] = ()
    stiffness_damping: float = 0.0
    mass_damping: float = 0.0
    lumped_mass: bool = False

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return int(self.bar.mesh.p.shape[1])

    @property
    def position(self) -> FloatArray:
        """Position of the nodes along the bar, m."""
        return np.asarray(self.bar.mesh.p[0])

    @cached_property
    def fixed_nodes(self) -> NDArray[np.intp]:
        """Supported nodes."""
        return np.unique([self.bar.points[name] for name in self.fixed]).astype(np.intp)

    @cached_property
    def free(self) -> NDArray[np.intp]:
        """Nodes that are not supported, in order along the bar: the unknowns of the system."""
        return np.setdiff1d(np.arange(self.n_nodes), self.fixed_nodes)

    def joint_nodes(self, joint: Joint) -> NDArray[np.intp]:
        """Contact nodes of a joint: those of its elements that are not supported."""
        return np.setdiff1d(self.bar.region_nodes(joint.region), self.fixed_nodes)

    def expand(self, u: FloatArray) -> FloatArray:
        """Values on all nodes (zero at supports) from values on the unknowns, last axis."""
        full = np.zeros((*u.shape[:-1], self.n_nodes))
        full[..., self.free] = u
        return full

    def friction_per_length(self, joint: Joint) -> FloatArray:
        """Friction limit per length, mu P w, in the joint's elements at their middle, N/m."""
        elements = self.bar.regions[joint.region]
        middle = self.position[self.bar.mesh.t[:, elements]].mean(axis=0)
        p = joint.pressure
        value = p(middle) if isinstance(p, PressureTable) else np.full(middle.shape, p)
        return np.asarray(joint.friction * value * self.width[elements])


def build_structure(
    bar: BarMesh,
    *,
    E: float,
    density: float,
    width: float,
    thickness: float,
    fixed: Sequence[str],
    joints: Sequence[Joint] = (),
    stiffness_damping: float = 0.0,
    mass_damping: float = 0.0,
    lumped_mass: bool = False,
    regions: Mapping[str, Mapping[str, float]] | None = None,
) -> Structure:
    """Structure with the same material and section everywhere but where ``regions`` says other.

    Parameters
    ----------
    E, density, width, thickness : float
        Pa, kg/m3, m, m.
    fixed : sequence of str
        Names of the supported points.
    regions : mapping, optional
        ``{region: {"E": ..., "width": ...}}``: values that differ in a region.

    Raises
    ------
    InputError
        For values that are not positive and finite, and names that the mesh does not have.
    """
    problems: list[str] = []
    n_elements = bar.mesh.t.shape[1]
    values = {"E": E, "density": density, "width": width, "thickness": thickness}
    fields = {name: np.full(n_elements, float(value)) for name, value in values.items()}
    for region, overrides in (regions or {}).items():
        if region not in bar.regions:
            problems.append(_missing("region", region, bar.regions))
            continue
        for name, value in overrides.items():
            if name not in fields:
                problems.append(f"regions.{region}: unknown property {name!r}")
            else:
                fields[name][bar.regions[region]] = value
    problems += [
        f"{name}: found {array[~(array > 0.0) | ~np.isfinite(array)][0]}, must be > 0"
        for name, array in fields.items()
        if not np.all((array > 0.0) & np.isfinite(array))
    ]
    problems += [_missing("point", name, bar.points) for name in fixed if name not in bar.points]
    taken = np.zeros(n_elements, dtype=bool)
    for joint in joints:
        if joint.region not in bar.regions:
            problems.append(_missing("region", joint.region, bar.regions))
            continue
        elements = bar.regions[joint.region]
        if np.any(taken[elements]):
            problems.append(f"joint region {joint.region!r} overlaps another joint")
        taken[elements] = True
        if not (joint.friction >= 0.0 and np.isfinite(joint.friction)):
            problems.append(f"joint {joint.region!r}: friction {joint.friction} must be >= 0")
        if not joint.beta > 0.0:
            problems.append(f"joint {joint.region!r}: beta {joint.beta} must be > 0")
        if isinstance(joint.pressure, (int, float)) and not (
            joint.pressure >= 0.0 and np.isfinite(joint.pressure)
        ):
            problems.append(f"joint {joint.region!r}: pressure {joint.pressure} must be >= 0")
    for name, value in (("stiffness", stiffness_damping), ("mass", mass_damping)):
        if not (value >= 0.0 and np.isfinite(value)):
            problems.append(f"damping.{name}: found {value}, must be >= 0")
    if problems:
        raise InputError(problems)
    return Structure(
        bar=bar,
        E=fields["E"],
        density=fields["density"],
        width=fields["width"],
        thickness=fields["thickness"],
        fixed=tuple(fixed),
        joints=tuple(joints),
        stiffness_damping=stiffness_damping,
        mass_damping=mass_damping,
        lumped_mass=lumped_mass,
    )


def _missing(kind: str, name: str, known: Mapping[str, object]) -> str:
    return f"no {kind} named {name!r} in the mesh; it has: {', '.join(sorted(known)) or 'none'}"


def assemble(
    structure: Structure,
    loads: Sequence[tuple[str, Load]] = (),
    points: Sequence[str] | None = None,
) -> System:
    """Assemble the strut system on the unsupported nodes.

    Parameters
    ----------
    structure : Structure
    loads : sequence of (name, load)
        Axial forces, positive along the bar, at a named point or spread evenly along a named
        region.
    points : sequence of str, optional
        Named points to observe; all unsupported ones if not given.

    Returns
    -------
    System
        Sparse system; the unknowns are the displacements of ``structure.free``, m.
    """
    from skfem import Basis, ElementLineP0, ElementLineP1, asm

    bar = structure.bar
    free = structure.free
    if points is None:
        points = [name for name, node in bar.points.items() if node not in structure.fixed_nodes]
    problems = [_missing("point", name, bar.points) for name in points if name not in bar.points]
    problems += [
        _missing("point or region", on, {**bar.points, **bar.regions})
        for on, _ in loads
        if on not in bar.points and on not in bar.regions
    ]
    problems += [
        f"load on {on!r}: the point is supported, a force there does nothing; load a free point"
        for on, _ in loads
        if on in bar.points and bar.points[on] in structure.fixed_nodes
    ]
    if problems:
        raise InputError(problems)

    basis = Basis(bar.mesh, ElementLineP1())
    constant = basis.with_element(ElementLineP0())
    area = structure.width * structure.thickness
    K = asm(strut_stiffness(), basis, axial_stiffness=constant.interpolate(structure.E * area))
    M = asm(strut_mass(), basis, mass_per_length=constant.interpolate(structure.density * area))
    if structure.lumped_mass:
        M = sparse.diags_array(np.asarray(M.sum(axis=1)).ravel())
    K = sparse.csr_array(sparse.csr_array(K)[free][:, free])
    M = sparse.csr_array(sparse.csr_array(M)[free][:, free])
    C = sparse.csr_array(structure.stiffness_damping * K + structure.mass_damping * M)

    unknown = np.full(structure.n_nodes, -1)
    unknown[free] = np.arange(free.size)
    w = np.zeros(structure.n_nodes)
    beta = np.full(structure.n_nodes, np.nan)
    for joint in structure.joints:
        nodes = structure.joint_nodes(joint)
        if nodes.size == 0:
            raise InputError(
                f"joint {joint.region!r} has no free node: all its nodes are fixed, nothing in it "
                "can slip; refine it or leave it out"
            )
        normal = nodal_normal_forces(
            basis,
            bar.regions[joint.region],
            nodes,
            joint.pressure,
            structure.width,
            joint.normal_force,
        )
        if np.any(beta[nodes] != joint.beta) and not np.all(
            np.isnan(beta[nodes]) | (beta[nodes] == joint.beta)
        ):
            raise InputError(
                f"joint {joint.region!r} shares a node with a joint of another law or beta; "
                "give both the same, or leave an element between them"
            )
        w[nodes] += joint.friction * normal
        beta[nodes] = joint.beta
    contact = unknown[np.flatnonzero(~np.isnan(beta))]

    observed = unknown[[bar.points[name] for name in points]].astype(int)
    supported = [name for name, i in zip(points, observed, strict=True) if i < 0]
    if supported:
        raise InputError(f"points: {', '.join(supported)} is supported and does not move")
    return System(
        M=M,
        C=C,
        K=K,
        B=_selection(contact, free.size),
        w=w[free[contact]],
        beta=beta[free[contact]],
        loads=tuple(
            AppliedLoad(_distribution(structure, basis, on)[free], load, on) for on, load in loads
        ),
        P=_selection(observed, free.size),
        points=tuple(points),
    )


def _selection(rows: NDArray[np.intp], n: int) -> sparse.csr_array:
    ones = np.ones(rows.size)
    return sparse.csr_array((ones, (np.arange(rows.size), rows)), shape=(rows.size, n))


def _distribution(structure: Structure, basis: Any, on: str) -> FloatArray:
    """Nodal shares of a unit force at a point, or spread evenly along a region."""
    bar = structure.bar
    shares = np.zeros(structure.n_nodes)
    if on in bar.points:
        shares[bar.points[on]] = 1.0
        return shares
    elements = bar.regions[on]
    if elements.size == 0:
        raise InputError(f"load on {on!r}: the region has no elements to spread the force over")
    length = float(np.diff(structure.position)[elements].sum())
    region = basis.with_elements(elements)
    return np.asarray(line_load().assemble(region, force_per_length=1.0 / length + 0.0 * region.dx))
