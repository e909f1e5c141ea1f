"""Estimated errors of results, by the source of error, and the runs that show them.

How they are found says :mod:`skfem_joint.accuracy.ladder`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.plain_values import Tabular
from skfem_joint.results.history import QUANTITIES
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system.system import System

#: Sources of error, as a summary names them. The distance from Coulomb's law is in no total, see
#: `skfem_joint.accuracy.against_coulomb`.
SOURCES = ("basis", "law", "points", "mesh", "time_step", "full_run", "total", "coulomb")
#: What a total is called that leaves the mesh out.
WITHOUT_MESH = "total without mesh"
#: What a table calls those whose names say too little.
NAMES = {"coulomb": "against Coulomb's law"}

#: Relative errors by quantity; None: not known, or zero in the result.
Parts = dict[str, float | None]

#: Error of each joint's friction energy, over that of all joints and over its own.
ByJoint = Mapping[str, tuple[float | None, float | None]]


@dataclass(frozen=True)
class MissingModes:
    """Modes that the basis of a reduced model misses.

    Attributes
    ----------
    V : ndarray, shape (n, j)
        The basis with the modes that it misses.
    velocities : ndarray, shape (times, j)
        Velocities of the coordinates in a run with that basis.
    slips : bool
        Whether the first of them is slip, and not motion out of contact.
    """

    V: FloatArray
    velocities: FloatArray
    slips: bool


@dataclass(frozen=True, repr=False)
class Estimate(Tabular):
    """Estimated relative errors of one model's results.

    Attributes
    ----------
    parts : mapping
        Errors by source (see `SOURCES`) and by quantity; a source that is not there is not
        estimated.
    missing : MissingModes, optional
        Modes that a reduced model misses.
    unmeasured : mapping, optional
        Total as it was estimated before the full model's run was known, where it is.
    by_joint : mapping
        Error of the friction energy of each joint, by its name: relative to the friction energy of
        all joints, and to the joint's own. None where that is zero; empty where not estimated.
    """

    parts: Mapping[str, Parts]
    missing: MissingModes | None = field(default=None, repr=False)
    unmeasured: Parts | None = field(default=None, repr=False)
    by_joint: ByJoint = field(default_factory=dict)

    def beside(self, full_run: Parts, by_joint: ByJoint | None = None) -> Estimate:
        """Copy with the distances from a run of the full model; no total is less than they are.

        A total that is not known is then that distance, without the full model's own error.
        ``by_joint`` has the distances of the joints' friction energies.
        """
        stated, joints = self.parts.get("total", {}), dict(self.by_joint)
        total = {name: _larger(stated.get(name), full_run.get(name)) for name in QUANTITIES}
        parts = {**self.parts, "full_run": full_run, "total": total}
        for name, (share, own) in (by_joint or {}).items():
            known = joints.get(name, (None, None))
            joints[name] = _larger(share, known[0]), _larger(own, known[1])
        return replace(self, parts=parts, unmeasured=dict(stated), by_joint=joints)

    def with_mesh(self, errors: Parts) -> Estimate:
        """Copy with the errors by the mesh, which its total then has too."""
        total = {
            name: None if error is None else error + (errors[name] or 0.0)
            for name, error in self.parts.get("total", {}).items()
        }
        return self.having("mesh", errors).having("total", total)

    def having(self, source: str, errors: Parts) -> Estimate:
        """Copy with the errors from a source."""
        return replace(self, parts={**self.parts, source: errors})

    @property
    def table(self) -> dict[str, Any]:
        """Columns with a row for each source: relative errors, nan where they are not known."""
        quantities = {
            name: np.array([self.of(source, name) for source in self.parts], dtype=float)
            for name in QUANTITIES
        }
        return {"source": [*self.parts], **quantities}

    @property
    def on_its_mesh(self) -> Parts:
        """Total against the exact solution on the same mesh."""
        mesh = self.parts.get("mesh", {})
        return {
            name: None if error is None else error - (mesh.get(name) or 0.0)
            for name, error in self.parts.get("total", {}).items()
        }

    @property
    def lacks_mesh(self) -> bool:
        """Whether the total leaves out what the size and order of the elements do."""
        return all(error is None for error in self.parts.get("mesh", {}).values())

    def __repr__(self) -> str:
        lines = ["Estimate of relative errors:"]
        for source, errors in self.parts.items():
            known = {name: e for name, e in errors.items() if e is not None}
            shown = ", ".join(f"{name} {100.0 * e:.2g} %" for name, e in known.items())
            label = WITHOUT_MESH if source == "total" and self.lacks_mesh else source
            lines.append(f"  {label.replace('_', ' ')}: {shown or 'not known'}")
        return "\n".join(lines)

    @property
    def worst_joint(self) -> str | None:
        """Joint whose friction energy errs most in relation to its own; None if not known."""
        known = {name: own for name, (_, own) in self.by_joint.items() if own is not None}
        return max(known, key=lambda name: known[name], default=None)

    def of(self, source: str, quantity: str) -> float | None:
        """Error of a quantity from a source; None where it is not known."""
        return self.parts.get(source, {}).get(quantity)


def _larger(*errors: float | None) -> float | None:
    """The largest of some errors that may be unknown."""
    return max((e for e in errors if e is not None), default=None)


def sizes(errors: Parts) -> FloatArray:
    """Errors in the order of `QUANTITIES`, nan where they are not known."""
    return np.array([errors[name] for name in QUANTITIES], dtype=float)


def named(errors: FloatArray) -> Parts:
    """Errors by the names of quantities, from those in the order of `QUANTITIES`; None for nan."""
    known = [None if np.isnan(error) else error for error in errors.tolist()]
    return dict(zip(QUANTITIES, known, strict=True))


def added(*parts: Parts) -> Parts:
    """Sum of errors by quantity; None where one of them is not known."""
    return named(np.sum([sizes(errors) for errors in parts], axis=0))


def verification_run(system: System, plan: Plan, *, fields_every: int = 0, **others: Any) -> Run:
    """Run a system to estimate errors: it stores its named points, and fields every so many steps.

    ``others`` are those of `integrate_plan`, as where a search for steady vibration starts. An
    interrupt is raised as KeyboardInterrupt: half a run is of no use.
    """
    return integrate_plan(system, plan.storing(fields_every=fields_every), **others).finished()
