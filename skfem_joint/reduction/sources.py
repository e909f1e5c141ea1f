"""Where a basis comes from: the static slip path, a run of the full model, or slips beside modes.

Joint modes are proper orthogonal modes of its snapshots. Beside them stand static responses to the
loads, fixed-interface modes, and rigid motions that friction alone holds and does not hold. (The
paper's scaled modes have a folder of their own, `skfem_joint.reduction.scaled`.)
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray, evenly
from skfem_joint.ground.errors import InputError
from skfem_joint.reduction.basis import MANY_MODES, MOST_TIMES, Basis, Options, basis_of
from skfem_joint.reduction.elastic_contact import elastic, strain_norm
from skfem_joint.reduction.interface_modes import (
    FEW_BESIDE,
    MODES_FOR_ONE,
    RestrictedMotion,
    beside,
    driven,
)
from skfem_joint.reduction.joint_slides import joint_slides
from skfem_joint.reduction.pod import (
    orthonormal,
    proper_decomposition,
    proper_modes,
    stride_of,
    thinned,
)
from skfem_joint.reduction.static_path import NEWLY_SLIPPING, StaticPath
from skfem_joint.reduction.stuck import Stuck
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.stepping.recording import Run
from skfem_joint.system.system import System

#: Increments of half a slow cycle that modes are made of.
IN_HALF = 8
#: Largest force residual of a state relative to the largest force.
TOLERANCE = 3e-5
#: Singular values below this share of the largest are what the tolerance of paths leaves.
_LEAST_SINGULAR = 1e-7


def own_basis(system: System, run: Run, options: Options) -> Basis:
    """Proper orthogonal modes of a system's own run with stored fields, of at most 300 times.

    Fixed-interface modes beside them are the lowest, none if their number is "auto".

    Raises
    ------
    InputError
        If nothing moves in the run, or its snapshots make fewer modes than asked for.
    """
    every, modes = stride_of(len(run.u), MOST_TIMES), options.mode_count
    decomposed = {"snapshots": options.snapshots, "inner_product": options.product}
    proper = proper_modes(run, every=every, **decomposed)
    if not 1 <= modes <= proper.modes.shape[1]:
        raise InputError(
            f"reduction.modes: found {modes}, must be from 1 to {proper.modes.shape[1]}, which "
            "the snapshots of the run can make"
        )
    V, interface_modes = proper.modes[:, :modes], options.interface_modes
    if not isinstance(interface_modes, str) and interface_modes > 0:
        restricted = RestrictedMotion.of(system)
        if restricted.F.shape[1]:
            V = np.hstack([V, restricted.F @ restricted.lowest(interface_modes)[1]])
    if run.loops is not None:  # which should show the force of each joint
        V = np.hstack([V, joint_slides(system)])
    velocity = float(system.contact.slip_norm((system.contact.B @ run.v.T).T).max(initial=0.0))
    return basis_of(
        system,
        V,
        modes,
        proper,
        u=run.u,
        v=run.v,
        slip_peak=run.slip_peak,
        slip_velocity=velocity,
    )


def static_basis(
    system: System, path: StaticPath, modes: int, interface: str | int = "auto"
) -> Basis:
    """Proper orthogonal modes of a static path in the norm of strain energy, and what completes it.

    Static responses, rigid motions and fixed-interface modes stand beside them.

    Parameters
    ----------
    system : System
    path : StaticPath
    modes : int
        Joint modes; fewer if the path makes no more.
    interface : "auto" or int
        Number of fixed-interface modes, those with the largest shares in the response. "auto":
        the max(2, modes // 6) with the largest shares, without those whose motion the other
        vectors follow already (`skfem_joint.reduction.interface_modes.beside`).
    """
    proper = proper_decomposition(path.snapshots, strain_norm(system))
    counting = proper.singular_values > _LEAST_SINGULAR * proper.singular_values[0]
    modes = min(modes, int(np.count_nonzero(counting)))
    V = np.hstack([proper.modes[:, :modes], path.response, path.rigid])
    automatic = max(FEW_BESIDE, modes // MODES_FOR_ONE)
    automatic *= not path.loads.plan.quasi_static  # nothing vibrates
    count = automatic if isinstance(interface, str) else interface
    shapes, share = path.interface[:, :count], path.share[:count]
    if count > share.size:
        shapes, share = driven(system, path.response, path.loads, 2 * count)
        shapes, share = shapes[:, :count], share[:count]
    if isinstance(interface, str) and share.size:
        shapes = beside(system, V, shapes, share)
    V = np.hstack([V, shapes])
    run = path.run
    # As many states as V has columns stand for the run: their energies have the same sum.
    u = np.linalg.qr(run.u, mode="r") @ path.V.T
    slip = path.slip_peak  # more accurate than the run's
    if path.rigid.size:
        slip = system.contact.slip_norm(run.u @ (system.contact.B @ path.V).T).max(axis=0)
    preliminary = run.system
    slip_velocity = preliminary.contact.slip_norm(run.v @ np.asarray(preliminary.contact.B).T)
    velocity = float(slip_velocity.max(initial=0.0))
    basis = basis_of(
        system, V, modes, proper, u=u, v=path.V.T, slip_peak=slip, slip_velocity=velocity
    )
    # Its history has the coordinates of the preliminary basis: from these to those of the run.
    displacements, velocities = (
        thinned(x, MOST_TIMES) @ basis.history.velocities for x in (run.u, run.v)
    )
    history = replace(
        basis.history, velocities=velocities, displacements=displacements, resolved=1e-5
    )
    notes, new = basis.notes, path.newly_slipping
    if new > NEWLY_SLIPPING:
        notes = (
            *notes,
            f"The slip went on growing while the modes were made: {100 * new:.2g} % "
            "of what slips at last stuck in the round before. Use more modes and see whether "
            "the result stays, or take reference = 'self'.",
        )
    return replace(basis, history=history, stiffness=path.stiffness, notes=notes)


def mode_basis(system: System, curve: Any, options: Options) -> Basis:
    """Modes with the contact stuck, and proper orthogonal modes of what slips on a `Backbone`.

    Each state of the curve counts as much as the others, however far it slips. With contact that
    opens these are states of slow cycles of elastic contact at three of the levels, and rigid
    motions that contact and friction alone hold stand beside them. Modes of the stuck structure are
    those up to two beyond the mode, unless the options say how many.

    Raises
    ------
    InputError
        If nothing slips on the curve.
    ConvergenceError
        If a state of a cycle with contact that opens does not converge.
    """
    if not np.any(curve.share):
        raise InputError(
            f"backbone: mode {curve.mode}: nothing slips at any level, so that there is nothing to "
            "reduce; set up_to higher, or run 'full' alone"
        )
    modes = MANY_MODES if isinstance(options.modes, str) else options.modes
    beyond = 2 if isinstance(options.interface_modes, str) else options.interface_modes
    stuck = Stuck(system.closed()).modes(curve.mode + beyond)[1]
    u, v = curve.states, curve.loops
    if system.contact.opens:
        stuck, force = system.contact.normal.closed_motions() @ stuck, system.M @ curve.shape
        system = elastic(system)
        u, v, rigid = _states_of_cycles(system, force, curve.level[evenly(curve.level.size, 3)])
        stuck = orthonormal(np.hstack([stuck, rigid]), system.M)
    slips = np.vstack([u, v])
    slips = slips - (slips @ (system.M @ stuck)) @ stuck.T
    size = np.sqrt(np.maximum(np.einsum("ij,ij->i", slips, (system.K @ slips.T).T), 0.0))
    counting = size > _LEAST_SINGULAR * size.max()
    slips = slips[counting] / size[counting, np.newaxis]
    proper = proper_decomposition(slips, strain_norm(system))
    V = np.hstack([stuck, proper.modes[:, :modes]])
    slip_peak = system.contact.slip_norm((system.contact.B @ u.T).T).max(axis=0)
    velocity = 2.0 * np.pi * curve.stuck_frequency * float(slip_peak.max())
    return basis_of(
        system, V, modes, proper, u=u, v=slips, slip_peak=slip_peak, slip_velocity=velocity
    )


def _states_of_cycles(
    system: System, force: FloatArray, level: FloatArray
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
    path = QuasiStatic(system, TOLERANCE)
    states = path.follow(np.concatenate(shares)[:, np.newaxis] * force)
    return states, np.diff(states, axis=0, prepend=0.0), path.to.outer(path.rigid.T).T
