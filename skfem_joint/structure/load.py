"""Loads on a structure, and the vectors of all nodes that they make."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.arrays import FloatArray, Matrix
from skfem_joint.loads import as_amplitude
from skfem_joint.structure.patch import shares_of
from skfem_joint.system import AppliedLoad, System
from skfem_joint.unknowns import stacked

if TYPE_CHECKING:
    from skfem_joint.structure import AnyStructure
    from skfem_joint.structure.structure import Structure


@dataclass(frozen=True)
class Load:
    """A force on a named point, boundary or region, spread evenly over it; or a moving base.

    ``amplitude`` is the whole force (N) as a function of time (s): one of :mod:`skfem_joint.loads`,
    or a plain function. The length of ``direction`` does not count; bars do without. With ``base``
    ("x", "y" or "z") in place of ``on`` it is the acceleration (m/s2) of all supports and rigid
    bases together along that axis of the mesh; displacements are then relative to them, and damping
    acts on their rates.

    On a boundary ``quantity`` may also be "traction", a force along ``direction`` by area (N/m2),
    or "pressure" (N/m2), which acts against the outward normal and has no direction.
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
        """What it is called in messages."""
        return f"load with base = {self.base!r}" if self.on is None else f"load on {self.on!r}"

    def unit(self, dim: int) -> FloatArray:
        """Unit vector along it, (dim,)."""
        if self.base is not None:
            return np.asarray(np.eye(dim)["xyz".index(self.base)])
        direction = np.ravel((1.0,) if self.direction is None else self.direction)
        return np.asarray(direction / np.linalg.norm(direction))


def loaded(
    structure: AnyStructure,
    loads: Sequence[AppliedLoad],
    rows: Mapping[str, FloatArray],
    notes: Iterable[str] = (),
) -> System:
    """System of a structure under loads, with the named ``rows`` (n,) of its unknowns observed."""
    base, ratio = structure.unloaded, structure.damping_ratio
    system = replace(
        base,
        loads=tuple(loads),
        P=stacked([row[np.newaxis] for row in rows.values()], base.n),
        points=tuple(rows),
        J=shares_of(structure.patches, base.w),
        joints=tuple(joint.name for joint in structure.joints),
        notes=tuple(dict.fromkeys(notes)),
    )
    return system if ratio is None else system.with_damping_ratio(ratio)


def acting(structure: Structure, load: Load, M: Matrix) -> tuple[FloatArray, float, list[str]]:
    """Unit load on all nodes, (dim N,), what it is multiplied by, and what is said of it."""
    on = load.on or f"mass_{load.base}"
    if load.on is None:
        inertia = M @ np.tile(load.unit(structure.dim), structure.n_nodes)
        mass = float(inertia.sum())
        note = (
            f"The base is accelerated along {load.base}: displacements are relative to it, "
            f"and the load on {on} is the inertia force of all {mass:.6g} kg."
        )
        return inertia / mass, -mass, [note]
    if load.quantity == "force":
        return np.outer(structure.even_shares(on), load.unit(structure.dim)).ravel(), 1.0, []
    mean, area = _spread(structure, load)
    note = (
        f"The {load.quantity} on {on} acts on {area:.6g} m2: what is told of this load "
        f"is its force on all of it, in N, and the mean displacement it works on."
    )
    return mean.ravel(), area, [note]


def _spread(structure: Structure, load: Load) -> tuple[FloatArray, float]:
    """Means over a boundary of what a traction or pressure works on, (N, dim), and area, m2."""
    part = structure.facet_basis(structure.mesh.boundaries[str(load.on)])
    by_area = np.broadcast_to(structure.across[part.tind, np.newaxis], part.dx.shape)
    area = float(np.sum(by_area * part.dx))
    if load.quantity == "pressure":
        along = -np.asarray(part.normals)
    else:
        along = load.unit(structure.dim)[:, np.newaxis, np.newaxis]
    return structure.integrals(part, along * by_area / area), area
