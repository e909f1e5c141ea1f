"""`NonlinearMode`: frequency, damping and harmonics of a mode over its amplitude."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray, as_dense, slip_norms
from skfem_joint.ground.plain_values import Tabular, spread
from skfem_joint.harmonic.levels import Levels
from skfem_joint.harmonic.marched import Marched
from skfem_joint.harmonic.points import contact_of, notes_of_law, notes_of_restless, state_of
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.results.loss import Losses

#: Share of its limit by which the friction of a point that slides may be below, for round-off.
SLIDES = 1e-4
#: Force of soft springs over the friction limits beyond which a note says so.
SOFT_FORCE = 1e-3


@dataclass(frozen=True)
class NonlinearMode(Tabular):
    """A mode in steady motion at rising amplitudes, kept up by the force 2 zeta omega M du/dt.

    Names are those of `Backbone`, whose curves stand beside it. Both have the energy lost in a
    cycle over 2 pi omega^2 times the square of the modal amplitude as twice the damping ratio; here
    the square is the sum of those of all harmonics, each times the square of its number. Where the
    mode keeps its shape both are the same.

    Attributes
    ----------
    mode : int
        Number of the mode, from 1.
    shape : ndarray, shape (n,)
        Mode with the contact stuck, of unit modal mass, kg^(-1/2).
    stuck_frequency : float
        Hz.
    point : str
        Name of the point whose first harmonic is the given amplitude; empty where the system has
        none, and the modal amplitude is.
    amplitude : ndarray, shape (levels,)
        Modal amplitude, m kg^1/2: norm of the first harmonic by the mass.
    frequency : ndarray, shape (levels,)
        Hz.
    friction_damping, viscous_damping : ndarray, shape (levels,)
        Parts of the damping ratio by friction and by C.
    displaced : ndarray, shape (levels,)
        First harmonic of the modal displacement ``shape^T M u``, m kg^1/2, as a ring-down sees it.
    decrement : ndarray, shape (levels,)
        Damping ratio that a ring-down has there: its logarithmic decrement over 2 pi. It is what a
        cycle loses over 2 pi times the derivative of the energy at the turning points by the
        logarithm of ``displaced``, that of a curve through the levels. It is nan of a single level,
        where the energy does not rise, and where ``displaced`` does not.
    decrement_error : ndarray, shape (levels,)
        Estimated relative error of ``decrement`` by this derivative: twice how far that of a
        curve through every other level is from it, there or at a level beside; nan of fewer than
        three levels. Where slip begins between two levels it was half of the true one. That of
        ``damping_ratio`` comes on top.
    displacement : ndarray, shape (levels, points)
        First harmonic of the named points, m.
    harmonics : ndarray, shape (levels, nh, n)
        Coefficients of the displacement, m, in the order of ``series``.
    series : FourierSeries
        Harmonics and samples that were chosen.
    slip : ndarray, shape (levels, m)
        Of each contact point, m, half of peak to peak; that of springs in series included.
    state : tuple of str
        At each level "stick", "partial", or "gross", where all points of a joint slip at once.
    opened : ndarray, shape (levels,)
        Share of the pressure points pressed at rest that open.
    losses : Losses
        Energies that a cycle of each level loses, and its loss factor.
    friction_work : ndarray, shape (levels, m)
        Energy lost by friction in a cycle at each contact point, J.
    errors : dict of str to dict of str to ndarray, shape (levels,)
        Estimated relative errors of ``frequency`` and ``damping_ratio`` by source: "harmonics", of
        harmonics and samples, and "sticking", of the springs that stand for rigid sticking; nan
        where it is not known.
    marched : Marched or None
        Some levels judged by time steps.
    release : tuple of ndarray
        State of the highest level where its first harmonic turns round, as `integrate` takes it as
        ``initial``, from which a ring-down begins.
    notes : tuple of str
    traits : dict of str to float
        Of the system, see `skfem_joint.reduction.stuck.traits_of`.
    """

    mode: int
    shape: FloatArray
    stuck_frequency: float
    point: str
    amplitude: FloatArray
    frequency: FloatArray
    friction_damping: FloatArray
    viscous_damping: FloatArray
    displaced: FloatArray
    decrement: FloatArray
    decrement_error: FloatArray
    displacement: FloatArray
    harmonics: FloatArray
    series: FourierSeries
    slip: FloatArray
    state: tuple[str, ...]
    opened: FloatArray
    losses: Losses
    friction_work: FloatArray
    errors: Mapping[str, Mapping[str, FloatArray]]
    marched: Marched | None
    release: tuple[FloatArray, ...]
    notes: tuple[str, ...]
    traits: Mapping[str, float] = field(default_factory=dict)

    @property
    def damping_ratio(self) -> FloatArray:
        """Damping ratio of friction and viscous forces."""
        return self.friction_damping + self.viscous_damping

    @property
    def table(self) -> dict[str, Any]:
        """Columns with a row for each level, points by their numbers."""
        return {
            "modal_amplitude": self.amplitude,
            "frequency_Hz": self.frequency,
            "damping_ratio": self.damping_ratio,
            "frequency_error": self.error("frequency"),
            "damping_ratio_error": self.error("damping_ratio"),
            "decrement_ratio": self.decrement,
            "decrement_ratio_error": self.decrement_error,
            **spread("displacement_{}_m", self.displacement),
            "friction_damping_ratio": self.friction_damping,
            "viscous_damping_ratio": self.viscous_damping,
            "state": self.state,
            "opened_share": self.opened,
            **self.losses.table,
        }

    @property
    def estimated(self) -> dict[str, float]:
        """Estimated largest relative errors of ``frequency`` and ``damping_ratio``."""
        names = "frequency", "damping_ratio"
        return {name: float(self.error(name).max()) for name in names}

    def error(self, name: str) -> FloatArray:
        """Estimated relative error, (levels,), of "frequency" or "damping_ratio"."""
        return np.asarray(np.sum([of[name] for of in self.errors.values()], axis=0))

    def motion(self, level: int, samples: int = 100) -> FloatArray:
        """Displacement over a period at a level, (samples, n), m."""
        fine = FourierSeries(self.series.highest, samples, False)
        return np.asarray(fine.basis @ fine.of(self.harmonics[level], self.series))


def curve_of(
    levels: Levels,
    values: Mapping[str, FloatArray],
    errors: Mapping[str, Mapping[str, FloatArray]],
    marched: Marched | None,
) -> NonlinearMode:
    """Curve of levels.

    Parameters
    ----------
    levels : Levels
    values : dict of str to ndarray, shape (levels,)
        Their frequency, rad/s, and damping ratio.
    errors : dict
        See `NonlinearMode`.
    marched : Marched or None
    """
    equations, series = levels.equations, levels.series
    balance = equations.balance
    system, contact = balance.system, balance.system.contact
    rubs, M, C = contact.rubs, as_dense(system.M), as_dense(system.C)
    count, m = levels.omega.size, rubs.size
    P, points = as_dense(system.P), contact.joint_points
    work, slip = np.zeros((count, m)), np.zeros((count, m))
    viscous, strain, soft, opened, restless = np.zeros((5, count))
    state = []
    pressed = max(int(np.count_nonzero(contact.normal.force > 0.0)), 1)
    for k, (u, omega) in enumerate(zip(levels.u, levels.omega.tolist(), strict=True)):
        q = balance.inner(u)
        sampled = balance.contact.sampled(series, q, False)
        work[k], slip[k], strain[k] = contact_of(balance, q, sampled)
        slides, holds = np.zeros((2, m, len(series.basis)), np.bool_)
        size = slip_norms(sampled.friction.T, contact.directions[rubs]).T
        slides[rubs] = (size >= sampled.limits * (1.0 - SLIDES)) & (sampled.limits > 0.0)
        holds[rubs] = ~slides[rubs] & (sampled.limits > 0.0)
        gross = any((slides[j].any(axis=0) & ~holds[j].any(axis=0)).any() for j in points)
        state.append("gross" if gross else "partial" if slides.any() else "stick")
        opened[k] = np.count_nonzero(sampled.opened) / pressed
        rate = series.rate(u)
        viscous[k] = omega * series.work(rate @ C, u).sum()
        soft[k], restless[k] = balance.held_softly(q), sampled.restless
    first = levels.u[:, series.first : series.first + 2]
    lost = work.sum(axis=1) + viscous
    share = np.divide(viscous, lost, out=np.zeros(count), where=lost > 0.0)
    ratio = values["damping_ratio"]
    displaced = np.linalg.norm(first @ (M @ equations.shape), axis=1)
    rate = series.coefficient_orders[:, np.newaxis] * levels.u
    cycle = 2.0 * np.pi * values["frequency"] ** 2 * np.einsum("lhn,nm,lhm->l", rate, M, rate)
    decrement, error = _decrement(displaced, ratio * cycle, strain)
    notes = [*_notes(levels, values, float(soft.max())), *notes_of_restless(restless.max())]
    return NonlinearMode(
        mode=equations.number,
        shape=equations.shape,
        stuck_frequency=balance.reference / (2.0 * np.pi),
        point="" if equations.point is None else system.points[equations.point],
        amplitude=np.sqrt(np.einsum("lhn,nm,lhm->l", first, M, first)),
        frequency=values["frequency"] / (2.0 * np.pi),
        friction_damping=(1.0 - share) * ratio,
        viscous_damping=share * ratio,
        displaced=displaced,
        decrement=decrement,
        decrement_error=error,
        displacement=np.linalg.norm(first @ P.T, axis=1),
        harmonics=levels.u,
        series=series,
        slip=slip,
        state=tuple(state),
        opened=opened,
        losses=Losses(work.sum(axis=1), viscous, strain, np.asarray((contact.J @ work.T).T)),
        friction_work=work,
        errors=errors,
        marched=marched,
        release=state_of(balance, q, omega),
        notes=tuple(f"Mode {equations.number}: {note}" for note in notes),
    )


def _decrement(
    amplitude: FloatArray, lost: FloatArray, energy: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Logarithmic decrements over 2 pi, of what cycles lose and the energy at turning points, J.

    Beside them are their relative errors by the derivative of the energy.
    """
    from scipy.interpolate import PchipInterpolator  # slow to load

    nowhere, last = np.full(amplitude.size, np.nan), amplitude.size - 1
    if amplitude.size < 2 or not (np.diff(amplitude) > 0.0).all():
        return nowhere, nowhere
    a, U = np.log(amplitude), np.log(energy)
    slope = PchipInterpolator(a, U).derivative()(a)
    slope = np.where(slope > 0.0, slope, np.nan)
    some = np.unique([*range(0, last, 2), last])
    coarse = PchipInterpolator(a[some], U[some]).derivative()(a) if last > 1 else nowhere
    apart = np.pad(np.abs(coarse / slope - 1.0), 1, mode="edge")  # which vanishes at single levels
    error = np.maximum(np.maximum(apart[:-2], apart[1:-1]), apart[2:])
    return lost / (2.0 * np.pi * energy * slope), 2.0 * error


def _notes(levels: Levels, values: Mapping[str, FloatArray], soft: float) -> Iterator[str]:
    """Notes of the law, of soft springs, of turns, and of a model's range."""
    system = levels.equations.balance.system
    contact, origin = system.contact, system.origin
    yield from notes_of_law(contact)
    if soft > SOFT_FORCE:
        yield (
            "neither springs nor contact pressed at rest hold the structure's mean position, which "
            f"soft springs hold here with up to {100.0 * soft:.2g} % of the friction limits, or "
            "where there are none of the normal forces or the inertia; support it, or see a "
            "ring-down."
        )
    if (several := np.flatnonzero(levels.met > 1) + 1).size:
        yield (
            "it turns back in its amplitude and meets some levels more than once, the numbers "
            f"{', '.join(map(str, several))}: there are several motions of that amplitude, of "
            "which these are the first on the way from small ones."
        )
    highest = getattr(origin, "highest", np.inf) if system.made_for else np.inf
    beyond = values["frequency"] ** 2 * levels.amplitudes * levels.equations.modal
    if (beyond > highest).any():
        yield (
            f"from the level number {int(np.argmax(beyond > highest)) + 1} on amplitudes are "
            f"beyond those that the reduced model was made for, {system.made_for}: how far its "
            "modes serve there is not known. Make it of a curve up to higher levels."
        )


def notes_of_errors(curve: NonlinearMode, settled: Mapping[str, float]) -> Iterator[str]:
    """Notes of values that have not settled, and of time steps that differ or do not converge."""
    if curve.marched is not None:
        yield from curve.marched.notes
    for name, bound in settled.items():
        what = name.replace("_", " ")
        worst = float(curve.errors["harmonics"][name].max())
        if np.isnan(worst):
            yield (
                f"by how much its {what} would change with more than {curve.series.highest} "
                "harmonics is not known at all levels. Give a smaller model, or fewer levels."
            )
        elif worst > bound:
            yield (
                f"its {what} has not settled with {curve.series.highest} harmonics: up to "
                f"{100.0 * worst:.2g} % of it may be missing. See the errors of its levels."
            )
        if np.isnan(curve.errors.get("sticking", {}).get(name, 0.0)).any():
            yield (
                f"by how much springs that stand for rigid sticking change its {what} is not known "
                "at all levels. See the errors of its levels."
            )
        if curve.marched is not None:
            apart = np.abs(getattr(curve.marched, name))
            stated = np.nan_to_num(curve.errors["harmonics"][name][curve.marched.levels])
            stated += 2.0 * bound  # harmonics that the first motion lacks take periods to come
            if (far := apart > stated).any():
                worst = int(np.argmax(np.where(far, apart, 0.0)))
                k = int(curve.marched.levels[worst])
                yield (
                    f"time steps differ in {what} by {100.0 * float(apart[worst]):.2g} % at "
                    f"the level number {k + 1}, more than is stated. The motion may not be the "
                    "only one there, or other modes take part."
                )
