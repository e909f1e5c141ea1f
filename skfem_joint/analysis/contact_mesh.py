"""Whether the mesh of the contact resolves the slip under bolts, told from a static state.

Around a bolt the pressure falls off over a few elements, and there the first slip occurs. If few
contact points share the work of friction, the friction energy depends on where nodes happen to lie.
Counted are the points that share it: with e = w |slip| of each point, N = (sum e)^2 / sum e^2.

Measured for slow cycles to 30, 50, 70 and 90 % of the friction limit, as changes of the energy of a
cycle on a mesh four or eight times as fine (solids pressed by rings) or on a mesh with all elements
halved (``examples/solid_lap_joint.toml``, preloaded):

=================== ==== ==== ==== ==== ==== ==== ==== ==== ==== ====
N                      8   11   17   22   28   29   40   43   62   86
solids, rings, %     123   32   51   20   21  7.6  5.2  7.5  2.8  1.1
N                     18   40  108
preload, halved, %  16.7  5.7  1.3
=================== ==== ==== ==== ==== ==== ==== ==== ==== ==== ====

Plates pressed by bolts on a rigid base changed by 24 % at N = 15 and 6.5 % at 23, evenly pressed
ones by less than 4 % at any N, bars by 0.1 %. So only joints under bolts are judged, and only where
the contact is an area.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.structure import AnyStructure, Bolts, Patch
from skfem_joint.system import System


@dataclass(frozen=True)
class ContactMeshSettings:
    """When friction energy is said to depend on the mesh of the contact.

    Attributes
    ----------
    sharing : float
        Fewest points that share the work of friction in a joint under bolts.
    percent : float
        Change of the friction energy on finer meshes, in percent, times the number of these points:
        most of those measured lie below.
    """

    sharing: float = 60.0
    percent: float = 350.0


SETTINGS = ContactMeshSettings()


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
    work = (system.w * system.slip_norm(system.B @ u))[points]
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
        if 0.0 < count < SETTINGS.sharing:
            change = f"{SETTINGS.percent / count:.1g}"
            yield (
                f"Joint '{patch.joint.name}': under the bolts {count:.2g} of {patch.points.size} "
                "contact points share the work of friction. With so few the friction energy "
                f"depends on the mesh of the contact, by about {float(change):g} % or more: refine "
                "it there, or let `skfem-joint run --certify --models full` measure it."
            )
