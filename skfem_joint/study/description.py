"""Facts about a structure, and its response to its loads, statically and with stuck joints.

The vibration of the structure with stuck joints is the sum of its lowest modes, integrated exactly
for loads that are linear between the time steps, and of the static response of all other modes. At
the time of its largest strain energy the loads and the inertia together are the forces that the
joints have to carry. `skfem_joint.results.gross_slip` gives the multiple of them at which the
first joint slips as a whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from skfem_joint.ground.arrays import FloatArray, IntArray, Matrix
from skfem_joint.ground.errors import JointError
from skfem_joint.joint.doubts import per_wavelength
from skfem_joint.joint.pressure import PressureTable
from skfem_joint.linalg import shifts
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.shifts import shifted
from skfem_joint.reduction.models import TO_STEADY, run_to_come
from skfem_joint.results.contact_mesh import coarse_contact, judged
from skfem_joint.results.gross_slip import gross_slip_level
from skfem_joint.results.natural_modes import NaturalModes, natural_modes
from skfem_joint.results.normal_force import NormalChange
from skfem_joint.runs.resolution import unfit_times
from skfem_joint.scene import Scene
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.stepping.arrangement import Arranged
from skfem_joint.stepping.plan import Plan
from skfem_joint.structure.load import Load
from skfem_joint.structure.model import AnyStructure
from skfem_joint.study.models import UNKNOWN_CHANGE, largest_model, plan_of
from skfem_joint.system import modes
from skfem_joint.system.modal_response import modal_response
from skfem_joint.system.system import System

#: Frequencies that are shown.
_SHOWN = 3


#: How the loads over the limit depend on the mesh, measured on a lap of two plates of 10 mm seen
#: from the side with 1, 2, 4 and 8 elements for each 20 mm: linear ones where it was pulled,
#: quadratic ones where it was bent.
OF_THE_MESH = (
    " A finer mesh of the contact may raise this: on four meshes of one lap, each of half the "
    "size, it was 79, 82, 84 and 84 % where that was pulled, and 0.5, 1, 2 and 4 % where it was "
    "bent, so that few nodes carried the load."
)


@dataclass
class Description:
    """What a structure is, and its response to static loads, in whole sentences and in numbers.

    Attributes
    ----------
    facts, doubts : list of str
        Facts about the structure, and reasons to doubt that it is what was meant.
    values : dict of str
        Its figures by name, as in ``summary.json``.
    """

    facts: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)


def describe(
    structure: AnyStructure,
    loads: Sequence[Load],
    duration: float | None = None,
    *,
    quasi_static: bool = False,
) -> Description:
    """Describe a structure, and its response to the peaks of its loads.

    It is what ``skfem-joint check`` prints beside the notes of the structure's system. It takes
    quasi-static solves and a few modes: seconds for plates, milliseconds for bars. What cannot be
    computed is among the doubts.

    Parameters
    ----------
    structure : Structure
        Given by a mesh or by matrices.
    loads : sequence of Load
    duration : float, optional
        Of the run to come, s. If it is not given, loads that repeat are taken to last until the
        vibration is steady; others need it.
    quasi_static : bool
        Whether the loads change slowly, without vibration.

    Returns
    -------
    Description
        Facts and doubts in sentences, and figures by name.

    Raises
    ------
    InputError
        For loads that do not fit the structure, or that need a duration.
    """
    system = structure.system(loads, quasi_static=quasi_static)
    plan = run_to_come(system, duration, quasi_static=quasi_static)
    return _described(structure, system, loads, plan)


def description_of(
    scene: Scene, path: QuasiStatic | None = None, model: System | None = None
) -> Description:
    """Describe a scene; see `describe`.

    ``path`` is a quasi-static path of its system, whose factors are used; it is created here if it
    is needed and not given. Not for contact that opens, which is described as it is closed.
    ``model`` is its `largest_model`, if that exists already.
    """
    model = largest_model(scene) if model is None else model
    return _described(scene.structure(), model, scene.loads(), plan_of(scene), path)


def _described(
    structure: AnyStructure,
    system: System,
    loads: Sequence[Load],
    plan: Plan,
    path: QuasiStatic | None = None,
) -> Description:
    """Describe a structure with its system under loads, for a run by a plan."""
    system = system.closed()
    draft = Description()
    draft.facts.extend(made_of(structure))
    if structure.body is not None:
        size, mass = np.ptp(structure.body.positions, axis=0), structure.body.total_mass
        draft.values |= {"mass_kg": mass, "length_m": float(size.max())}
    opens = [patch.joint.name for patch in structure.patches if patch.joint.opens]
    if opens:
        draft.facts.append(
            f"Contact that opens ({', '.join(opens)}): frequencies and responses below are those "
            "with the contact closed where it is pressed at rest, and with the normal forces there."
        )
    _mesh(structure, draft)
    still = [load.on for load in system.loads if load.amplitude.peak_value == 0.0]
    draft.doubts += [f"The load on {on!r} is zero at all times." for on in still]
    draft.doubts += unfit_times(system, plan)
    try:
        _moves(structure, system, loads, plan, path, draft)
    except (JointError, RuntimeError, np.linalg.LinAlgError) as error:
        draft.doubts.append(
            f"What the structure does under its loads at rest is not known: {error}"
        )
    return draft


def made_of(structure: AnyStructure) -> Iterator[str]:
    """Sentences about a structure's bodies, joints, preload, mass and size."""
    yield structure.overview()
    for patch in structure.patches:
        joint = patch.joint
        against = f" against {joint.against}" if joint.against else ""
        text = (
            f"Joint {joint.name}{against}: {patch.points.size} contact points, clamp force "
            f"{patch.clamping_force:.6g} N, friction limit of the points that can slip "
            f"{joint.friction * patch.normal_force.sum():.6g} N."
        )
        if np.isfinite(joint.tangential_stiffness):
            text += (
                f" Its tangential stiffness of {joint.tangential_stiffness:.6g} Pa/m adds up to "
                f"{patch.stiffness[np.isfinite(patch.stiffness)].sum():.6g} N/m at these points."
            )
        body = structure.body
        if isinstance(joint.pressure, PressureTable) and patch.nodes.size and body is not None:
            along = joint.pressure.along(body.nodes[patch.nodes])
            first = patch.nodes[along.argmin()]
            place = ", ".join(f"{x:.6g}" for x in body.positions[first])
            text += f" Position {along.min():.6g} m of its pressures is at ({place}) m."
        yield text
    yield from structure.at_rest()
    if structure.body is not None:
        size, mass = np.ptp(structure.body.positions, axis=0), structure.body.total_mass
        extent = " x ".join(f"{x:.4g}" for x in size if x > 0.0)
        yield f"Mass {mass:.4g} kg, extent {extent} m."


def _moves(
    structure: AnyStructure,
    system: System,
    loads: Sequence[Load],
    plan: Plan,
    path: QuasiStatic | None,
    draft: Description,
) -> None:
    """Add frequencies, waves, static displacement, strain, and how much of the joints' limit."""
    values, no_unknowns = draft.values, np.zeros(0, np.intp)
    acting = np.flatnonzero(system.contact.on_rows(system.contact.w) > 0.0)
    rigid_friction = np.flatnonzero(
        system.contact.on_rows((system.contact.w > 0.0) & ~system.contact.sprung)
    )
    held = sparse.csr_array(system.contact.B).indices[rigid_friction]
    floats, stuck = _frequencies(structure, system, acting.size > 0, draft)
    frequency = max((load.amplitude.highest_frequency or 0.0 for load in system.loads), default=0.0)
    slow = plan.quasi_static
    draft.doubts += () if slow else _heavy_damping(system, stuck)
    if frequency > 0.0 and structure.body is not None and not slow:
        speed, count = per_wavelength(structure.body, frequency)
        values |= {"wave_speed_m_per_s": speed, "elements_per_wavelength": count}
        draft.facts.append(
            f"The slowest wave travels at {speed:.4g} m/s: {count:.3g} elements in its length at "
            f"{frequency:.5g} Hz, the highest frequency of the loads."
        )
    if floats and (structure.free or structure.body is None):
        draft.facts.append(
            "The structure floats, so that loads at rest are not compared with what makes a joint "
            "slip: they would move all of it away."
        )
        return
    vibration = _forces(plan, system, held, stuck)
    static, dynamic, amplified = vibration.static, vibration.dynamic, vibration.amplified
    if not system.loads or not np.any(static):
        return
    if not acting.size:
        _displaced(structure, system, _solve(system, static, no_unknowns), draft)
        return
    _normal(structure, system, loads, vibration, slow, draft)
    path = path or QuasiStatic(system)
    to = path.to
    path = path.afresh(Arranged(to.system, to.kind))  # in the unknowns that are stepped
    _displaced(structure, system, to.outer(path.follow(to.force(static)[np.newaxis])[0]), draft)
    force = to.force(dynamic)
    stuck_under_it = to.inner(vibration.follows @ vibration.most)
    level = gross_slip_level(path, force, stuck_under_it, path.limit(force))
    share = 1.0 / level
    if share < 1.0 and judged(structure):
        moved = path.afresh(path.to).follow(force[np.newaxis])[0]
        draft.doubts += coarse_contact(structure, path.to.system, moved)
    values |= {
        "friction_limit_N": float(system.contact.w.sum()),
        "amplification": amplified,
        "load_over_limit": share,
    }
    inertia = "" if amplified is None else f", amplified by {amplified:.4g} as the joints stick"
    draft.facts.append(
        f"The loads at their peak{inertia} come to {100.0 * share:.3g} % of what makes the first "
        f"joint slip as a whole; the friction limits add up to {system.contact.w.sum():.6g} N."
        + (OF_THE_MESH if structure.body is not None else "")
    )
    if share > 1.0:
        moved = "" if slow else " with what they set in motion"
        draft.doubts.append(
            f"The loads{moved} come to {share:.3g} times what makes the "
            "first joint slip as a whole."
        )


def _frequencies(
    structure: AnyStructure, system: System, rubs: bool, draft: Description
) -> tuple[bool, NaturalModes]:
    """Add natural frequencies, and whether the structure floats, which is returned with the modes.

    The modes are those with the joints stuck; ``rubs`` is whether a joint carries friction.
    """
    values = draft.values
    both = [natural_modes(system, modes.SEARCHED, joints=joints) for joints in ("loose", "stuck")]
    rigid, (loose, stuck) = [m.rigid_motions for m in both], [m.straining for m in both]
    values["frequencies_stuck_Hz"] = stuck.frequencies[:_SHOWN].tolist()
    values["frequencies_loose_Hz"] = loose.frequencies[:_SHOWN].tolist()
    text = f"First natural frequencies beside rigid motions: {_listed(loose.frequencies)}"
    if rubs:
        number, likeness = alike(system.M, stuck.modes[:, :_SHOWN], loose.modes)
        values["stuck_modes_like_loose"] = (number + 1).tolist()
        values["stuck_modes_like_loose_share"] = likeness.tolist()
        text += f" with the joints loose, {_listed(stuck.frequencies)} with the joints stuck"
        text += _compared(number, likeness)
    draft.facts.append(f"{text}.")
    values |= {"rigid_motions_loose": rigid[0], "rigid_motions_stuck": rigid[1]}
    if structure.body is None:
        draft.facts.append(
            f"Rigid motions: {rigid[0]} with the joints loose, {rigid[1]} as they stick."
        )
    if rigid[1]:
        opens = any(patch.joint.opens for patch in structure.patches)
        cure = "Is something to be fixed, or do joints lack pressure or pairs?"
        if opens:
            cure = "Contact that opens holds it only while it is closed by the loads."
        if not structure.free:
            draft.doubts.append(
                f"Nothing holds {rigid[1]} rigid motions, joints and supports included: the "
                f"structure floats. {cure}"
            )
    return rigid[1] > 0, stuck


def _heavy_damping(system: System, stuck: NaturalModes) -> Iterator[str]:
    """Sentence about damping that was probably given in another unit."""
    if stuck.frequencies.size:
        first = stuck.modes[:, 0]
        ratio = float(first @ (system.C @ first)) / (4.0 * np.pi * stuck.frequencies[0])
        if ratio > 0.5:  # that of structures is below 0.1
            yield (
                f"Damping has {ratio:.3g} of the critical one in the first mode with the joints "
                "stuck: is damping.stiffness in s, and damping.mass in 1/s? A share is a ratio."
            )


def _mesh(structure: AnyStructure, draft: Description) -> None:
    """Add how much too high the mesh of first order makes the first frequencies."""
    found = structure.mesh_error, structure.loose_mesh_error
    both = {error.joints: error for error in found if error and error.frequencies.size}
    if not both:
        return
    known = [error for error in both.values() if error.is_known]
    largest = 100.0 * max((error.largest for error in known), default=np.nan)
    draft.values["mesh"] = {"frequency_error_percent": largest if known else None}
    parts = ["How much too high the mesh makes the first frequencies is not known"]
    if known:
        parts = [f"The mesh makes the first frequencies up to {largest:.2g} % too high"]
    for joints, error in both.items():
        draft.values["mesh"][joints] = {
            "frequency_error_percent": (100.0 * error.shares).tolist(),
            "frequencies_Hz": error.frequencies.tolist(),
            "frequencies_of_second_order_Hz": error.better.tolist(),
        }
        if error.is_known:
            count = error.frequencies.size
            parts.append(
                f"with the joints {joints} they are {_listed(error.frequencies, count)} and "
                f"{_listed(error.better, count)} with middles of edges added, straight in joints "
                "and supports"
            )
        elif known:
            parts.append(f"by how much those with the joints {joints} are is not known")
    draft.facts.append(f"{'; '.join(parts)}.")


def _normal(
    structure: AnyStructure,
    system: System,
    loads: Sequence[Load],
    vibration: _Vibration,
    slow: bool,
    draft: Description,
) -> None:
    """Add by how much loads or vibration of the stuck structure change the normal forces."""
    if any(patch.joint.opens for patch in structure.patches):
        return  # whose normal forces may change
    if isinstance(system.T, LinearOperator):
        draft.doubts.append(UNKNOWN_CHANGE)
        return
    acts = structure.reactions(loads)
    if acts is None:
        return
    change = acts.K @ vibration.follows
    change -= np.hstack([acts.F, acts.M @ vibration.inertia])
    most = np.zeros(acts.force.size)
    for some in np.array_split(vibration.history, 1 + vibration.history.shape[1] // 256, axis=1):
        np.maximum(most, np.abs(change @ some).max(axis=1), out=most)
    found = NormalChange.of(structure, acts, most)
    draft.values["normal_force_change"] = found.share
    what, changes = "Vibration of the stuck structure", "changes"
    if slow:
        what, changes = "The loads on the stuck structure", "change"
    draft.values["normal_force_change_mean"] = found.mean
    draft.facts.append(f"{what} {changes} the normal force by {found.text}. {found.of_the_mesh}")
    draft.doubts.extend(found.doubts(what=what))


def _displaced(structure: AnyStructure, system: System, u: FloatArray, draft: Description) -> None:
    """Add what is displaced and strained under static loads, and whether that is small."""
    moved = np.abs(np.asarray(system.P @ u))
    names = dict.fromkeys(load.on for load in system.loads)
    by_load = {name: float(moved[system.points.index(name)]) for name in names}
    draft.values["static_displacement_m"] = by_load
    body = structure.body
    if body is None:
        shown = ", ".join(f"{name} {x:.4g} m" for name, x in by_load.items())
        draft.facts.append(f"Under the peak of the loads at rest: {shown}.")
        return
    length, full = draft.values["length_m"], body.unpacked(system.expand(u))
    largest, slope = float(np.linalg.norm(full, axis=1).max()), body.gradient(full)
    strains = 0.5 * (slope + slope.swapaxes(1, 2))  # means of the elements
    strain = float(np.linalg.norm(strains, axis=(1, 2)).max())
    draft.values["static_strain"] = strain
    shown = ", ".join(f"{name} {x:.4g} m ({x / length:.2g} of it)" for name, x in by_load.items())
    draft.facts.append(
        f"Under the peak of the loads at rest, over the length of {length:.4g} m: {shown}; largest "
        f"strain {strain:.2g}."
    )
    cure = "are loads, stiffness, section and supports right?"
    # Displacement over the structure's length that is not small.
    if largest > 0.1 * length:
        draft.doubts.append(
            f"The loads at rest move the structure by {largest:.3g} m, more than a tenth of its "
            f"{length:.3g} m: {cure}"
        )
    # Strain that is not small.
    if strain > 0.01:
        draft.doubts.append(
            f"The loads at rest strain the structure by {100.0 * strain:.3g} %, more than metals "
            f"bear elastically: {cure}"
        )


@dataclass(frozen=True)
class _Vibration:
    """Vibration of the stuck structure under its loads.

    Attributes
    ----------
    static : ndarray, shape (n,)
        Loads at the time at which they strain the structure most at rest, N.
    dynamic : ndarray, shape (n,)
        Loads with inertia at the time at which both together strain it most, N.
    amplified : float, optional
        Root of the second strain energy over the first; None where nothing is strained.
    follows : ndarray, shape (n, k)
        Displacements under unit loads at rest, and modes.
    inertia : ndarray, shape (n, modes)
        Deceleration of each mode, m/s2.
    history : ndarray, shape (k, times)
        Amplitudes of ``follows``.
    most : ndarray, shape (k,)
        The same at the time of the largest strain.
    """

    static: FloatArray
    dynamic: FloatArray
    amplified: float | None
    follows: FloatArray
    inertia: FloatArray
    history: FloatArray
    most: FloatArray


def _forces(plan: Plan, system: System, held: Any, modes: NaturalModes) -> _Vibration:
    """Vibration of the stuck structure, from rest."""
    F, frequency, shapes = system.load_vectors(), modes.frequencies, modes.modes
    # Most steps for which the vibration of the stuck structure is computed.
    steps = min(plan.n_steps * (TO_STEADY if plan.until == "steady" else 1), 5_000)
    h = plan.step
    amplitudes = system.load_amplitudes(h * np.arange(steps + 1.0))
    follow = _solve(system, F, held) if F.size else F
    omega, participation = 2.0 * np.pi * frequency, shapes.T @ F
    damping = np.einsum("ij,ij->j", shapes, system.C @ shapes)
    modal = participation @ amplitudes
    # What each mode moves beyond following its force at once.
    extra = np.zeros_like(modal)
    if not plan.quasi_static:
        extra = modal_response(omega, damping, modal, h) - modal / omega[:, np.newaxis] ** 2
    both = np.hstack([follow, shapes])
    x = np.vstack([amplitudes, extra])
    G, k = both.T @ (system.stuck_stiffness @ both), len(amplitudes)
    energy = np.einsum("it,ij,jt->t", x, G, x)
    at_rest = np.einsum("it,ij,jt->t", amplitudes, G[:k, :k], amplitudes)
    strains = at_rest.max(initial=0.0) > 0.0
    first, then = (at_rest, energy) if strains else 2 * [(amplitudes**2).sum(axis=0)]
    most = x[:, int(then.argmax())]
    static = F @ amplitudes[:, int(first.argmax())]
    inertia = shapes * omega**2
    dynamic = F @ most[:k] + system.M @ (inertia @ most[k:])
    amplifies = strains and not plan.quasi_static
    amplified = float(np.sqrt(energy.max() / at_rest.max())) if amplifies else None
    return _Vibration(static, dynamic, amplified, both, inertia, x, most)


#: Share of the displacement that the last of repeated solves may change, and the share of the
#: change before above which they lead nowhere.
_SMALL, _FALLING = 1e-3, 0.9


def _solve(system: System, force: FloatArray, held: Any) -> FloatArray:
    """Static displacements, m, with some unknowns held, and sliders on springs.

    Rigid motions are held a little: some may be left where joints stick. Repeated solves take the
    little hold away from what strains the structure, however slender it is, where no rigid motion
    is loaded.

    Of a force (n,), N, or of each column of them.
    """
    free = np.setdiff1d(np.arange(system.n), held)
    u = np.zeros(force.shape)
    if free.size:
        K, M = (sparse.csr_array(A)[free][:, free] for A in (system.stuck_stiffness, system.M))
        solve, f = factorised(shifted(K, M, shifts.LEAST)), force[free]
        x = last = solve(f)
        while np.abs(last).max() > _SMALL * np.abs(x).max():
            change = solve(f - K @ x)
            if np.abs(change).max() > _FALLING * np.abs(last).max():  # a rigid motion is loaded
                x = factorised(shifted(K, M))(f)
                break
            x, last = x + change, change
        u[free] = x
    return u


def alike(M: Matrix, modes: FloatArray, others: FloatArray) -> tuple[IntArray, FloatArray]:
    """Which of other modes is most like each mode, and the share of kinetic energy that it has.

    ``modes`` (n, k) and ``others`` (n, j) are of unit mass; the share is the modal assurance
    criterion ``(phi^T M psi)^2``. Returns numbers (k,) from 0 and shares (k,); none without others.
    """
    if not others.shape[1] or not modes.shape[1]:
        return np.zeros(0, dtype=np.intp), np.zeros(0)
    shares = (others.T @ (M @ modes)) ** 2
    number = shares.argmax(axis=0)
    return number, shares[number, np.arange(number.size)]


def _compared(number: IntArray, share: FloatArray) -> str:
    """Sentence about which loose mode each stuck mode resembles."""
    if not number.size:
        return ""
    # Share of kinetic energy from which on a mode with stuck joints resembles a mode with loose
    # ones.
    words = [
        f"loose mode {k + 1} ({100.0 * x:.0f} % alike)"
        if x >= 0.5
        else f"none of the loose modes (most like {k + 1}, {100.0 * x:.2g} %)"
        for k, x in zip(number.tolist(), share.tolist(), strict=True)
    ]
    return f". By their shapes those with the joints stuck are {', '.join(words)}"


def _listed(frequencies: FloatArray, most: int = _SHOWN) -> str:
    return ", ".join(f"{f:.5g}" for f in frequencies[:most]) + " Hz" if frequencies.size else "none"
