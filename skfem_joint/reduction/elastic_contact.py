"""Contact that opens in reduced models: elastic, so that few unknowns suffice.

Modes in which closed contact moves apart at none of its points and opens at others would have to
know beforehand which points close. A reduced model therefore has elastic contact in place of a
rigid one: each rigid pressure point c of area a_c gets the stiffness

    k_c = factor a_c (sum_i s_i) / (sum_i a_i),    s_i = 1 / (N diag(K)^-1 N^T)_ii,

with the stiffness s_i that the structure itself opposes to a motion of the point alone. The normal
forces then follow from the modes, which are made from paths of the same elastic contact: in these
the faces pass through each other by the normal force over the stiffness, and proper orthogonal
modes in the norm of strain energy, that of the contact included, have the pressures with the
displacements.

The factor is a compromise, see ``docs/theory/opening.md``: softer contact is easier to follow, but
wrong where contact takes a good part of the motion.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import sparse

from skfem_joint.arrays import FloatArray, Matrix, as_dense
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.linalg.shifts import shifted
from skfem_joint.modes import rigid_motions
from skfem_joint.stepping.arrangement import Arranged
from skfem_joint.stepping.levels import Level, NoLevelError, in_parts
from skfem_joint.stepping.quasi_static import SETTINGS
from skfem_joint.system import System

#: Where forces are not held, the way to them is halved so many times to find how far they are.
HALVINGS = 5
#: Increments of half a slow cycle that modes are made of.
IN_HALF = 8
#: Stiffness of contact over that which the structure opposes to single points.
FACTOR = 10.0


def elastic(system: System) -> System:
    """System whose rigid contact that opens is elastic; itself if there is none.

    Raises
    ------
    InputError
        If there are springs in series with friction beside contact that opens.
    """
    contact = system.opening
    if contact is None:
        return system
    if system.opening is not None and system.has_springs:
        raise InputError(
            "reduced model: found springs in series with friction beside contact that opens, which "
            "has full and condensed models alone; give sj.condense(system), or leave "
            "tangential_stiffness out"
        )
    if not contact.rigid.any():
        return system
    N = sparse.csr_array(contact.N)
    compliance = (N * N) @ (1.0 / np.asarray(system.K.diagonal()))
    own = np.divide(1.0, compliance, out=np.zeros_like(compliance), where=compliance > 0.0)
    stiffness = FACTOR * own.sum() / contact.area.sum() * contact.area
    return replace(
        system,
        opening=replace(contact, stiffness=np.where(contact.rigid, stiffness, contact.stiffness)),
    )


def check_reference(system: System, reference: str) -> None:
    """Refuse modes of contact that opens that do not come from its static path."""
    if system.opening is not None and reference != "static":
        raise InputError(
            f"reduction.reference: found {reference!r}, must be 'static' with contact that opens, "
            "whose modes come from a path of elastic contact"
        )


def strain_norm(system: System) -> Matrix:
    """Stiffness, (n, n), in whose norm modes are made: with that of elastic contact at rest.

    A little of the mass is added to it, as bodies may move freely.
    """
    contact = system.opening
    if contact is None:
        return shifted(system.K, system.M)
    springs = as_dense(contact.springs) if system.is_dense else contact.springs
    return shifted(system.K + springs, system.M)


class OpeningPath:
    """Quasi-static paths of a system with contact that opens, as `slip_path` follows them.

    Parameters
    ----------
    system : System
    tolerance : float
        Largest force residual relative to the largest force.

    Attributes
    ----------
    to : Arranged
    solves : int
        Levels that were solved.
    scaled_back : int
        Levels that friction and contact do not hold: they are left out.
    """

    #: No factors to be used elsewhere.
    unshifted = None

    def __init__(self, system: System, tolerance: float) -> None:
        from skfem_joint.stepping.opening_levels import OpeningLevels  # loads the compiler

        self.solver = OpeningLevels(system, tolerance)
        self.to: Arranged = self.solver.to
        self.solves = self.scaled_back = 0

    @cached_property
    def rigid(self) -> FloatArray:
        """Motions of bodies that friction and contact alone hold, (n, r)."""
        inner = self.to.system
        if self.solver.added is None:
            return np.zeros((inner.n, 0))
        return rigid_motions(inner.K, inner.M, SETTINGS.most_rigid)

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far."""
        return int(self.solver.counts["factorizations"])

    def follow(self, forces: FloatArray, times: FloatArray | None = None) -> FloatArray:
        """Displacements (levels, n), m, from rest under forces (levels, n), N, one after another.

        Forces that friction and contact do not hold, because they lift a body off or slide it away,
        are followed as far as they are held. ``times`` do not matter: slip follows Coulomb's law.

        Raises
        ------
        ConvergenceError
            If a level does not converge.
        """
        del times
        last, before = self.solver.rest(), np.zeros(self.to.system.n)
        states = []
        for force in self.to.force(forces.T).T:
            last, before = self._reached(last, before, force)
            states.append(last.u)
        return self.to.outer(np.array(states))

    def _reached(
        self, last: Level, before: FloatArray, force: FloatArray
    ) -> tuple[Level, FloatArray]:
        """Level on the way to ``force`` from that under ``before``, and the forces of it, N.

        Where the whole way is not held, a bisection finds how much of it is.
        """
        held, lost, tried = 0.0, 1.0, 1.0
        start, change = before, force - before
        for _ in range(1 + HALVINGS):
            aim = start + tried * change
            try:
                for _, level in in_parts(self.solver.next, last, before, aim):
                    self.solves += 1
                    last = level
            except NoLevelError as error:
                if not error.beyond:
                    raise ConvergenceError(
                        "reduced model: its path under slowly changing loads was not found: "
                        f"{error}"
                    ) from error
                lost = tried
            else:
                held, before = tried, aim
                if held == 1.0:
                    return last, before
            tried = 0.5 * (held + lost)
        self.scaled_back += 1
        return last, before


def states_of_cycles(
    system: System, force: FloatArray, level: FloatArray, tolerance: float = 3e-5
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """States of slow cycles of a force at some levels, for modes of a damping curve.

    Parameters
    ----------
    system : System
        With elastic contact.
    force : ndarray, shape (n,)
        N at the level 1.
    level : ndarray, shape (levels,)
        Rising levels.
    tolerance : float
        Largest force residual relative to the largest force.

    Returns
    -------
    states, increments : ndarray, shape (s, n)
        Displacements, m, and their changes on the way.
    rigid : ndarray, shape (n, r)
        Motions of bodies that friction and contact alone hold.

    Raises
    ------
    ConvergenceError
        If a level does not converge.
    """
    turns = [0.0]
    for top in level.tolist():
        turns += [top, -top, top]
    shares = [np.linspace(a, b, IN_HALF + 1)[1:] for a, b in pairwise(turns)]
    path = OpeningPath(system, tolerance)
    states = path.follow(np.concatenate(shares)[:, np.newaxis] * force)
    return states, np.diff(states, axis=0, prepend=0.0), path.to.outer(path.rigid.T).T
