"""Plates from what a user says of them, and their system of equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.errors import InputError
from skfem_joint.forms import plate_mass, plate_stiffness, unit_load
from skfem_joint.loads import Load
from skfem_joint.plate_mesh import PlateMesh
from skfem_joint.plate_structure import (
    SMALL,
    Patch,
    PlateJoint,
    PlateStructure,
    selection,
)
from skfem_joint.system import AppliedLoad, System

__all__ = [
    "PLANES",
    "SUPPORTS",
    "Patch",
    "PlateJoint",
    "PlateStructure",
    "assemble_plate",
    "build_plate_structure",
    "full_matrices",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

#: Plane states: thin plate in its plane, and slice of a body long across the plane.
PLANES = ("stress", "strain")
#: Directions a support can hold.
SUPPORTS = ("xy", "x", "y")

_KINDS = ("region", "boundary", "point")
_PLURALS = {"region": "regions", "boundary": "boundaries", "point": "points"}


def build_plate_structure(
    plate: PlateMesh,
    *,
    E: float,
    poisson: float,
    density: float,
    thickness: float,
    supports: Sequence[tuple[str, str]],
    joints: Sequence[PlateJoint] = (),
    plane: str = "stress",
    stiffness_damping: float = 0.0,
    mass_damping: float = 0.0,
    regions: Mapping[str, Mapping[str, float]] | None = None,
) -> PlateStructure:
    """Structure with the same material and thickness everywhere but where ``regions`` says other.

    Parameters
    ----------
    plate : PlateMesh
    E, poisson, density, thickness : float
        Pa, dimensionless, kg/m3, m.
    supports : sequence of (name, directions)
        Boundary, region or point and "xy", "x" or "y".
    joints : sequence of PlateJoint
    plane : {"stress", "strain"}
    stiffness_damping, mass_damping : float
        s and 1/s.
    regions : mapping, optional
        ``{region: {"E": ..., "thickness": ...}}``: values that differ in a region.

    Raises
    ------
    InputError
        For values out of range, names that the mesh does not have or that are of another kind,
        joints or bodies that do not overlap, and bodies that nothing holds.
    """
    problems: list[str] = []
    n_elements = plate.mesh.t.shape[1]
    values = {"E": E, "poisson": poisson, "density": density, "thickness": thickness}
    fields = {name: np.full(n_elements, float(value)) for name, value in values.items()}
    for region, overrides in (regions or {}).items():
        problem = _wrong_name(plate, region, ("region",), f"regions.{region}")
        if problem:
            problems.append(problem)
            continue
        for name, value in overrides.items():
            if name not in fields:
                problems.append(
                    f"regions.{region}: unknown property {name!r}, must be one of "
                    f"{', '.join(fields)}"
                )
            else:
                fields[name][plate.regions[region]] = value
    for name, array in fields.items():
        if name == "poisson":
            good, allowed = (array > -1.0) & (array < 0.5), "between -1 and 0.5"
        else:
            good, allowed = (array > 0.0) & np.isfinite(array), "> 0"
        if not np.all(good):
            problems.append(f"{name}: found {array[~good][0]}, must be {allowed}")
    if plane not in PLANES:
        problems.append(f"plane: found {plane!r}, must be one of {', '.join(PLANES)}")
    for name, value in (("stiffness", stiffness_damping), ("mass", mass_damping)):
        if not (value >= 0.0 and np.isfinite(value)):
            problems.append(f"damping.{name}: found {value}, must be >= 0")
    for name, directions in supports:
        problem = _wrong_name(plate, name, _KINDS, "support")
        if problem:
            problems.append(problem)
        if directions not in SUPPORTS:
            problems.append(
                f"support {name!r}: found {directions!r}, must be one of {', '.join(SUPPORTS)}"
            )
    problems += _wrong_joints(plate, joints)
    if problems:
        raise InputError(problems)
    structure = PlateStructure(
        plate=plate,
        E=fields["E"],
        poisson=fields["poisson"],
        density=fields["density"],
        thickness=fields["thickness"],
        plane=plane,
        supports=tuple((name, directions) for name, directions in supports),
        joints=tuple(joints),
        stiffness_damping=stiffness_damping,
        mass_damping=mass_damping,
    )
    problems = _loose_bodies(structure)
    if problems:
        raise InputError(problems)
    _ = structure.T  # finds circles of bodies
    return structure


def _tables(plate: PlateMesh) -> dict[str, Mapping[str, Any]]:
    return {"region": plate.regions, "boundary": plate.boundaries, "point": plate.points}


def _wrong_name(plate: PlateMesh, name: str, kinds: Sequence[str], where: str) -> str | None:
    """What is wrong with a name that must be of one of the kinds."""
    tables = _tables(plate)
    found = [kind for kind in _KINDS if name in tables[kind]]
    right = [kind for kind in found if kind in kinds]
    needed = " or ".join([", ".join(kinds[:-1]), kinds[-1]] if len(kinds) > 1 else kinds)
    if len(right) == 1:
        if right[0] != "point" and len(tables[right[0]][name]) == 0:
            return f"{where}: the {right[0]} {name!r} is empty"
        return None
    if len(right) > 1:
        return (
            f"{where}: {name!r} is the name of a {' and of a '.join(right)}; rename one of them "
            "in the mesh"
        )
    if found:
        known = ", ".join(sorted(name for kind in kinds for name in tables[kind])) or "none"
        return (
            f"{where}: found {name!r}, which is a {found[0]}; a {needed} is needed; the mesh has: "
            f"{known}"
        )
    has = "; ".join(f"{_PLURALS[kind]} {', '.join(sorted(tables[kind])) or '-'}" for kind in _KINDS)
    return f"{where}: no {needed} named {name!r} in the mesh; it has: {has}"


def _wrong_joints(plate: PlateMesh, joints: Sequence[PlateJoint]) -> list[str]:
    """What is wrong with joints, as far as it can be told without their nodes."""
    problems: list[str] = []
    taken: dict[str, dict[int, str]] = {"region": {}, "boundary": {}}
    outer = set(plate.mesh.boundary_facets().tolist())
    for joint in joints:
        where = joint.label
        if joint.kind not in taken:
            problems.append(f"{where}: kind: found {joint.kind!r}, must be region or boundary")
            continue
        if not (joint.friction >= 0.0 and np.isfinite(joint.friction)):
            problems.append(f"{where}: friction: found {joint.friction}, must be >= 0")
        if not joint.beta > 0.0:
            problems.append(f"{where}: beta: found {joint.beta}, must be > 0")
        if isinstance(joint.pressure, (int, float)) and not (
            joint.pressure >= 0.0 and np.isfinite(joint.pressure)
        ):
            problems.append(f"{where}: pressure: found {joint.pressure}, must be >= 0")
        table = _tables(plate)[joint.kind]
        names = [joint.name] if joint.against is None else [joint.name, joint.against]
        wrong = [
            problem for name in names if (problem := _wrong_name(plate, name, (joint.kind,), where))
        ]
        problems += wrong
        if wrong:
            continue
        parts = [np.asarray(table[name]) for name in names]
        if joint.kind == "boundary":
            inner = [
                name
                for name, part in zip(names, parts, strict=True)
                if not outer.issuperset(part.tolist())
            ]
            problems += [
                f"{where}: {name!r} runs inside a body; a joint must be on its border"
                for name in inner
            ]
        if len(parts) == 2:
            of = [part if joint.kind == "region" else plate.mesh.f2t[0, part] for part in parts]
            both = np.intersect1d(plate.body[of[0]], plate.body[of[1]])
            if both.size:
                problems.append(
                    f"{where}: {joint.name!r} and {joint.against!r} belong to the same body; "
                    "a joint needs two bodies that do not share nodes"
                )
        others = sorted({taken[joint.kind][i] for i in parts[0].tolist() if i in taken[joint.kind]})
        if others:
            problems.append(f"{where} overlaps joint {', '.join(map(repr, others))}")
        taken[joint.kind].update(dict.fromkeys(parts[0].tolist(), joint.name))
    return problems


def _loose_bodies(structure: PlateStructure) -> list[str]:
    """Bodies left with a rigid motion by supports, closed contact and friction, in words."""
    bodies = int(structure.plate.body.max()) + 1
    position = structure.nodes - structure.nodes.mean(axis=0)
    position /= np.abs(position).max()
    motions = np.zeros((structure.n_nodes, 2, 3 * bodies))
    node, first = np.arange(structure.n_nodes), 3 * structure.body
    motions[node, 0, first] = 1.0
    motions[node, 1, first + 1] = 1.0
    motions[node, 0, first + 2] = -position[:, 1]
    motions[node, 1, first + 2] = position[:, 0]
    rows = [motions[structure.held]]
    for patch in structure.patches:
        relative = np.moveaxis(patch.relative(np.moveaxis(motions, 2, 0)), 0, -1)
        if patch.joint.kind == "boundary":
            tangent = patch.directions[:, 0]
            normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
            rows.append(np.einsum("kc,kcm->km", normal, relative))
        if patch.joint.friction > 0.0:
            held = np.einsum("kdc,kcm->kdm", patch.directions, relative)
            rows.append(held.reshape(-1, 3 * bodies))
    gram = sum(row.T @ row for row in rows)
    squares, vectors = np.linalg.eigh(gram / structure.n_nodes)
    loose = np.abs(vectors[:, squares < SMALL**2 + 1e-13 * squares.max(initial=0.0)])
    moving = loose.reshape(bodies, -1).max(axis=1, initial=0.0) > 1e-6
    return [
        f"{_body_label(structure.plate, body)} is left unsupported: it can move or turn freely; "
        "hold it by a support, or by a joint with friction on a body that is held"
        for body in np.flatnonzero(moving).tolist()
    ]


def _body_label(plate: PlateMesh, body: int) -> str:
    """A body in words, after its regions if it has any."""
    own = [
        repr(name)
        for name, elements in sorted(plate.regions.items())
        if len(elements) and np.all(plate.body[elements] == body)
    ]
    if own:
        return f"the body with the region{'s' if len(own) > 1 else ''} {', '.join(own)}"
    if plate.body.max() == 0:
        return "the plate"
    x, y = plate.mesh.p[:, plate.mesh.t[:, plate.body == body]].mean(axis=(1, 2))
    return f"the body around ({x:.6g}, {y:.6g})"


def full_matrices(structure: PlateStructure) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Mass and stiffness of all nodes before supports and contact, (2N, 2N) each, kg and N/m."""
    from skfem import Basis, ElementQuad0, ElementTriP0, ElementVector, asm

    mesh = structure.plate.mesh
    basis = Basis(mesh, ElementVector(structure.element), intorder=structure.quadrature)
    constant = basis.with_element(ElementTriP0() if mesh.t.shape[0] == 3 else ElementQuad0())
    nu = structure.poisson
    shear = structure.E / (2.0 * (1.0 + nu))
    # Plane strain has Lamé's first constant, plane stress that of no stress across.
    share = 1.0 - nu if structure.plane == "stress" else 1.0 - 2.0 * nu
    first = 2.0 * shear * nu / share
    K = asm(
        plate_stiffness(),
        basis,
        first=constant.interpolate(first * structure.thickness),
        second=constant.interpolate(shear * structure.thickness),
    )
    mass = structure.density * structure.thickness
    M = asm(plate_mass(), basis, mass_per_area=constant.interpolate(mass))
    return _symmetric(M), _symmetric(K)


def _symmetric(A: Any) -> sparse.csr_array:
    symmetric = sparse.csr_array(0.5 * (A + A.T))
    symmetric.eliminate_zeros()
    return symmetric


def assemble_plate(
    structure: PlateStructure,
    loads: Sequence[tuple[str, Sequence[float], Load]] = (),
    points: Sequence[str] | None = None,
) -> System:
    """Assemble the system of jointed plates.

    Parameters
    ----------
    structure : PlateStructure
    loads : sequence of (name, direction, load)
        Total force spread evenly over a boundary (per length) or region (per area), or at a point,
        along ``direction`` (2,), whose length does not count.
    points : sequence of str, optional
        Points, boundaries or regions to observe, the latter two by their mean; all points that
        can move if not given.

    Returns
    -------
    System
        Sparse; every row of ``B`` picks one unknown. Rows of ``P``: one named as each load, the
        displacement the load works on (a second load of the same name gets ".2" and so on), then
        "name.x" and "name.y" for what is observed.

    Raises
    ------
    InputError
        For unknown names, directions without length, and loads on what cannot move.
    """
    problems = [
        problem
        for name, where in [(on, "load") for on, _, _ in loads]
        + [(name, "points") for name in points or ()]
        if (problem := _wrong_name(structure.plate, name, _KINDS, where))
    ]
    for on, direction, _ in loads:
        vector = np.asarray(direction, dtype=float)
        if vector.shape != (2,) or not np.all(np.isfinite(vector)) or not np.any(vector):
            problems.append(
                f"load on {on!r}: direction: found {direction}, must be two finite numbers, not "
                "both zero"
            )
    if problems:
        raise InputError(problems)

    T = structure.T
    applied: list[AppliedLoad] = []
    rows: list[FloatArray] = []
    names: list[str] = []
    for on, direction, load in loads:
        unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
        vector = T.T @ np.outer(_even_shares(structure, on), unit).ravel()
        if not np.any(vector):
            problems.append(
                f"load on {on!r}: a support holds it along {tuple(direction)}, a force there does "
                "nothing; load a free part"
            )
        earlier = sum(other == on for other, _, _ in loads[: len(applied)])
        name = on if earlier == 0 else f"{on}.{earlier + 1}"
        applied.append(AppliedLoad(vector, load, name))
        rows.append(vector)
        names.append(name)
    observed = points
    if observed is None:
        observed = [
            name for name, node in structure.plate.points.items() if T[[2 * node, 2 * node + 1]].nnz
        ]
    for name in dict.fromkeys(observed):
        shares = _even_shares(structure, name)
        both = [T.T @ np.outer(shares, unit).ravel() for unit in np.eye(2)]
        if not np.any(both):
            problems.append(f"points: {name!r} is supported and does not move")
        rows += both
        names += [f"{name}.x", f"{name}.y"]
    if problems:
        raise InputError(problems)

    M, K = (_symmetric(T.T @ A @ T) for A in full_matrices(structure))
    C = _symmetric(structure.stiffness_damping * K + structure.mass_damping * M)
    w, beta, directions, picked = _friction(structure)
    return System(
        M=M,
        C=C,
        K=K,
        B=selection(picked, T.shape[1]),
        w=w,
        beta=beta,
        loads=tuple(applied),
        P=sparse.csr_array(np.reshape(rows, (len(rows), T.shape[1]))),
        points=tuple(names),
        directions=directions,
    )


def _friction(
    structure: PlateStructure,
) -> tuple[FloatArray, FloatArray, NDArray[np.int64], IntArray]:
    """Limit (m,), beta (m,) and directions (m,) of the contact points, unknowns (rows,) of B."""
    m = max((int(patch.points.max(initial=-1)) for patch in structure.patches), default=-1) + 1
    w, beta = np.zeros(m), np.ones(m)
    node = np.zeros(m, dtype=np.intp)
    for patch in structure.patches:
        w[patch.points] += patch.joint.friction * patch.normal_force
        beta[patch.points] = patch.joint.beta
        node[patch.points] = patch.nodes
    count = np.diff(structure.first_unknown)[node].astype(np.int64)
    point, which = np.nonzero(np.arange(2) < count[:, None])
    return w, beta, count, structure.first_unknown[node[point]] + which


def _even_shares(structure: PlateStructure, name: str) -> FloatArray:
    """Share (N,) of each node in a unit spread evenly over a boundary, a region or a point."""
    plate = structure.plate
    if name in plate.points:
        shares = np.zeros(structure.n_nodes)
        shares[plate.points[name]] = 1.0
        return shares
    if name in plate.regions:
        part = structure.basis.with_elements(plate.regions[name])
    else:
        from skfem import FacetBasis

        part = FacetBasis(
            plate.mesh,
            structure.element,
            facets=plate.boundaries[name],
            intorder=structure.quadrature,
        )
    shares = np.asarray(unit_load().assemble(part))
    # Shape functions of other nodes, and some of the second order, give round-off.
    shares[np.abs(shares) < 1e-12 * np.abs(shares).max()] = 0.0
    return np.asarray(shares / shares.sum())
