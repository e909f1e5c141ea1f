"""Loads on a structure, and their nodal force vectors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from skfem_joint.body.body import Body
from skfem_joint.body.checks import KINDS, one_of, wrong_name
from skfem_joint.ground.arrays import FloatArray, Matrix
from skfem_joint.ground.loads import as_amplitude
from skfem_joint.ground.values import FINITE
from skfem_joint.joint.patch import Patch, shares_of
from skfem_joint.mesh import NamedMesh
from skfem_joint.system.modes import RayleighFit, rayleigh_fit
from skfem_joint.system.system import AppliedLoad, System
from skfem_joint.system.unknowns import stacked


@dataclass(frozen=True)
class Load:
    """A force on a named point, boundary or region, spread evenly over it; or a moving base.

    Attributes
    ----------
    on : str, optional
        Point, boundary or region.
    amplitude : Amplitude or callable
        Whole force (N) as a function of time (s): a shape of :mod:`skfem_joint.ground.loads`, or a
        plain function.
    direction : tuple of float, optional
        Direction of the force; its length does not count. Bars do not need it.
    base : {"x", "y", "z"}, optional
        In place of ``on``: axis of the mesh along which all supports and rigid bases are
        accelerated together. The amplitude is then an acceleration (m/s2), displacements are
        relative to the base, and damping acts on their rates.
    quantity : {"force", "traction", "pressure"}
        On a boundary the amplitude may also be a traction along ``direction`` (N/m2), or a
        pressure against the outward normal (N/m2), which has no direction.
    """

    on: str | None = None
    amplitude: Any = None
    direction: tuple[float, ...] | None = None
    base: str | None = None
    quantity: str = "force"

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitude", as_amplitude(self.amplitude))

    @property
    def label(self) -> str:
        """The load in a message."""
        return f"load with base = {self.base!r}" if self.on is None else f"load on {self.on!r}"

    def unit(self, dim: int) -> FloatArray:
        """Unit vector along the force or the base's acceleration, (dim,)."""
        if self.base is not None:
            return np.asarray(np.eye(dim)["xyz".index(self.base)])
        direction = np.ravel((1.0,) if self.direction is None else self.direction)
        return np.asarray(direction / np.linalg.norm(direction))


def under_loads(
    unloaded: System,
    patches: Sequence[Patch],
    loads: Sequence[AppliedLoad],
    rows: Mapping[str, FloatArray],
    damping_ratio: float | None = None,
    notes: Iterable[str] = (),
    fitted: Callable[..., RayleighFit] = rayleigh_fit,
) -> System:
    """System of a structure under loads, with named displacements and joints.

    Parameters
    ----------
    unloaded : System
    patches : sequence of Patch
        Contact points of each joint.
    loads : sequence of AppliedLoad
    rows : mapping of str to ndarray, shape (n,)
        Observed displacements by name, as rows on the unknowns.
    damping_ratio : float, optional
        See `System.with_damping_ratio`.
    notes : iterable of str
        Sentences about the loads.
    fitted : callable
        As for `System.with_damping_ratio`.
    """
    joints = tuple(patch.joint.name for patch in patches)
    contact = replace(unloaded.contact, J=shares_of(patches, unloaded.contact.w), joints=joints)
    system = replace(
        unloaded,
        contact=contact,
        loads=tuple(loads),
        P=stacked([row[np.newaxis] for row in rows.values()], unloaded.n),
        points=tuple(rows),
        notes=tuple(dict.fromkeys(notes)),
    )
    return system if damping_ratio is None else system.with_damping_ratio(damping_ratio, fitted)


def acting(body: Body, load: Load, M: Matrix) -> tuple[FloatArray, float, list[str]]:
    """Load vector of a unit amplitude, the factor of the amplitude, and notes for users.

    The vector, shape (dim N,), times the factor times the load's amplitude is the force of all
    nodes, N. ``M`` is the mass of all nodes.
    """
    on = load.on or f"mass_{load.base}"
    if load.on is None:
        inertia = M @ np.tile(load.unit(body.dim), body.n_nodes)
        mass = float(inertia.sum())
        note = (
            f"The base is accelerated along {load.base}: displacements are relative to it, "
            f"and the load on {on} is the inertia force of all {mass:.6g} kg."
        )
        return inertia / mass, -mass, [note]
    if load.quantity == "force":
        return np.outer(body.even_shares(on), load.unit(body.dim)).ravel(), 1.0, []
    mean, area = _spread(body, load)
    note = (
        f"The {load.quantity} on {on} acts on {area:.6g} m2: results report its force on all of "
        "it, in N, and the mean displacement it works on."
    )
    return mean.ravel(), area, [note]


def _spread(body: Body, load: Load) -> tuple[FloatArray, float]:
    """Nodal shares (N, dim) of a traction or pressure on a boundary, and the boundary's area, m2.

    The shares times the area times the pressure are the forces of the nodes, N. As rows they give
    the mean displacement over the boundary along the traction, or against the normal.
    """
    part = body.facet_basis(body.mesh.boundaries[str(load.on)])
    by_area = np.broadcast_to(body.across[part.tind, np.newaxis], part.dx.shape)
    area = float(np.sum(by_area * part.dx))
    if load.quantity == "pressure":
        along = -np.asarray(part.normals)
    else:
        along = load.unit(body.dim)[:, np.newaxis, np.newaxis]
    return body.integrals(part, along * by_area / area), area


def load_problems(
    mesh: NamedMesh, loads: Sequence[Load], points: Sequence[str] | None
) -> list[str]:
    """What is wrong with the places, directions and quantities of loads, and observed points."""
    dim = mesh.dim
    wrong = (p for on in points or () for p in wrong_name(mesh, on, KINDS, "points"))
    problems = [*islice(wrong, 20)]  # a script may give thousands of names
    for load in loads:
        problems += one_of(
            f"{load.label}: quantity", load.quantity, ("force", "traction", "pressure")
        )
        if load.base is not None or load.on is None:
            problems += _base_problems(load, dim)
            continue
        by_area = load.quantity != "force"
        where = f"{load.label}: quantity = {load.quantity!r}" if by_area else load.label
        problems += wrong_name(mesh, load.on, ("boundary",) if by_area else KINDS, where)
        if load.quantity == "pressure":
            problems += _pressure_problems(mesh, load)
        else:
            problems += _direction_problems(load, dim)
    return problems


def _direction_problems(load: Load, dim: int) -> Iterator[str]:
    """What is wrong with the direction of a force or traction."""
    if load.direction is None:
        if dim > 1:
            yield (
                f"{load.label}: direction: missing, must be given as {dim} numbers, "
                f"e.g. {[1.0, *[0.0] * (dim - 1)]}"
            )
        return
    vector = np.ravel(load.direction)
    if not (vector.shape == (dim,) and all(x in FINITE for x in vector) and np.any(vector)):
        yield (
            f"{load.label}: direction: found {vector.tolist()}, must be {dim} "
            "finite numbers, not all zero"
        )


def _pressure_problems(mesh: NamedMesh, load: Load) -> Iterator[str]:
    """What is wrong with a pressure as a load."""
    if load.direction is not None:
        yield (
            f"{load.label}: direction: found {list(load.direction)} beside quantity = 'pressure', "
            "which acts against the normal; leave it out, or choose quantity = 'traction'"
        )
    inside = np.setdiff1d(mesh.boundaries.get(str(load.on), ()), mesh.mesh.boundary_facets())
    if inside.size:
        yield f"{load.label}: it runs inside a body; a pressure must be on its border"


def _base_problems(load: Load, dim: int) -> Iterator[str]:
    """What is wrong with a load that has a base, or no place."""
    if (load.on is None) == (load.base is None):
        yield (
            f"{load.label}: found on = {load.on!r} and base = {load.base!r}, must be one of the "
            "two: the place of a force, or the axis along which the supports are accelerated"
        )
    elif load.direction is not None:
        yield f"{load.label}: direction: found {load.direction} beside base; leave it out"
    elif load.quantity != "force":
        yield f"{load.label}: quantity: found {load.quantity!r} beside base; leave it out"
    else:
        yield from one_of(f"{load.label}: base", str(load.base), "xyz"[:dim])
