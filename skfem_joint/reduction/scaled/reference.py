"""The paper's reference system (section 2.1) and its modes on a unit active length."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from skfem_joint.body.body import Material
from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import Harmonic
from skfem_joint.joint.joints import Joint
from skfem_joint.mesh import build_bar
from skfem_joint.reduction.active_length import measured
from skfem_joint.reduction.pod import ProperModes, proper_modes
from skfem_joint.runs.integrate import integrate
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.structure.load import Load
from skfem_joint.structure.structure import Structure

# 250 x 50 x 10 mm plate, 8 MPa, mu = 0.7, 63 kN (90 % of the friction limit) at 1000 Hz. Young's
# modulus and density are not printed in the paper: its Table 3 and its resonances give them.
LENGTH, WIDTH, THICKNESS = 0.25, 0.05, 0.01
PRESSURE, FRICTION = 8e6, 0.7
FORCE, FREQUENCY = 63e3, 1000.0
MATERIAL = Material(E=200e9, density=8000.0)


@dataclass(frozen=True)
class ReferenceModes:
    """Proper orthogonal modes of a reference joint on a unit active length.

    Attributes
    ----------
    xi : ndarray, shape (k,)
        Positions, from 0 where the grey length begins to 1 at the loaded end.
    modes : ndarray, shape (k, r)
        Values of the modes there.
    proper : ProperModes
        The decomposition that they come from.
    active_length : float
        Active length of the reference joint, m.
    """

    xi: FloatArray
    modes: FloatArray
    proper: ProperModes
    active_length: float

    def at(self, xi: FloatArray, count: int) -> FloatArray:
        """First ``count`` modes at the positions ``xi`` (m,), shape (m, count), by cubic splines.

        They are zero for xi <= 0. InputError if there are not so many modes.
        """
        from scipy.interpolate import CubicSpline  # slow to load

        if not 1 <= count <= self.modes.shape[1]:
            raise InputError(
                f"reduction.modes: found {count}, must be from 1 to {self.modes.shape[1]}, the "
                "modes of the reference system"
            )
        values = CubicSpline(self.xi, self.modes[:, :count])(np.clip(xi, 0.0, 1.0))
        return np.where(xi[:, np.newaxis] > 0.0, values, 0.0)


def lap_joint(
    length: float = LENGTH,
    pressure: float = PRESSURE,
    *,
    beta: float = 1e5,
    normal_force: str = "equal",
    elements: int = 100,
) -> Structure:
    """Isolated lap joint of Fig. 1(b): a bar pressed on a rigid base along its whole length.

    Parameters
    ----------
    length : float
        Length, m.
    pressure : float
        Contact pressure, Pa.
    beta : float
        Steepness of the law of friction, s/m; infinite for Coulomb's law.
    normal_force : {"equal", "consistent"}
        How the pressure is shared among the nodes.
    elements : int
        Number of elements.
    """
    return Structure(
        build_bar([("joint", length, elements)], {"fixed": 0.0, "free_end": length}),
        MATERIAL,
        width=WIDTH,
        thickness=THICKNESS,
        fixed=["fixed"],
        joints=[Joint("joint", pressure, FRICTION, beta=beta, normal_force=normal_force)],
        stiffness_damping=1e-5,
    )


def run_lap_joint(
    structure: Structure,
    force: float = FORCE,
    frequency: float = FREQUENCY,
    *,
    cycles: int = 3,
    steps_per_cycle: int = 200,
) -> Run:
    """Run of a lap joint from rest, pulled at its free end by a harmonic force (N, Hz)."""
    system = structure.system([Load("free_end", Harmonic(force, frequency))])
    save = Save(fields=True)
    return integrate(system, cycles=cycles, steps_per_cycle=steps_per_cycle, save=save).finished()


def modes_of_lap_joint(
    structure: Structure, run: Run, *, snapshots: str = "both", inner_product: str = "euclidean"
) -> ReferenceModes:
    """Proper orthogonal modes of a lap joint's run on its unit active length.

    Contact points are mapped by their distances from the loaded end over the active length. See
    `skfem_joint.reduction.pod` for ``snapshots`` and ``inner_product``.
    """
    x = structure.nodes[structure.patches[0].nodes, 0]
    inwards = np.argsort(-x)
    distance = structure.nodes[:, 0].max() - x[inwards]
    length = measured(distance, np.abs(run.u).max(axis=0)[inwards])
    proper = proper_modes(run, snapshots=snapshots, inner_product=inner_product)
    xi = 1.0 - distance[::-1] / length
    # One more point beyond the inner end, where the support holds: zero.
    xi = np.concatenate([[2.0 * xi[0] - xi[1]], xi])
    modes = np.pad(proper.modes[inwards[::-1]], ((1, 0), (0, 0)))
    return ReferenceModes(xi, modes, proper, length)


@cache
def paper_reference(*, snapshots: str = "both", inner_product: str = "euclidean") -> ReferenceModes:
    """Modes of the paper's reference run: three periods from rest (section 4)."""
    joint = lap_joint()
    options = {"snapshots": snapshots, "inner_product": inner_product}
    return modes_of_lap_joint(joint, run_lap_joint(joint), **options)
