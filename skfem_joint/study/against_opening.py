"""How far constant normal forces err, by a slow cycle of the loads with contact that opens.

Both kinds of contact are condensed and followed through two cycles of the loads without inertia, in
phase, from the amplitudes at which they are largest together. The second cycles are compared: the
first one, from rest, is like no other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.loads import Harmonic
from skfem_joint.reduction.condensed import condense
from skfem_joint.results.normal_force import LARGE
from skfem_joint.runs.integrate import quasi_static
from skfem_joint.scene import Scene
from skfem_joint.stepping.recording import Run
from skfem_joint.structure.structure import Structure
from skfem_joint.system.system import System

#: Most contact unknowns, slips and approaches, and most unknowns of the full model: condensing and
#: following as many takes some seconds.
MOST_CONTACT, MOST_UNKNOWNS = 400, 50_000
#: Ratio beyond which it is not told.
MANY = 10.0


def against_opening(scene: Scene, change: float | None) -> str | None:
    """Sentence about the error of constant normal forces in a slow cycle; None if it is small.

    Parameters
    ----------
    scene : Scene
    change : float, optional
        Change of the normal force by vibration over that force, see
        :mod:`skfem_joint.results.normal_force`; None where no contact could open.

    Returns
    -------
    str, optional
        It says why where the error was not computed.
    """
    structure = scene.structure()
    if change is None or change <= LARGE or not isinstance(structure, Structure):
        return None
    why = "By how much slip and friction energy err for it was not computed"
    cure = (
        "To see it, run the scene with contact = 'unilateral' in its [[joint]] and "
        "time.quasi_static = true."
    )
    try:
        opens = _opening(structure).system(scene.loads(), scene.output.points or None)
    except InputError as error:
        return f"{why}: {error}."
    N = sparse.csr_array(opens.contact.normal.N)
    kept = opens.contact.B.shape[0] + np.unique(N.indices).size
    if kept > MOST_CONTACT or opens.n > MOST_UNKNOWNS:
        return (
            f"{why}: {kept} contact unknowns in {opens.n} are more than {MOST_CONTACT} in "
            f"{MOST_UNKNOWNS}. {cure}"
        )
    try:
        closed, opened = (_cycle(scene, s) for s in (scene.system(), opens))
    except (ConvergenceError, InputError) as error:
        return f"{why}: {error}. {cure}"
    energy = _relative(float(closed.cycles.friction[-1]), float(opened.cycles.friction[-1]))
    slip = _relative(float(closed.slip_peak.max()), float(opened.slip_peak.max()))
    return (
        f"In a slow cycle of the loads at their peak, without inertia, constant normal forces make "
        f"the largest slip {slip} and the friction energy {energy} than contact that opens does."
    )


def _relative(value: float, reference: float) -> str:
    """How much less or more a value is than a reference, in words."""
    if value == reference:
        return "no less"
    if abs(value) > MANY * abs(reference):  # which may be round-off of zero
        return f"over {MANY:g} times more"
    share = value / reference - 1.0
    return f"{100.0 * abs(share):.2g} % {'less' if share < 0.0 else 'more'}"


def _opening(structure: Structure) -> Structure:
    """Structure whose joints on boundaries open; it has the preload that is known."""
    joints = [
        replace(joint, contact="unilateral", normal_force="consistent")
        if patch.normal is not None
        else joint
        for joint, patch in zip(structure.joints, structure.patches, strict=True)
    ]
    return replace(structure, joints=joints, like=structure)


def _cycle(scene: Scene, system: System) -> Run:
    """Two slow cycles of the condensed model of a system."""
    steps = min(scene.n_steps, 5_000)  # times at which loads are looked at
    times = np.linspace(0.0, scene.n_steps * scene.time_step, steps + 1)
    amplitudes = system.load_amplitudes(times)
    peaks = np.abs(amplitudes).max(axis=1, keepdims=True)
    size = np.divide(amplitudes, peaks, out=np.zeros_like(amplitudes), where=peaks > 0.0)
    most = amplitudes[:, int((size**2).sum(axis=0).argmax())]
    loads = [
        replace(load, amplitude=Harmonic(float(a), 1.0))
        for load, a in zip(system.loads, most, strict=True)
        if a != 0.0
    ]
    small = condense(replace(system, loads=tuple(loads)), 0)
    return quasi_static(small, cycles=2, steps_per_cycle=24)
