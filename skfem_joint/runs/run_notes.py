"""What to beware of in a run, in whole sentences: its `Run.notes`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import as_dense
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.runs.last_cycle import ROUND_OFF, peaks, steady_state
from skfem_joint.runs.resolution import unfit_times
from skfem_joint.stepping.arrangement import picks_unknowns, slips_are_unknowns
from skfem_joint.stepping.loops import Loops
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system.contacts import Contact

#: What elastic contact that gains energy is, and what helps.
_ELASTIC = (
    "elastic contact (normal_stiffness, or of a reduced model) that opens or closes is faster than "
    "they follow. Take a shorter step, or rigid contact in a full or condensed model: its impacts "
    "cannot add energy."
)
#: Difference of a joint's loop from its energy, over this; share of its friction limit that its
#: loop leaves out.
_APART = 0.01
#: Share of the largest slip of a joint up to which its points stick, the same in reduced models, in
#: which such points move a little, and share of its friction limit that may stick while it slips as
#: a whole: points near a support slip little. (Of a bar that is held at its end and loaded by 1.05
#: of its friction limit 4 % slip less than that.)
_STILL, _STILL_IN_FEW, _HELD = 0.005, 0.01, 0.05


def notes_of_run(run: Run, plan: Plan) -> Iterator[str]:
    """Sentences about a run by a plan.

    They are about times of loads that do not fit the run, joints that slip as a whole, steady
    vibration, loops, cycles that are not steady, and energy.
    """
    yield from unfit_times(run.system, plan)
    yield from _of_gross_slip(run, plan)
    if run.steady is not None:
        yield from run.steady.notes
        yield from _free_offset(run)
    state = steady_state(run)
    if run.loops is not None:
        yield from _of_loops(run, run.loops)
    elif state is not None and not state.reached:
        yield (
            "The run has not reached a steady state: the last cycle differs by "
            f"{100 * state.energy_change:.2g} % in energy and {100 * state.peak_change:.2g} % in "
            "peaks from the one before. Energies and peaks per cycle are those of the last cycle. "
            "For the steady state give more cycles, or time.until = 'steady' in place of cycles."
        )
    yield from wrong_energy(run)


def _of_gross_slip(run: Run, plan: Plan) -> Iterator[str]:
    """Sentences about joints that slip as a whole: hardly any of their points stick throughout.

    Where contact opens points move without friction, too: slip is what friction works on. None of
    a model for a range, which has bounds of slip itself.
    """
    system, contact = run.system, run.system.contact
    if system.serves is not None:
        return
    slip = np.minimum(run.slider_peak, contact.slid(run.friction_work))
    period = plan.step * (plan.cycle_steps or plan.n_steps)
    still = _STILL if slips_are_unknowns(system) else _STILL_IN_FEW
    # The paper's models have no points where nothing slipped.
    full = None if system.origin is None else system.origin.system.contact
    fewer = full is not None and contact.count < full.count
    for name, limits in zip(contact.joints, contact.limits_by_joint, strict=True):
        moves, whole = slip > still * slip[limits > 0.0].max(initial=0.0), limits.sum()
        if full is not None and fewer:
            whole = max(whole, full.limits_by_joint[full.joints.index(name)].sum())
        enough = whole * (1.0 - _HELD)
        # What slips, and does not creep, is looked at where nearly all moves: that takes longer.
        if (
            0.0 < enough <= limits[moves].sum()
            and enough <= limits[moves & system.slipping(slip, period)].sum()
        ):
            yield (
                f"Nearly every point of joint '{name}' slips: gross slip. The results hold, but "
                "reduced models and damping curves, which build on a part of the joint that "
                "sticks, lose their ground."
            )


def wrong_energy(run: Run) -> Iterator[str]:
    """Sentences about energy that steps add, and about a balance of energy that is open."""
    # Residual of the energy balance over the energy that was converted.
    if np.any(peaks(run) > 0.0) and run.energy_residual > 1e-8:
        yield (
            f"The run has an energy balance that is open by {run.energy_residual:.2g} of the "
            "energy in play."
        )
    # Energy that the steps of elastic contact may add, over the energy in play: of steady vibration
    # over the work of a period, which is what it loses.
    whole, share, name = run.in_play, 1e-3, "energy in play"
    if run.steady is not None:
        whole, share, name = _work(run), 1e-2, "work of a period"
    if (gained := _gained(run)) > share * whole:
        yield (
            f"The run gained {gained:.3g} J by its time steps, {100.0 * gained / whole:.2g} % of "
            f"the {name}: {_ELASTIC}"
        )


def checked(run: Run) -> Run:
    """Run itself; ConvergenceError if its steps added more energy than it has otherwise.

    That is the work of its loads. In a run from a given state it is also what was stored there, and
    what each pressure point stored at most beyond rest, (p - p0)^2 / (2 k), by which loads that
    take back what they gave are judged. Steady vibration may owe what it stores to its steps.
    """
    contact, energy = run.system.contact.normal, _work(run)
    if run.steady is None:
        peak, least = run.normal_force_peak, run.normal_force_least
        moved = np.maximum(peak - contact.force, contact.force - least)
        energy += run.stored_energy[0] + float((moved**2 / (2.0 * contact.stiffness)).sum())
    if (gained := _gained(run)) > max(energy, 1e-3 * run.in_play) and not run.interrupted:
        raise ConvergenceError(
            f"the time steps added {gained:.3g} J to a run whose loads did a work of "
            f"{_work(run):.3g} J: {_ELASTIC}"
        )
    return run


def _gained(run: Run) -> float:
    """Energy that steps of elastic contact added, J; a search for steady vibration leaves some."""
    start, end = run.stored_energy
    left = ROUND_OFF * run.in_play + (abs(end - start) if run.steady else 0.0)
    return 0.0 if run.system.contact.normal.rigid.all() else -run.scheme_work - left


def _work(run: Run) -> float:
    """Work of all loads over a run, J, whatever its sign."""
    return float(np.abs(run.input_work).sum())


def _free_offset(run: Run) -> Iterator[str]:
    """Sentence about steady vibration whose offset depends on how it began."""
    steady = run.steady
    if steady is None or not steady.unstrained:
        return
    size, most = np.abs(steady.drift), int(np.abs(steady.drift).argmax()) if run.peak.size else 0
    # Drift in a period over the amplitude.
    if size.size and size[most] > 1e-3 * steady.amplitude.max():
        yield (
            f"The run drifts: '{run.system.points[most]}' goes on by "
            f"{steady.drift[most]:.3g} m in each period, for under this load neither a support nor "
            "friction holds it. It has a steady velocity and no steady displacement: amplitudes "
            "are those about its drift, offsets and peaks those of one period."
        )
        return
    yield (
        "The run is of what friction alone holds and no support does: amplitudes (half of "
        "peak to peak) are those of its steady vibration, but its offset depends on how that "
        "began. The offsets and peaks given are those of vibration about the place without strain "
        "under loads that change their sign every half period, else from the place of the start; "
        "to follow the transient to its own offset give cycles in place of until = 'steady'."
    )


def _of_loops(run: Run, loops: Loops) -> Iterator[str]:
    """Sentences about loops that are open, or whose area is not the energy."""
    gap, contact = loops.opening, run.system.contact
    # Gap of the last cycle of a quasi-static run over its width.
    if gap is not None and gap > 2e-3:
        yield (
            f"The run ends with a cycle that is not closed, {100 * gap:.2g} % of its "
            "width away from its start. The first cycle, from rest, never is; energies and "
            "stiffnesses per cycle are those of the last one. Give more cycles."
        )
    dense = run.system.is_dense and not picks_unknowns(contact.B)
    for joint in _without_sliding(contact, loops) if dense else ():
        yield (
            f"The friction force of joint '{joint}' and its stiffness are sure only where it slips "
            "as a whole: the modes of this model lack the sliding of the whole joint. Make it for "
            "such runs, by sj.reduce(..., quasi_static=True)."
        )
    merged = contact.shares is not None and (
        np.diff(sparse.csr_array(contact.shares).indptr).max(initial=0) > 1
    )
    for joint, area, energy, covered in zip(
        contact.joints, loops.area, loops.energy, loops.covered, strict=True
    ):
        if covered < 1.0 - _APART:
            yield (
                f"The loop of joint '{joint}' leaves out points with {100 * (1 - covered):.2g} % "
                "of its friction limit, which supports leave only one direction of slip: they "
                "count in its energy alone."
            )
        counts = energy > 1e-9 * run.in_play  # and is no round-off
        if counts and abs(area - energy) > _APART * energy and not merged:
            yield (
                f"The points of joint '{joint}' slip by different amounts: the loop of its force "
                f"over its mean slip has an area of {area:.3g} J, its friction takes "
                f"{energy:.3g} J, the sum over its points. The energy is exact, the area is not."
            )


def _without_sliding(contact: Contact, loops: Loops) -> Iterator[str]:
    """Joints whose sum of rigid friction forces does no work in any motion of a dense system.

    It does in the one in which all points of the joint slip along its direction and others stick.
    """
    rigid = contact.on_rows(contact.rubs & ~contact.sprung)
    component = np.arange(rigid.size) - contact.on_rows(contact.first_row[:-1])
    B = as_dense(contact.B)[rigid]
    for joint, shares, along in zip(
        contact.joints, as_dense(contact.J), loops.direction, strict=True
    ):
        slips = (contact.on_rows(shares) * along[component])[rigid]
        missed = slips - B @ np.linalg.lstsq(B, slips)[0]
        if np.linalg.norm(missed) > 1e-6 * np.linalg.norm(slips):  # far above round-off
            yield joint
