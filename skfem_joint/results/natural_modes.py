"""Natural frequencies and modes of a system with its joints stuck or loose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.values import COUNT, check, check_kind
from skfem_joint.reduction.interface_modes import motions_without_slip
from skfem_joint.system.modes import lowest_modes
from skfem_joint.system.system import System
from skfem_joint.system.unknowns import congruent


@dataclass(frozen=True)
class NaturalModes:
    """Natural modes of an undamped linear system, the lowest first.

    Attributes
    ----------
    frequencies : ndarray, shape (k,)
        Natural frequencies, Hz; zero for rigid motions.
    modes : ndarray, shape (n, k)
        Modes in the unknowns of the system, of unit modal mass, kg^(-1/2).
        ``system.expand(modes.T)`` gives them for all displacements, shape (k, N).
    """

    frequencies: FloatArray
    modes: FloatArray

    @property
    def rigid_motions(self) -> int:
        """Number of rigid motions, which strain nothing."""
        return int(np.count_nonzero(self.frequencies == 0.0))

    @property
    def straining(self) -> NaturalModes:
        """The modes without rigid motions."""
        strains = self.frequencies > 0.0
        return NaturalModes(self.frequencies[strains], self.modes[:, strains])


def natural_modes(
    system: System, count: int = 6, *, joints: Literal["loose", "stuck"] = "loose"
) -> NaturalModes:
    """Lowest natural frequencies and modes of a system, without damping.

    A joint with friction is a little stiffer than a loose one, which slides freely, and a little
    softer than a stuck one. These two limits are linear: ``K phi = (2 pi f)^2 M phi``, in all
    motions or in those in which no point with friction slips. Where friction has springs in series
    these take part in the motion, and sliders stick. Contact that opens counts as closed where it
    is pressed at rest, in both.

    Parameters
    ----------
    system : System
        Full, condensed or reduced. A reduced system has the modes that its basis can form.
    count : int
        Number of modes; fewer where the system has no more unknowns.
    joints : {"loose", "stuck"}
        Whether contact points slide without friction, or those with friction are held.

    Returns
    -------
    NaturalModes
        Frequencies (Hz) and modes of unit modal mass.

    Raises
    ------
    InputError
        If ``count`` is no whole number above zero, or ``joints`` is another word.

    Examples
    --------
    The first longitudinal mode of a steel bar that is held at one end has the frequency c / (4 L):

    >>> import skfem_joint as sj
    >>> bar = sj.build_bar([("bar", 1.0, 100)], {"wall": 0.0, "tip": 1.0})
    >>> steel = sj.Material(E=200e9, density=8000.0)
    >>> system = sj.Structure(bar, steel, width=0.01, thickness=0.01, fixed=["wall"]).system()
    >>> round(float(sj.natural_modes(system, 1).frequencies[0]))
    1250
    """
    check_kind("system", system, System)
    check("count", count, COUNT)
    if joints not in ("loose", "stuck"):
        raise InputError(f"joints: found {joints!r}, must be 'loose' or 'stuck'")
    if system.contact.opens:
        closed = natural_modes(system.closed(), count, joints=joints)
        return NaturalModes(
            closed.frequencies, system.contact.normal.closed_motions() @ closed.modes
        )
    stuck = joints == "stuck"
    K, M = (sparse.csr_array(A) for A in (system.stuck_stiffness if stuck else system.K, system.M))
    if not stuck:
        return NaturalModes(*lowest_modes(K, M, count))
    F = motions_without_slip(system, carrying=True)
    if not F.shape[1]:
        return NaturalModes(np.zeros(0), np.zeros((system.n, 0)))
    frequencies, modes = lowest_modes(congruent(K, F), congruent(M, F), count)
    return NaturalModes(frequencies, np.asarray(F @ modes))
