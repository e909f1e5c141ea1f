"""Energies that a cycle loses, and the loss factor that follows from them.

The loss factor of a cycle is the energy lost in it over 2 pi times its largest strain energy,

    eta = (friction + viscous + impacts) / (2 pi U),

whatever the vibration or slow motion is that it is a cycle of. Half of it is the damping ratio of a
linear system with viscous damping that would lose the same share of its strain energy at its
natural frequency, and its reciprocal is the quality factor Q. A linear oscillator of the damping
ratio zeta and the natural frequency omega_0 that vibrates with omega has eta = 2 zeta omega /
omega_0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.plain_values import Tabular, spread
from skfem_joint.ground.values import check_kind
from skfem_joint.runs.last_cycle import beyond_round_off
from skfem_joint.stepping.recording import Run

#: Columns of tables and keys of summaries, and the attributes of `Losses` that they show.
COLUMNS = {
    "loss_factor": "loss_factor",
    "equivalent_viscous_ratio": "viscous_ratio",
    "quality_factor": "quality",
    "loss_factor_by_friction": "by_friction",
    "loss_factor_by_damping": "by_damping",
    "lost_by_friction_J": "friction",
    "lost_by_damping_J": "viscous",
    "lost_by_impacts_J": "impacts",
    "largest_strain_energy_J": "strain",
}


@dataclass(frozen=True)
class Losses(Tabular):
    """Energies of a cycle, or of many: the arrays have one shape, () or that of the cycles.

    Attributes
    ----------
    friction : ndarray
        Lost by friction in a cycle, J.
    viscous : ndarray
        Lost by the damping matrix, J.
    strain : ndarray
        Largest strain energy in the cycle, J, that of springs in series with friction included.
        That of contact that opens is zero at rest.
    by_joint : ndarray, shape (..., joints)
        Lost by friction in each joint, J.
    impacts : ndarray or None
        Lost by impacts, J; None where contact does not open, and where it is not known.
    """

    friction: FloatArray
    viscous: FloatArray
    strain: FloatArray
    by_joint: FloatArray
    impacts: FloatArray | None = None

    @property
    def lost(self) -> FloatArray:
        """Energy lost in a cycle, J."""
        impacts = 0.0 if self.impacts is None else self.impacts
        return np.asarray(self.friction + self.viscous + impacts)

    @property
    def loss_factor(self) -> FloatArray:
        """Energy lost over 2 pi times the largest strain energy; nan where there is none."""
        return over(self.lost, 2.0 * np.pi * self.strain)

    @property
    def by_friction(self) -> FloatArray:
        """Part of friction in the loss factor."""
        return over(self.friction, 2.0 * np.pi * self.strain)

    @property
    def by_damping(self) -> FloatArray:
        """Part of the damping matrix in the loss factor."""
        return over(self.viscous, 2.0 * np.pi * self.strain)

    @property
    def viscous_ratio(self) -> FloatArray:
        """Equivalent viscous damping ratio, half of the loss factor."""
        return 0.5 * self.loss_factor

    @property
    def quality(self) -> FloatArray:
        """Quality factor Q, one over the loss factor; nan where nothing is lost."""
        return over(np.ones_like(self.strain), self.loss_factor)

    @property
    def joint_shares(self) -> FloatArray:
        """Share of each joint in what friction takes, (..., joints); nan where it takes nothing."""
        return over(self.by_joint, np.expand_dims(self.friction, -1))

    def at(self, *cycle: int) -> Losses:
        """Those of one cycle."""

        def of(x: Any) -> Any:
            return None if x is None else np.asarray(x[cycle])

        return Losses(**{name: of(x) for name, x in vars(self).items()})

    def columns(self) -> dict[str, FloatArray]:
        """Values by the names of `COLUMNS`; impacts only where they are known."""
        values = {column: getattr(self, name) for column, name in COLUMNS.items()}
        return {column: value for column, value in values.items() if value is not None}

    @property
    def table(self) -> dict[str, FloatArray]:
        """Columns by the names of `COLUMNS`, with a row for each cycle, and loss by joint, J."""
        by_joint = spread("lost_in_joint_{}_J", np.atleast_2d(self.by_joint))
        return {name: np.ravel(values) for name, values in self.columns().items()} | by_joint

    def row(self, *cycle: int) -> dict[str, float]:
        """The same of one cycle, as numbers."""
        return {column: float(value[cycle]) for column, value in self.columns().items()}


def stacked(every: Sequence[Losses | None]) -> Losses:
    """Losses of many cycles, (cycles,), from those of each; nan where there are none."""
    some = [one for one in every if one is not None]
    joints = some[0].by_joint.size if some else 0
    nothing = np.array(np.nan)
    unknown = Losses(nothing, nothing, nothing, np.full(joints, np.nan), nothing)
    cycles = [one or unknown for one in every]
    whole = {
        name: np.array([getattr(one, name) for one in cycles], dtype=float)
        for name in vars(unknown)
        if name != "impacts" or any(one.impacts is not None for one in some)
    }
    return Losses(**whole)


def known(row: Mapping[str, float]) -> dict[str, float | None]:
    """Row of numbers for a summary: None in place of nan, as of a cycle that strains nothing."""
    return {name: value if np.isfinite(value) else None for name, value in row.items()}


def over(part: FloatArray, whole: FloatArray) -> FloatArray:
    """Parts over wholes of a shape that fits; nan where the whole is zero or not known."""
    part, whole = np.broadcast_arrays(part, whole)
    unknown = np.full(part.shape, np.nan)
    return np.asarray(np.divide(part, whole, out=unknown, where=np.abs(whole) > 0.0))


def losses(run: Run) -> Losses:
    """Energies that the last cycle of a run loses, and its loss factor.

    What the integration scheme itself dissipates is no part of them. Energies that are round-off
    are zero.

    Parameters
    ----------
    run : Run
        Over cycles, until "steady", or quasi-static. A cycle that is not steady yet has a loss
        factor, too, which depends on where the run began.

    Returns
    -------
    Losses
        Of a single cycle: its arrays have the shape ().

    Raises
    ------
    InputError
        If the run has no complete cycle, as one of a pulse.
    """
    check_kind("run", run, Run)
    cycles = run.cycles
    if not cycles.friction.size:
        raise InputError(
            "losses: the run has no complete cycle, over which a loss factor is defined; integrate "
            "with cycles or cycle_steps, or see its ring-down, sj.ring_down"
        )
    opens = run.system.contact.opens
    return Losses(
        friction=beyond_round_off(run, cycles.friction[-1]),
        viscous=beyond_round_off(run, cycles.viscous[-1]),
        strain=np.asarray(cycles.strain[-1]),
        by_joint=beyond_round_off(run, cycles.by_joint[-1]),
        impacts=beyond_round_off(run, cycles.impact[-1]) if opens else None,
    )
