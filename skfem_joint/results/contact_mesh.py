"""Whether the mesh of the contact resolves the slip under bolts, told from a static state.

Around a bolt the pressure falls off over a few elements, and there the first slip occurs. If few
contact points share the work of friction, the friction energy depends on where nodes happen to lie.
Counted are the points that share it: with e = w |slip| of each point, N = (sum e)^2 / sum e^2.

Measured for slow cycles to 30, 50, 70 and 90 % of the friction limit: all changes of the energy of
a cycle, in percent, as N: change.

Solids pressed by rings, 62 to 272 points, against a mesh with 848:

    8: 123, 11: 32, 14: 9, 17: 51, 18: 17, 22: 20, 28: 21, 29: 8, 40: 5, 43: 8, 62: 3, 86: 1

Plates pressed by bolts on a rigid base, 24 to 104 points, against a mesh with 294:

    3: 192, 4: 224, 4: 140, 6: 95, 7: 150, 8: 25, 9: 38, 10: 12, 14: 46, 15: 24, 18: 4, 23: 7

``examples/solid_lap_joint.toml``, preloaded, elements halved once, 30, 60 and 90 %:

    18: 17, 40: 6, 108: -1

Evenly pressed plates changed by less than 4 % at any N, a bar by 0.1 %. So only joints under bolts
are judged, and only where the contact is an area. The change scatters by a factor of three about
350 / N: the sentence is a warning, not an estimate. N counts all bolts of a joint, two in the
solids and plates measured; where there are more, it is too large.
"""

from __future__ import annotations

from collections.abc import Iterator

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.joint.patch import Patch
from skfem_joint.joint.pressure import Bolts
from skfem_joint.structure.model import AnyStructure
from skfem_joint.system.system import System


def judged(structure: AnyStructure) -> list[Patch]:
    """Joints that are judged: under bolts, with an area of contact."""
    return [
        patch
        for patch in structure.patches
        if patch.points.size
        and patch.directions.shape[1] == 2
        and (patch.joint.pressed_by_bolts or isinstance(patch.joint.pressure, Bolts))
    ]


def sharing_points(system: System, points: IntArray, u: FloatArray) -> float:
    """Number N of contact points that share the work of friction at a displacement (n,), m.

    ``points`` are numbers of contact points. Zero where none of them slips.
    """
    work = (system.contact.w * system.contact.slip_norm(system.contact.B @ u))[points]
    square = float(work @ work)
    return float(work.sum()) ** 2 / square if square > 0.0 else 0.0


def coarse_contact(structure: AnyStructure, system: System, u: FloatArray) -> Iterator[str]:
    """Sentences about joints whose friction energy depends on the mesh of their contact.

    Parameters
    ----------
    structure : Structure
    system : System
        Its system, in any unknowns.
    u : ndarray, shape (n,)
        Displacement, m, in these, under the loads at their peak; no joint slips as a whole.
    """
    for patch in judged(structure):
        count = sharing_points(system, patch.points, u)
        # Fewest points that share the work of friction in a joint under bolts.
        if 0.0 < count < 60.0:
            # Typical change of the friction energy on finer meshes, in percent, times the number
            # of these points.
            change = f"{350.0 / count:.1g}"
            yield (
                f"Joint '{patch.joint.name}': under the bolts {count:.2g} of {patch.points.size} "
                "contact points share the work of friction. With so few the friction energy "
                f"depends on the mesh of the contact, by some {float(change):g} %: refine "
                "it there, or let `skfem-joint run --certify --models full` measure it."
            )
