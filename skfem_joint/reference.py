"""The paper's reference system (section 2.1) and its proper orthogonal modes."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic
from skfem_joint.meshing import build_bar
from skfem_joint.recording import Run, Save
from skfem_joint.reduction import ReferenceModes, reference_modes
from skfem_joint.structure import Joint, Structure, assemble, build_structure

#: 250 x 50 x 10 mm plate, 8 MPa, mu = 0.7, 63 kN (90 % of the friction limit) at 1000 Hz. Young's
#: modulus and density are not printed in the paper: its Table 3 and its resonances give them.
LENGTH = 0.25
PRESSURE = 8e6
FRICTION = 0.7
FORCE = 63e3
FREQUENCY = 1000.0
PLATE: dict[str, Any] = {"E": 200e9, "density": 8000.0, "width": 0.05, "thickness": 0.01}


def lap_joint(
    length: float = LENGTH,
    pressure: float = PRESSURE,
    *,
    friction: float = FRICTION,
    beta: float = 1e5,
    normal_force: str = "equal",
    elements: int = 100,
    stiffness_damping: float = 1e-5,
) -> Structure:
    """Isolated lap joint of Fig. 1(b): a bar pressed on a rigid base along its whole length.

    Parameters
    ----------
    length, pressure : float
        m, Pa.
    beta : float
        Scaling constant of the arctan law, s/m; ``inf`` is Coulomb.
    """
    return build_structure(
        build_bar([("joint", length, elements)], {"fixed": 0.0, "free_end": length}),
        fixed=["fixed"],
        joints=[Joint("joint", pressure, friction, beta, normal_force)],
        stiffness_damping=stiffness_damping,
        **PLATE,
    )


def run_lap_joint(
    structure: Structure,
    force: float = FORCE,
    frequency: float = FREQUENCY,
    *,
    cycles: int = 3,
    steps_per_cycle: int = 200,
    fields: bool = True,
) -> Run:
    """Harmonic run of a lap joint from rest, pulled at its free end.

    Raises
    ------
    KeyboardInterrupt
        If it is interrupted: half a run makes no modes.
    """
    run = integrate(
        assemble(structure, [("free_end", Harmonic(force, frequency))]),
        step=1.0 / frequency / steps_per_cycle,
        n_steps=cycles * steps_per_cycle,
        cycle_steps=steps_per_cycle,
        save=Save(fields=fields),
    )
    if run.interrupted:
        raise KeyboardInterrupt
    return run


def modes_of_lap_joint(
    structure: Structure, run: Run, *, snapshots: str = "both", inner_product: str = "euclidean"
) -> ReferenceModes:
    """Proper orthogonal modes of a lap joint's run on its unit active length."""
    x = structure.position[structure.free]
    mass = None if inner_product == "euclidean" else np.asarray(run.system.M.toarray())
    return reference_modes(
        x[-1] - x, run.u, run.v, np.abs(run.u).max(axis=0), snapshots=snapshots, mass=mass
    )


@cache
def paper_reference(*, snapshots: str = "both", inner_product: str = "euclidean") -> ReferenceModes:
    """Modes of the paper's reference run: three periods from rest (section 4)."""
    structure = lap_joint()
    return modes_of_lap_joint(
        structure, run_lap_joint(structure), snapshots=snapshots, inner_product=inner_product
    )
