"""Frequency responses of a curve: motion of a point over the force, or over that of the base.

The harmonics of a steady vibration are those of ``exp(i k omega t)``. Each harmonic of a point's
displacement, velocity or acceleration is divided by the first harmonic of the first load; those
beyond the first are what friction adds. All depend on the level, for the vibration is not linear.

Where the load is an accelerated base displacements are relative to it. The transmissibility is the
absolute motion of a point, along its own direction, over that of the base.
"""

from __future__ import annotations

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import common_period
from skfem_joint.ground.values import check_kind as check_type
from skfem_joint.system.system import System
from skfem_joint.vibration.response import at_frequency, harmonics_of
from skfem_joint.vibration.response_curve import Curve

#: Kinds, their units over a force, and the power of i omega that makes each of a displacement.
KINDS = {
    "receptance": ("m/N", 0),
    "mobility": ("m/s/N", 1),
    "accelerance": ("m/s²/N", 2),
    "transmissibility": ("", 2),
}


def frequency_response(
    system: System, curve: Curve, point: str, kind: str = "receptance"
) -> FloatArray:
    """Motion of a named point over the load at each frequency of a response.

    Parameters
    ----------
    system : System
        That the response is of.
    curve : Curve
        One of its curves.
    point : str
        One of ``system.points``.
    kind : {"receptance", "mobility", "accelerance", "transmissibility"}
        Displacement (m/N), velocity (m/s/N) or acceleration (m/s²/N) over the force of the first
        load; or, of a base that is accelerated, absolute motion over that of the base.

    Returns
    -------
    ndarray of complex, shape (frequencies, 5)
        Harmonics over the first harmonic of the load, with the phase after it; nan where there is
        no steady vibration. The first column is what is measured as frequency response.

    Raises
    ------
    InputError
        For another kind or point, a load without a first harmonic, and a transmissibility where no
        base moves.
    """
    check_type("system", system, System)
    check_type("curve", curve, Curve)
    check_kind(system, kind)
    if point not in system.points:
        raise InputError(
            f"frequency response: found point {point!r}, must be one of {', '.join(system.points)}"
        )
    load, number = system.loads[0], system.points.index(point)
    frequency = curve.column("frequency")
    X = curve.column("harmonics")[:, number]
    order = np.arange(1, X.shape[1] + 1)
    i_omega = 2j * np.pi * frequency[:, np.newaxis] * order
    force = np.array([_load_harmonics(system, f, curve.level) for f in frequency.tolist()])
    if kind != "transmissibility" or load.carried is None:
        return np.asarray(i_omega ** KINDS[kind][1] * X / force[:, :1])
    base = -force / load.mass
    return np.asarray((i_omega**2 * X + load.carried[number] * base) / base[:, :1])


def check_kind(system: System, kind: str) -> None:
    """Refuse a kind of frequency response that there is not, or that a system has not; InputError.

    Its first load must have a first harmonic, and be that of a moving base for a transmissibility.
    """
    if kind not in KINDS:
        raise InputError(f"frequency response: found {kind!r}, must be one of {', '.join(KINDS)}")
    load = system.loads[0]
    period = common_period(one.amplitude for one in system.loads) or 0.0
    turns = [round(part.frequency * period) for part in load.amplitude.harmonics if part.amplitude]
    if 1 not in turns:
        raise InputError(
            f"frequency response: the first load, on {load.on!r}, has no first harmonic to divide "
            "by; put one that has it first"
        )
    if kind == "transmissibility" and load.carried is None:
        raise InputError(
            "frequency response: found 'transmissibility', which needs a base that moves as the "
            "first load; ask for a receptance, mobility or accelerance"
        )


def _load_harmonics(system: System, frequency: float, level: float) -> FloatArray:
    """Harmonics of the first load at a frequency (Hz) and level, (harmonics,), N."""
    steps = 64  # which determine all harmonics that results report
    times = np.arange(steps) / (steps * frequency)
    amplitudes = at_frequency(system, frequency, level).load_amplitudes(times)
    return np.asarray(harmonics_of(amplitudes[:1].T)[0])
