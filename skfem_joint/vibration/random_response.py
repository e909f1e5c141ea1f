"""Response to random loads, by the backbones of modes.

Each mode vibrates as :mod:`skfem_joint.vibration.modal_amplitudes` says, beside the others as
:mod:`skfem_joint.vibration.joined_modes` says. All else of the structure follows the load without
inertia, with the contact stuck. Frequency, damping and the displacement per modal amplitude are
those of the backbones at each amplitude: :mod:`skfem_joint.vibration.response_spectra`.
Friction in joint j takes the power <zeta_kj omega^3 a^2> from mode k, with < > the mean over the
amplitudes a.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import Scaled
from skfem_joint.ground.plain_values import Tabular
from skfem_joint.ground.power_density import GRAVITY, AddedDensities, PowerDensity
from skfem_joint.ground.values import POSITIVE, check, several
from skfem_joint.reduction.stuck import check_curve
from skfem_joint.system.system import AppliedLoad, System
from skfem_joint.vibration.backbone import Backbone
from skfem_joint.vibration.joined_modes import joined_modes
from skfem_joint.vibration.modal_amplitudes import ModalAmplitudes, ModeCurve
from skfem_joint.vibration.response_spectra import RandomLoad, Spectra, StuckUnder

#: Units of a density by their names, and factors to SI.
UNITS = {"SI": 1.0, "g2/Hz": GRAVITY**2}
#: Share of the mean square beyond a curve's highest level from which a note says so, and above
#: which the curve is refused.
DOUBTFUL, MOST_BEYOND = 0.01, 0.5
#: Seconds in an hour.
HOUR = 3600.0
#: Cycles of the slowest mode that a duration has at least: shorter ones depend on how they start.
FEWEST_CYCLES = 5
#: Modes beyond those given among which ones inside the density's frequencies are looked for.
LOOKED_FOR = 10


@dataclass(frozen=True)
class RandomMode:
    """A mode under a random load.

    Attributes
    ----------
    mode : int
        Number of the mode, from 1.
    rms : float
        Root mean square of the modal displacement, m kg^1/2.
    frequency : float
        Mean number of cycles in a second, Hz.
    damping_ratio : float
        Of the linear mode that loses as much.
    peak : float
        Expected largest modal displacement in the duration, m kg^1/2.
    beyond : float
        Share of its mean square at amplitudes above its backbone's highest.
    """

    mode: int
    rms: float
    frequency: float
    damping_ratio: float
    peak: float
    beyond: float


@dataclass(frozen=True)
class RandomResponse(Tabular):
    """Stationary response to random loads.

    Attributes
    ----------
    load : str
        Where it acts; places of several loads with "and" between them.
    duration : float
        For which the peaks are, s.
    points : tuple of str
    modes : tuple of RandomMode
    frequencies : ndarray, shape (k,)
        Of the spectral densities, Hz; narrow across the peaks.
    displacement_psd, acceleration_psd : ndarray, shape (points, k)
        Of one side, m²/Hz and (m/s²)²/Hz. Displacements under a moving base are relative to it,
        accelerations are absolute.
    displacement_rms, acceleration_rms : ndarray, shape (points,)
        Root mean squares, m and m/s².
    displacement_peak, acceleration_peak : ndarray, shape (points,)
        Expected largest absolute values in the duration, m and m/s².
    joints : tuple of str
    joint_work : ndarray, shape (joints,)
        Work of friction in each joint in an hour, J.
    point_work : ndarray, shape (m,)
        Work of friction at each contact point in an hour, J, for maps of wear.
    viscous_work : float
        Work of the modes' viscous damping in an hour, J.
    estimated : dict of str to float
        Estimated relative errors of "displacement_rms" and "friction_work" by the levels of the
        curves, and by what these state themselves; not those of the method.
    notes : tuple of str
        What to beware of, the notes of the curves included.
    """

    load: str
    duration: float
    points: tuple[str, ...]
    modes: tuple[RandomMode, ...]
    frequencies: FloatArray
    displacement_psd: FloatArray
    acceleration_psd: FloatArray
    displacement_rms: FloatArray
    acceleration_rms: FloatArray
    displacement_peak: FloatArray
    acceleration_peak: FloatArray
    joints: tuple[str, ...]
    joint_work: FloatArray
    point_work: FloatArray
    viscous_work: float
    estimated: Mapping[str, float]
    notes: tuple[str, ...]

    @property
    def table(self) -> dict[str, Any]:
        """Columns with a row for each named point, as ``random.csv``."""
        return {
            "point": list(self.points),
            "displacement_rms_m": self.displacement_rms,
            "displacement_peak_m": self.displacement_peak,
            "acceleration_rms_m_s2": self.acceleration_rms,
            "acceleration_peak_m_s2": self.acceleration_peak,
        }


def random_response(
    system: System,
    curves: Sequence[Backbone],
    psd: PowerDensity | ArrayLike | str | Path | Sequence[PowerDensity | ArrayLike | str | Path],
    *,
    load: str | None = None,
    unit: str = "SI",
    duration: float = HOUR,
) -> RandomResponse:
    """Stationary response to loads whose power spectral densities are given.

    Parameters
    ----------
    system : System
        With the loads, whose courses over time do not count; full, condensed or reduced.
    curves : sequence of Backbone
        Of this system: of all modes inside the densities' frequencies, up to amplitudes that the
        vibration seldom exceeds; levels may be above that at which joints slip as a whole.
    psd : array_like, shape (k, 2), str or Path, or a list of such
        Frequencies, Hz, and densities of one side, straight between them on logarithmic axes and
        zero beyond; or a file of two such columns. N²/Hz of a force, Pa²/Hz of a traction or
        pressure, (m/s²)²/Hz of the acceleration of a base. A list has one for each of
        ``system.loads``, which then act without correlation. Loads in step with each other are one
        load, whose vector is their sum.
    load : str, optional
        Place of the load, ``system.loads[k].on``; not needed for a system with one load, or where
        each load has a density.
    unit : {"SI", "g2/Hz"}
        Of the densities; g²/Hz with g = 9.80665 m/s² for the acceleration of a base.
    duration : float
        For which peaks are expected, s; at least five cycles of the slowest mode.

    Returns
    -------
    RandomResponse

    Raises
    ------
    InputError
        If a density, the load, the duration or a curve is not as above, no mode is moved, or more
        than half of the mean square of a mode is above its curve's highest level.
    ConvergenceError
        If the amplitudes of a mode are not found, or modes do not settle beside each other.
    """
    check("random_response: duration", duration, POSITIVE)
    curves = several("random_response: curves", curves, Backbone)
    _check_curves(system, curves)
    names, loads = random_loads(system, psd, load, unit)
    push = np.array([[float(curve.shape @ each.vector) for curve in curves] for each in loads])
    # No mode of unit mass is pushed by more than the root of vector M^-1 vector.
    mass = system.M.diagonal()
    most = np.sqrt([np.sum(each.vector**2 / mass) for each in loads])
    moved = np.abs(push) > 1e-9 * most[:, np.newaxis]
    moves = moved.any(axis=0)
    if not moves.any():
        raise InputError(f"random_response: the load on {names!r} moves none of the modes")
    still = [curve.mode for curve, some in zip(curves, moves, strict=True) if not some]
    curves = [curve for curve, some in zip(curves, moves, strict=True) if some]
    J = as_dense(system.contact.J)
    modes = [mode_curve(J, curve) for curve in curves]
    forces = []
    for each, some in zip(push.T[moves], moved.T[moves], strict=True):
        parts = zip(loads, each.tolist(), some.tolist(), strict=True)
        forces.append(AddedDensities(tuple(a.density.scaled(p**2) for a, p, acts in parts if acts)))
    overlap = _overlaps(system, curves)
    found = joined_modes(modes, forces, overlap)
    coarse = joined_modes([mode.every_second() for mode in modes], forces, overlap)
    _check_beyond(found)
    shortest = FEWEST_CYCLES / min(mode.frequency for mode in found)
    if duration < shortest:
        raise InputError(
            f"random_response: duration: found {duration:g} s, must be at least {shortest:.4g} s, "
            f"{FEWEST_CYCLES} cycles of the slowest mode: expected peaks count its cycles"
        )
    highest = max(curve.mode for curve in curves) + LOOKED_FOR
    stuck = StuckUnder(system, [each.vector for each in loads], highest)
    spectra = Spectra(system, curves, found, loads, push[:, moves], stuck)
    friction = [mode.mean(mode.power(mode.friction_damping)) for mode in found]
    viscous = [mode.mean(mode.power(mode.viscous_damping)) for mode in found]
    points = [_point_power(J, *pair) for pair in zip(curves, found, strict=True)]
    own_peaks = np.array([mode.peak(duration) / mode.rms for mode in found])
    displacement, acceleration = (spectra.of(order) for order in (0, 2))
    return RandomResponse(
        load=names,
        duration=duration,
        points=system.points,
        modes=tuple(
            RandomMode(m.mode, m.rms, m.frequency, m.damping_ratio, factor * m.rms, m.beyond)
            for m, factor in zip(found, own_peaks.tolist(), strict=True)
        ),
        frequencies=spectra.frequency,
        displacement_psd=displacement.density,
        acceleration_psd=acceleration.density,
        displacement_rms=displacement.rms,
        acceleration_rms=acceleration.rms,
        displacement_peak=displacement.peak(own_peaks, duration),
        acceleration_peak=acceleration.peak(own_peaks, duration),
        joints=system.contact.joints,
        joint_work=HOUR * np.sum(friction, axis=0),
        point_work=HOUR * np.sum(points, axis=0),
        viscous_work=HOUR * float(np.sum(viscous)),
        estimated=_estimated(curves, found, coarse),
        notes=tuple(dict.fromkeys(_notes(system, stuck.frequencies, loads, curves, found, still))),
    )


def random_loads(
    system: System, psd: Any, load: str | None, unit: str
) -> tuple[str, list[RandomLoad]]:
    """Places of the loads that have densities, in words, and these loads; see `random_response`.

    InputError for a load that there is not, and for densities of another number or unit.
    """
    acting = _chosen(system, psd, load)
    given: Any = psd if _are_several(psd) else [psd]
    found = [_random_load(*pair, unit) for pair in zip(acting, given, strict=True)]
    return " and ".join(each.on for each in acting), found


def _check_curves(system: System, curves: Sequence[Backbone]) -> None:
    """Refuse curves that are none, of another system, or twice of a mode."""
    if not curves:
        raise InputError("random_response: curves: found none, must be those of sj.backbone")
    numbers = [curve.mode for curve in curves]
    if len(set(numbers)) < len(numbers):
        raise InputError(f"random_response: curves: found modes {numbers}, each must be there once")
    for curve in curves:
        check_curve("random_response", system, curve)
        if (found := curve.slip.shape[1]) != (expected := system.contact.w.size):
            raise InputError(
                f"random_response: the curve of mode {curve.mode} has {found} contact points, must "
                f"have the system's {expected}; compute it by sj.backbone(system, ...)"
            )


def _are_several(psd: Any) -> bool:
    """Whether an argument is a list of densities, not a table of two columns."""

    def is_one(each: Any) -> bool:
        if isinstance(each, list | tuple):
            return len(each) > 0 and isinstance(each[0], list | tuple | np.ndarray)
        return isinstance(each, PowerDensity | str | Path) or np.ndim(each) == 2

    return isinstance(psd, list | tuple) and all(map(is_one, psd))


def _chosen(system: System, psd: Any, name: str | None) -> list[AppliedLoad]:
    """Loads of a system that have densities; InputError if there are none, or others than these."""
    names = [load.on for load in system.loads]
    if _are_several(psd):
        if len(psd) != len(names) or name is not None:
            raise InputError(
                f"random_response: psd: found {len(psd)} densities"
                + ("" if name is None else f" and load {name!r}")
                + f", must be one for each of the system's loads, {names}, and no load"
            )
        return list(system.loads)
    chosen = [load for load in system.loads if name is None or load.on == name]
    if len(chosen) != 1:
        raise InputError(
            f"random_response: load: found {name!r}, must be one of the system's loads, {names}; "
            "for several of them give a list with a density of each"
        )
    return chosen


def _random_load(load: AppliedLoad, psd: Any, unit: str) -> RandomLoad:
    """Load with its density in SI; InputError for a unit that does not suit it."""
    vector = load.vector
    if isinstance(load.amplitude, Scaled):
        vector = load.amplitude.factor * vector
    if unit not in [*UNITS]:
        raise InputError(f"random_response: unit: found {unit!r}, must be one of {[*UNITS]}")
    if unit != "SI" and load.carried is None:
        raise InputError(
            f"random_response: unit: found {unit!r} for the load on {load.on!r}, must be 'SI' for "
            "a force, N²/Hz; accelerations are of a load with base"
        )
    density = PowerDensity.of(psd, unit)
    force = "Pa2/Hz" if isinstance(load.amplitude, Scaled) else "N2/Hz"
    suits = [force] if load.carried is None else ["(m/s2)2/Hz", "m2/s4/Hz", "g2/Hz"]
    if density.stated not in (None, *suits):
        raise InputError(
            f"random_response: psd: its header states {density.stated}, must be "
            f"{' or '.join(suits)} of the load on {load.on!r}"
        )
    return RandomLoad(vector, density.scaled(UNITS[unit]), load.carried)


def _check_beyond(modes: Sequence[ModalAmplitudes]) -> None:
    """Refuse curves whose highest level is too low."""
    for mode in modes:
        if mode.beyond > MOST_BEYOND:
            raise InputError(
                f"random_response: {100.0 * mode.beyond:.3g} % of the mean square of mode "
                f"{mode.mode} is above the highest amplitude of its curve; compute the curve up to "
                "higher levels (up_to, which may be above 1 where supports hold the structure), or "
                "lower the load"
            )


# Curves by joint


def mode_curve(J: FloatArray, curve: Backbone) -> ModeCurve:
    """Backbone by joint, ``J`` of the contact, (joints, m)."""
    omega, energy = 2.0 * np.pi * curve.frequency, 2.0 * np.pi * curve.level * curve.amplitude
    return ModeCurve(
        mode=curve.mode,
        stuck=2.0 * np.pi * curve.stuck_frequency,
        viscous=float(2.0 * omega[0] * curve.viscous_damping[0]),
        amplitude=curve.amplitude,
        omega=omega,
        friction=curve.friction_work @ J.T / energy[:, np.newaxis],
    )


def _point_power(J: FloatArray, curve: Backbone, mode: ModalAmplitudes) -> FloatArray:
    """Power of friction that a mode does at each contact point, (m,), W.

    Points share that of their joint as in the curve, at the levels about each amplitude; below the
    lowest level at which the joint slips as there. ``J`` is that of the contact.
    """
    power = mode.power(mode.friction_damping)
    levels = np.eye(curve.amplitude.size)
    near = np.array([np.interp(mode.amplitude, curve.amplitude, level) for level in levels])
    work, points = curve.friction_work, np.zeros(J.shape[1])
    for of_joint, own, taken in zip(J, J @ work.T, power.T, strict=True):
        slips = np.flatnonzero(own > 0.0)
        if slips.size:
            at_level = mode.mean((near * taken).T)
            at_level[slips[0]] += at_level[: slips[0]].sum()
            points += (at_level[slips] / own[slips]) @ (of_joint * work[slips])
    return points


def _overlaps(system: System, curves: Sequence[Backbone]) -> FloatArray:
    """Cosines between the slips of modes in each joint, (joints, modes, modes), not negative."""
    contact = system.contact
    slips = np.array([contact.B @ curve.states[curve.level.size // 2] for curve in curves])
    overlap = []
    for limits in contact.limits_by_joint:
        products = (slips * contact.on_rows(limits)) @ slips.T
        size = np.sqrt(np.diagonal(products))
        both = np.outer(size, size)
        overlap.append(np.divide(np.abs(products), both, out=np.zeros_like(both), where=both > 0.0))
    return np.array(overlap)


# What is stated


def _estimated(
    curves: Sequence[Backbone],
    found: Sequence[ModalAmplitudes],
    coarse: Sequence[ModalAmplitudes],
) -> dict[str, float]:
    """Relative errors by the levels of curves, by every second of them, and their own errors."""
    apart = max(abs(other.rms / mode.rms - 1.0) for mode, other in zip(found, coarse, strict=True))
    fine, rough = (
        sum(float(np.sum(mode.mean(mode.power(mode.friction_damping)))) for mode in modes)
        for modes in (found, coarse)
    )
    frequency, damping = (
        max(curve.estimated.get(name, 0.0) for curve in curves)
        for name in ("frequency", "damping_ratio")
    )
    # s² = G / (8 zeta omega³), and friction takes what viscous damping leaves of the input.
    return {
        "displacement_rms": apart + 1.5 * frequency + 0.5 * damping,
        "friction_work": (abs(rough / fine - 1.0) if fine > 0.0 else 0.0) + damping,
    }


def _notes(
    system: System,
    frequencies: FloatArray,
    loads: Sequence[RandomLoad],
    curves: Sequence[Backbone],
    found: Sequence[ModalAmplitudes],
    still: Sequence[int],
) -> Iterator[str]:
    """Sentences on what to beware of, those of the curves first."""
    for curve in curves:
        yield from curve.notes
    ends = np.array([load.density.frequencies[[0, -1]] for load in loads])
    low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
    given = {curve.mode for curve in curves} | {*still}
    missing = [
        f"{number} ({frequency:.5g} Hz)"
        for number, frequency in enumerate(frequencies.tolist(), 1)
        if number not in given and any(load.moves(frequency) for load in loads)
    ]
    if missing:
        yield (
            f"The density, from {low:g} to {high:g} Hz, has the natural frequencies of modes "
            f"{', '.join(missing)}, of which no curve is given: they are taken without their "
            "resonance, and what they do to the joints is left out. Root mean squares are "
            "too low there, and those of the modes given may be too large."
        )
    for mode in found:
        if mode.beyond > DOUBTFUL:
            yield (
                f"Mode {mode.mode}: {100.0 * mode.beyond:.2g} % of the mean square is above the "
                "highest amplitude of its curve, where its last frequency and damping are taken: "
                "compute the curve up to higher levels."
            )
    for number in still:
        yield f"Mode {number}: the load does not move it; it is left out."
    if system.contact.opens and len(curves) > 1:
        yield (
            "What the modes do to each other is that of joints with constant limits of friction, "
            "though the contact opens."
        )
