"""Where a basis comes from: the static slip path, a run of the full model, or slips beside modes.

Joint modes are proper orthogonal modes of its snapshots. Beside them stand static responses to the
loads, fixed-interface modes, and rigid motions that friction alone holds and does not hold. (The
paper's scaled modes have a folder of their own, `skfem_joint.reduction.scaled`.)
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.reduction import basis as bases
from skfem_joint.reduction import static_path
from skfem_joint.reduction.basis import Basis, Options, basis_of
from skfem_joint.reduction.elastic_contact import check_reference, elastic, strain_norm
from skfem_joint.reduction.excitation import SHORT_RUNS
from skfem_joint.reduction.interface_modes import SETTINGS, RestrictedMotion, beside, driven
from skfem_joint.reduction.joint_slides import joint_slides
from skfem_joint.reduction.pod import proper_decomposition, proper_modes, stride_of, thinned
from skfem_joint.reduction.static_path import StaticPath, slip_path
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.system.system import System

if TYPE_CHECKING:
    from skfem_joint.slow.quasi_static import QuasiStatic

#: Singular values below this share of the largest are what the tolerance of paths leaves.
_LEAST_SINGULAR = 1e-7


def make_basis(
    system: System,
    options: Options,
    plan: Plan,
    *,
    enriched: bool = False,
    path: QuasiStatic | None = None,
) -> Basis:
    """Basis of a system by its options; makes the path or run that it needs.

    Parameters
    ----------
    system : System
    options : Options
        With the reference "static" or "self".
    plan : Plan
        Steps of the run to come.
    enriched : bool
        Whether the basis gets more vectors before it is used: then it is not refused if it misses
        too much.
    path : QuasiStatic, optional
        A quasi-static path of the system, whose factors are used.

    Returns
    -------
    Basis
        Its ``notes`` say what to beware of.

    Raises
    ------
    InputError
        If nothing moves, the modes do not fit, or the basis misses too much.
    KeyboardInterrupt
        If a run is interrupted.
    """
    notes: list[str] = []
    system = elastic(system)
    check_reference(system, options.reference)
    modes, interface = options.mode_count, options.interface_modes
    if options.reference == "self":
        cycles = plan if plan.cycle_steps is None else plan.first(SHORT_RUNS.training_cycles)
        training = replace(cycles, save=Save(fields=True, points=False), cycle_steps=None)
        try:
            run = integrate_plan(system, training).finished()
        except ConvergenceError as error:  # without the states of this run, which is no result
            raise ConvergenceError(str(error), error.unknown) from error
        decomposed = {"snapshots": options.snapshots, "inner_product": options.product}
        basis = own_basis(system, run, modes, interface_modes=interface, **decomposed)
    elif options.reference == "static":
        slipped = slip_path(system, plan, modes, path)
        new = slipped.newly_slipping
        if new > static_path.SETTINGS.newly_slipping:
            notes.append(
                f"The slip went on growing while the modes were made: {100 * new:.2g} % "
                "of what slips at last stuck in the round before. Use more modes and see whether "
                "the result stays, or take reference = 'self'."
            )
        basis = static_basis(system, slipped, modes, interface)
    else:
        raise InputError(
            f"reduction.reference: found {options.reference!r}, must be 'static', 'self' or 'paper'"
        )
    return basis.judged(options, notes, enriched)


def own_basis(
    system: System,
    run: Run,
    modes: int,
    *,
    snapshots: str = "both",
    inner_product: str = "energy",
    interface_modes: str | int = "auto",
) -> Basis:
    """Proper orthogonal modes of a system's own run with stored fields, of at most 300 times.

    Parameters
    ----------
    system : System
    run : Run
    modes : int
    snapshots, inner_product : str
        See `skfem_joint.reduction.pod`.
    interface_modes : "auto" or int
        Fixed-interface modes beside them, the lowest; "auto": none.

    Raises
    ------
    InputError
        If nothing moves in the run, or its snapshots make fewer modes than asked for.
    """
    every = stride_of(len(run.u), bases.SETTINGS.most_times)
    proper = proper_modes(run, snapshots=snapshots, inner_product=inner_product, every=every)
    if not 1 <= modes <= proper.modes.shape[1]:
        raise InputError(
            f"reduction.modes: found {modes}, must be from 1 to {proper.modes.shape[1]}, which "
            "the snapshots of the run can make"
        )
    V = proper.modes[:, :modes]
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
    automatic = max(SETTINGS.few_beside, modes // SETTINGS.modes_for_one)
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
        thinned(x, bases.SETTINGS.most_times) @ basis.history.velocities for x in (run.u, run.v)
    )
    history = replace(
        basis.history, velocities=velocities, displacements=displacements, resolved=1e-5
    )
    return replace(basis, history=history, stiffness=path.stiffness)


def stuck_basis(
    system: System, stuck: FloatArray, u: FloatArray, v: FloatArray, modes: int, frequency: float
) -> Basis:
    """Modes with the contact stuck, and proper orthogonal modes of what slips beside them.

    Parameters
    ----------
    system : System
    stuck : ndarray, shape (n, k)
        Modes with the contact stuck, orthonormal in mass.
    u, v : ndarray, shape (levels, n)
        States and their increments, m. Each counts as much as the others, however far it slips;
        points that slip alike in the increments may be merged.
    modes : int
        Number of proper orthogonal modes.
    frequency : float
        Highest frequency of the slips, Hz.
    """
    slips = np.vstack([u, v])
    slips = slips - (slips @ (system.M @ stuck)) @ stuck.T
    size = np.sqrt(np.maximum(np.einsum("ij,ij->i", slips, (system.K @ slips.T).T), 0.0))
    counting = size > _LEAST_SINGULAR * size.max()
    slips = slips[counting] / size[counting, np.newaxis]
    proper = proper_decomposition(slips, strain_norm(system))
    V = np.hstack([stuck, proper.modes[:, :modes]])
    slip_peak = system.contact.slip_norm((system.contact.B @ u.T).T).max(axis=0)
    velocity = 2.0 * np.pi * frequency * float(slip_peak.max())
    return basis_of(
        system, V, modes, proper, u=u, v=slips, slip_peak=slip_peak, slip_velocity=velocity
    )
