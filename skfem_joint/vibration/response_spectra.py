"""Spectral densities of named points under a random load, from the vibration of modes.

    S = G ( |sum_k <c_k H_k> + R|^2 + sum_k (<|c_k H_k|^2> - |<c_k H_k>|^2) ),

with G that of a load, H_k the transfer function of mode k at an amplitude, c_k its displacement
of the point there, R what is left of the structure with its contact stuck (other modes inside the
frequencies of G have no resonance), and < > the mean over amplitudes by their share
in the mean square. Densities of loads without correlation are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import Harmonic
from skfem_joint.ground.power_density import AddedDensities, PowerDensity
from skfem_joint.reduction.stuck import Stuck
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.system.system import AppliedLoad, System
from skfem_joint.vibration.backbone import Backbone
from skfem_joint.vibration.modal_amplitudes import ModalAmplitudes, at_amplitudes, peak_of

#: Euler's constant, of the mean of a largest value.
EULER = float(np.euler_gamma)


@dataclass(frozen=True)
class Spectrum:
    """Spectral densities of a quantity at the points.

    Attributes
    ----------
    frequency, weight : ndarray, shape (k,)
        Of integrals, Hz.
    density : ndarray, shape (points, k)
    of_modes : ndarray, shape (modes, points)
        Mean squares of the modes alone.
    """

    frequency: FloatArray
    weight: FloatArray
    density: FloatArray
    of_modes: FloatArray

    @property
    def rms(self) -> FloatArray:
        """Root mean squares, (points,)."""
        return np.asarray(np.sqrt(self.density @ self.weight))

    def peak(self, factors: FloatArray, duration: float) -> FloatArray:
        """Expected largest values in a duration, s, (points,).

        Modes have their own peaks over root mean squares, ``factors``; the rest is Gaussian
        (A. G. Davenport, Proc. ICE 28, 1964). Squares of peaks are added in shares of the mean
        square.
        """
        square = self.density @ self.weight
        rest = np.maximum(square - self.of_modes.sum(axis=0), 0.0)
        moment = self.density @ (self.weight * self.frequency**2)
        rate = np.sqrt(np.divide(moment, square, out=np.ones_like(square), where=square > 0.0))
        root = np.sqrt(2.0 * np.log(np.maximum(rate * duration, np.e)))
        squares = factors**2 @ self.of_modes + (root + EULER / root) ** 2 * rest
        whole = self.of_modes.sum(axis=0) + rest
        ratio = np.divide(squares, whole, out=np.zeros_like(whole), where=whole > 0.0)
        return np.asarray(np.sqrt(ratio * square))


class RandomLoad(NamedTuple):
    """A load with a density.

    Attributes
    ----------
    vector : ndarray, shape (n,)
        Force of a load of 1, N.
    density : PowerDensity
    carried : ndarray, shape (points,), optional
        Motion of the points along with the base, where the load is its acceleration: absolute
        accelerations have this part of it.
    """

    vector: FloatArray
    density: PowerDensity
    carried: FloatArray | None

    def moves(self, frequency: float) -> bool:
        """Whether a frequency, Hz, is among those of the density."""
        low, high = self.density.frequencies[[0, -1]].tolist()
        return bool(low <= frequency <= high)


class StuckUnder:
    """A structure with its contact stuck, under constant forces (n,), N.

    Attributes
    ----------
    static : ndarray, shape (forces, points)
        Displacements of the named points, m.
    frequencies : ndarray, shape (k,)
        Its lowest natural frequencies, Hz.
    shapes : ndarray, shape (k, n)
        Their modes, of unit modal mass.
    pushed : ndarray, shape (forces, points, k)
        Displacement of the points in each mode times its force, m/s².
    damping : ndarray, shape (k,)
        Modal damping by C, 1/s.

    Raises
    ------
    InputError
        If nothing holds it.
    """

    def __init__(self, system: System, vectors: Sequence[FloatArray], count: int) -> None:
        loads = tuple(AppliedLoad(vector, Harmonic(1.0, 1.0)) for vector in vectors)
        to = arranged(replace(system, loads=loads).closed())
        inner, stuck = to.system, Stuck(to.system)
        self.frequencies, modes = stuck.modes(count)
        if self.frequencies[0] == 0.0:
            raise InputError(
                "random_response: the structure floats, so that a random load moves it away "
                "without limit; support it"
            )
        solve, _ = stuck.solver
        moved = [stuck.F @ solve(stuck.F.T @ load.vector) for load in inner.loads]
        self.static = np.array([inner.P @ each for each in moved])
        self.shapes = to.outer(modes.T)
        if system.contact.opens:
            closed = system.contact.normal.closed_motions()
            self.shapes = np.asarray((closed @ self.shapes.T).T)
        push = (self.shapes @ np.transpose(vectors)).T
        self.pushed = (system.P @ self.shapes.T) * push[:, np.newaxis]
        self.damping = np.einsum("kn,kn->k", self.shapes, (system.C @ self.shapes.T).T)

    def rest(
        self, number: int, load: RandomLoad, turn: FloatArray, given: Sequence[int]
    ) -> FloatArray:
        """Transfer functions without the modes ``given``, by number, (points, k), m.

        Modes outside of the load's frequencies are linear. Those inside have no resonance: they
        follow the load without inertia up to 1.41 times their frequency, from where on inertia
        leaves less. All whose frequencies are not known follow it without inertia.

        Parameters
        ----------
        number : int
            Of the load's force.
        load : RandomLoad
        turn : ndarray, shape (k,)
            Angular frequencies, rad/s.
        given : sequence of int
        """
        square = (2.0 * np.pi * self.frequencies[:, np.newaxis]) ** 2
        size = square - turn**2 + 1.0j * self.damping[:, np.newaxis] * turn
        inside = [load.moves(frequency) for frequency in self.frequencies.tolist()]
        without_resonance = np.where(turn**2 < 2.0 * square, square, square - turn**2)
        size[inside] = without_resonance[inside]
        size[np.array(given) - 1] = np.inf
        moved = self.pushed[number] @ (1.0 / size - 1.0 / square)
        return np.asarray(self.static[number][:, np.newaxis] + moved)


class Spectra:
    """Transfer functions to the points, as means over the modes' amplitudes.

    Parameters
    ----------
    system : System
    curves, modes : sequence
        Backbones, and their amplitudes under the loads.
    loads : sequence of RandomLoad
        Without correlation.
    push : ndarray, shape (loads, modes)
        Modal forces of loads of 1, N/kg^1/2.
    stuck : StuckUnder
        Under their forces. What slip adds to the displacement of a mode is that of slow cycles: its
        parts along lower modes, which hardly move at the frequency of a higher one, are left out.

    Attributes
    ----------
    frequency : ndarray, shape (k,)
        Hz.
    """

    def __init__(
        self,
        system: System,
        curves: Sequence[Backbone],
        modes: Sequence[ModalAmplitudes],
        loads: Sequence[RandomLoad],
        push: FloatArray,
        stuck: StuckUnder,
    ) -> None:
        peaks = [peak_of(mode.omega, mode.damping) for mode in modes]
        every = AddedDensities(tuple(load.density for load in loads))
        self.frequency, self.weight = every.quadrature(peaks)
        self.loads, self.push, P = loads, push, as_dense(system.P)
        turn, given = 2.0 * np.pi * self.frequency, [curve.mode for curve in curves]
        self.rest = [stuck.rest(k, load, turn, given) for k, load in enumerate(loads)]
        means, squares = [], []
        for curve, mode in zip(curves, modes, strict=True):
            lower = stuck.shapes[: curve.mode - 1]
            states = curve.states - (curve.states @ (system.M @ lower.T)) @ lower
            moved = (P @ states.T) / curve.amplitude
            c = at_amplitudes(mode.amplitude, curve.amplitude, moved.T, P @ curve.shape)
            w, z = mode.omega[:, np.newaxis], mode.damping[:, np.newaxis]
            H = 1.0 / (w**2 - turn**2 + 2.0j * z * w * turn)
            shares = mode.weights()
            means.append((c.T * shares) @ H)
            squares.append((c.T**2 * shares) @ np.abs(H) ** 2)
        self.means, self.squares = np.array(means), np.array(squares)

    def of(self, order: int) -> Spectrum:
        """Spectral densities of the derivative of an order of the displacement, 0 or 2."""
        factor = (2.0j * np.pi * self.frequency) ** order
        squares = np.abs(factor) ** 2 * self.squares
        scatter = squares - np.abs(factor * self.means) ** 2
        density, of_modes = 0.0, 0.0
        for load, push, rest in zip(self.loads, self.push, self.rest, strict=True):
            whole = factor * (np.tensordot(push, self.means, axes=1) + rest)
            if order == 2 and load.carried is not None:
                whole = whole + load.carried[:, np.newaxis]
            G = load.density(self.frequency)
            more = np.tensordot(push**2, scatter, axes=1)
            density = density + G * (np.abs(whole) ** 2 + more)
            of_modes = of_modes + (push**2)[:, np.newaxis] * (squares @ (G * self.weight))
        return Spectrum(self.frequency, self.weight, np.asarray(density), np.asarray(of_modes))
