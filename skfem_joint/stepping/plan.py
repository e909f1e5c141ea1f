"""The plan of a run: its time steps, its scheme, what it stores, and when it ends."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from skfem_joint.ground.errors import InputError
from skfem_joint.ground.values import COUNT, POSITIVE, between, check, check_kind, check_some
from skfem_joint.stepping.recording import Save
from skfem_joint.stepping.schemes import Scheme, generalized_alpha
from skfem_joint.stepping.warp import warp_factor


def check_until(until: str) -> None:
    """Raise InputError for an end that no plan has."""
    if until not in ("end", "steady"):
        raise InputError(f"until: found {until!r}, must be 'end' or 'steady'")


@dataclass(frozen=True)
class Plan:
    """Equal time steps of a run, how each is made, and what is stored.

    A plan belongs to no system: the same one serves full, condensed and reduced models. Changes
    return copies.

    Attributes
    ----------
    step : float
        Time step, s.
    n_steps : int
        Number of steps.
    scheme : Scheme
        Integration scheme; average acceleration by default.
    save : Save
        What to store; the named points at every step by default.
    cycle_steps : int, optional
        Steps of one cycle, for works and peaks by cycle; None where loads do not repeat.
    until : {"end", "steady"}
        Whether the run ends after ``n_steps``, or gives the period (of ``n_steps``) at which
        vibration has become steady.
    exact_at : float, optional
        Frequency, Hz, at which steps of the trapezoidal rule are exact for linear vibration, see
        :mod:`skfem_joint.stepping.warp`.
    quasi_static : bool
        Whether inertia and damping are left out: each step is then a level of the loads, see
        :mod:`skfem_joint.runs.slow_run`.
    gross_periods : int, optional
        Periods in turn in which a joint slips as a whole after which the search for steady
        vibration is given up; five times as many where it has Newton's method or contact opens. As
        many as any other search takes if not given.
    """

    step: float
    n_steps: int
    scheme: Scheme = field(default_factory=generalized_alpha)
    save: Save = field(default_factory=Save)
    cycle_steps: int | None = None
    until: Literal["end", "steady"] = "end"
    exact_at: float | None = None
    quasi_static: bool = False
    gross_periods: int | None = None

    def __post_init__(self) -> None:
        check("step", self.step, POSITIVE)
        check("n_steps", self.n_steps, COUNT)
        if self.n_steps > 2**53:  # where numbers of steps are no longer exact as floats
            raise InputError(f"n_steps: found {self.n_steps:.3g}, must be at most 2^53")
        if not isinstance(self.scheme, Scheme):
            raise InputError(
                f"scheme: found {self.scheme!r}, must be a Scheme, such as "
                "sj.generalized_alpha(0.9)"
            )
        check_kind("save", self.save, Save)
        check_some(COUNT, cycle_steps=self.cycle_steps)
        check_until(self.until)
        if self.quasi_static and self.until != "end":
            raise InputError(
                "until: a quasi-static run has no vibration that could become 'steady'; give cycles"
            )
        if self.exact_at is not None:
            check("exact_at", self.exact_at, between(0.0, 0.5 / self.step))
            if not self.scheme.coefficients(1.0).trapezoidal:
                raise InputError("exact_at: needs the trapezoidal rule, rho_infinity = 1")

    @property
    def warp(self) -> float:
        """Factor of the velocity by which the steps are exact at a frequency, 1 for none."""
        return warp_factor(2.0 * math.pi * (self.exact_at or 0.0), self.step)

    @property
    def duration(self) -> float:
        """Duration of the run, or of the steady period, s."""
        return self.step * self.n_steps

    def finer(self, factor: float) -> Plan:
        """Plan of the same duration with ``factor`` times as many steps.

        What is stored every so many steps is stored at the same times. A factor of 1/2 gives steps
        of twice the length; numbers of steps that it does not divide are rounded down.
        """
        every, fields_every = self.save.strides
        rows = max(1, int(every * factor)), max(1, int(fields_every * factor))
        return replace(
            self,
            step=self.step / factor,
            n_steps=int(self.n_steps * factor),
            save=replace(self.save, every=rows[0], fields_every=rows[1]),
            cycle_steps=None if self.cycle_steps is None else int(self.cycle_steps * factor),
        )

    def first(self, cycles: int) -> Plan:
        """Plan of the first ``cycles``, or of as many steps where there are no cycles.

        At least one of them, and no more than the plan has.
        """
        steps = max(1, cycles) * (self.cycle_steps or 1)
        return replace(self, n_steps=min(self.n_steps, steps))

    def storing(self, *, fields_every: int = 0) -> Plan:
        """Plan that stores the named points, and the fields every so many steps; 0: no fields."""
        save = Save(self.save.every, fields_every > 0, fields_every=max(1, fields_every))
        return replace(self, save=save)
