"""A structure whose contact sticks: its modes, and solutions with its stiffness by one factor."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.linalg import shifts
from skfem_joint.linalg.factors import factorised
from skfem_joint.reduction.interface_modes import motions_without_slip
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.system.modes import eigenmodes, round_off, without_shift
from skfem_joint.system.system import System
from skfem_joint.system.unknowns import congruent

#: Relative differences of a mode from that of another computation, by round-off.
ALIKE = 1e-6


class Stuck:
    """Stiffness and mass of the motions in which no contact point slips.

    Springs in series with friction take part, and their sliders are held.

    Parameters
    ----------
    system : System
    path : QuasiStatic, optional
        A quasi-static response of it; its factor is used again where it fits.

    Attributes
    ----------
    system : System
    F : sparse array, shape (n, k)
        The motions.
    K, M : sparse array, shape (k, k)

    Raises
    ------
    InputError
        If everything is in contact, so that nothing is left to vibrate.
    """

    def __init__(self, system: System, path: QuasiStatic | None = None) -> None:
        self.system = system
        self.F, self.path = motions_without_slip(system, carrying=True), path
        if self.F.shape[1] == 0:
            raise InputError(
                "stuck modes: every unknown is in contact, so that no mode is left when it sticks; "
                "give the contact a stiffness, leave a part of the structure out of the joints, "
                "keep interface_modes in a reduced model, or look at response"
            )
        K, M = (congruent(A, self.F) for A in (system.stuck_stiffness, system.M))
        self.K, self.M = sparse.csr_array(K), sparse.csr_array(M)

    @cached_property
    def solver(self) -> tuple[Callable[[FloatArray], FloatArray], float]:
        """Solver of (K + shift M) x = f, and the shift, 1/s2: structures may float."""
        solve = None if self.path is None else self.path.stuck(self.F)
        if self.path is not None and solve is not None:
            return solve, self.path.mass_shift
        shift = shifts.LEAST * shifts.mean_square_frequency(self.K, self.M)
        return factorised(self.K + shift * self.M), shift

    def modes(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Lowest frequencies, Hz, zero of rigid motions, and modes (n, count), of unit mass.

        There are fewer if the motions are fewer.
        """
        still = None if self.path is None else self.path.stuck_still(self.F)
        if still is not None and count < self.F.shape[1] // 4:
            return self._beside(*still, count)
        solve, shift = self.solver
        A = self.K + shift * self.M
        frequency, shapes = eigenmodes(A, self.M, min(count, self.F.shape[1]), solve)
        frequency, shapes = without_shift(frequency, shapes, self.K, self.M, shift)
        return frequency, np.asarray(self.F @ shapes)

    def _beside(
        self, solve: Callable[[FloatArray], FloatArray], rigid: FloatArray, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Modes of a structure that floats: rigid motions of unit mass, and those beside them.

        ``solve`` is the solver with a support that is statically determinate.
        """
        momenta = np.asarray(self.M @ rigid)

        def beside(right: FloatArray) -> FloatArray:
            x = solve(right - momenta @ (rigid.T @ right))
            return np.asarray(x - rigid @ (momenta.T @ x))

        own = min(count, self.F.shape[1]) - rigid.shape[1]
        frequency, shapes = np.zeros(0), rigid[:, :0]
        if own > 0:
            frequency, shapes = eigenmodes(self.K, self.M, own, beside)
        every = np.concatenate([np.zeros(rigid.shape[1]), frequency])[:count]
        return every, np.asarray(self.F @ np.hstack([rigid, shapes]))[:, :count]


def check_stuck_modes(what: str, numbers: Collection[int], frequencies: FloatArray) -> None:
    """Refuse numbers of modes beyond all that there are, and of rigid motions, by frequencies, Hz.

    Raises
    ------
    InputError
        Whose message ``what`` begins.
    """
    refuse(
        f"{what}: found mode {k}, there are {frequencies.size} with the contact stuck"
        for k in numbers
        if k > frequencies.size
    )
    refuse(
        f"{what}: mode {k} moves the structure as a rigid body; support it, or choose a higher mode"
        for k in numbers
        if frequencies[k - 1] == 0.0
    )


def traits_of(system: System, shape: FloatArray) -> dict[str, float]:
    """Sums by which systems with a mode of the same shape (n,) are told apart.

    They are of what its curve depends on beside mass, stiffness and slips, with random weights, so
    that a change of any value shows. The steepness of the law is none: curves are of Coulomb's.
    """
    contact, normal = system.contact, system.contact.normal
    w, p = (np.random.default_rng(0).random(x.size) for x in (contact.w, normal.gap))
    return {
        "friction limits": float(w @ contact.w),
        "coefficients of friction": float(w @ (contact.gain @ p)),
        "springs": float(w @ contact.spring_constants),
        "gaps": float(p @ normal.gap),
        "normal forces": float(p @ normal.force),
        "damping": float(shape @ (system.C @ shape)),
    }


def check_curve(
    what: str, system: System, curve: Any, may_differ: Collection[str] = ()
) -> list[str]:
    """Refuse a curve of a mode that does not belong to a system.

    The mode must be one of the system with its contact stuck: elsewhere it would have another mass
    or frequency, or slip. Those of `traits_of` that ``may_differ`` are returned where they do.

    Raises
    ------
    InputError
        For something else, or the curve of another mode or of other traits; ``what`` begins the
        message.
    """
    if not hasattr(curve, "stuck_frequency"):  # of a class whose folder comes later
        raise InputError(
            f"{what}: curve: found {type(curve).__name__}, must be one of those that sj.backbone "
            "gives as a list"
        )
    belongs, others = _is_mode(system, curve), list[str]()
    if belongs and curve.traits:
        own = traits_of(system, curve.shape)
        others = [k for k in own if not np.isclose(own[k], curve.traits[k], ALIKE, 0.0)]
    wrong = [name for name in others if name not in may_differ]
    if belongs and not wrong:
        return others
    why = f"other {' and '.join(wrong)}" if belongs else "no such mode with its contact stuck"
    raise InputError(
        f"{what}: the curve of mode {curve.mode} does not belong to the system, which has {why}; "
        "compute it by sj.backbone(system, ...)"
    )


def _is_mode(system: System, curve: Any) -> bool:
    """Whether the shape of a curve is a mode of a system with its contact stuck."""
    shape, contact = curve.shape, system.contact
    if shape.shape != (system.n,):
        return False
    K, square = system.stuck_stiffness, (2.0 * np.pi * curve.stuck_frequency) ** 2
    strain = shape @ (K @ shape) + shape @ (contact.normal.springs @ shape)
    stuck = contact.on_rows((contact.w > 0.0) & ~contact.sprung)
    slip = np.abs(stuck * (contact.B @ shape)).max(initial=0.0)
    most = abs(contact.B).sum(axis=1).max(initial=0.0) * np.abs(shape).max()
    mass, unsure = shape @ (system.M @ shape), float(round_off(K, shape[:, np.newaxis])[0])
    alike = abs(strain - square) <= ALIKE * square + unsure and abs(mass - 1.0) <= ALIKE
    return bool(alike and slip <= ALIKE * most)


@dataclass(frozen=True)
class StuckMode:
    """A mode with the contact stuck.

    Attributes
    ----------
    number : int
        From 1.
    frequencies, shapes : ndarray, shape (modes,) and (n, modes)
        Of this mode, those below and some of those above: Hz, and of unit modal mass, kg^(-1/2).
    stuck : Stuck
        Structure that it is a mode of, in whose unknowns it is.
    """

    number: int
    frequencies: FloatArray
    shapes: FloatArray
    stuck: Stuck

    @property
    def shape(self) -> FloatArray:
        """Of the mode itself, (n,), kg^(-1/2)."""
        return np.asarray(self.shapes[:, self.number - 1])

    @property
    def frequency(self) -> float:
        """Frequency with the contact stuck, Hz."""
        return float(self.frequencies[self.number - 1])

    @property
    def force(self) -> FloatArray:
        """Inertia M phi, the load of level 1, (n,), N."""
        return np.asarray(self.stuck.system.M @ self.shape)
