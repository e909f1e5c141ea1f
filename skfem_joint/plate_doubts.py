"""What is allowed in a structure of plates but looks like a slip of the user's."""

from __future__ import annotations

import numpy as np

from skfem_joint.bolts import Bolts
from skfem_joint.plate_structure import PlateStructure
from skfem_joint.system import System

#: A plate so many times longer than thick was probably drawn in other units; so was one as short.
_LONGEST, _SHORTEST = 2000.0, 0.1
#: A bolt's ring on fewer contact points is poorly resolved.
_FEWEST_POINTS = 12
#: Share of a bolt's ring that lies on the joint, below which to say so.
_WHOLE_RING = 0.99


def doubts(structure: PlateStructure, system: System) -> list[str]:
    """Sentences about size, loads, and joints."""
    found = []
    size = float(np.ptp(structure.nodes, axis=0).max())
    thickness = float(structure.thickness.min())
    if not _SHORTEST < size / thickness < _LONGEST:
        found.append(
            f"The plates are {size:.4g} m long and {thickness:.4g} m thick: is the mesh in metres? "
            "mesh.scale = 1e-3 reads one in millimetres."
        )
    limit = float(system.w.sum())
    for load in system.loads:
        peak = abs(load.amplitude.peak_value)
        if 0.0 < limit < peak:
            found.append(
                f"The load on {load.on} reaches {peak:.4g} N, more than all joints can hold by "
                f"friction, {limit:.4g} N: they may slip as a whole."
            )
    for patch in structure.patches:
        name = patch.joint.name
        if not np.any(system.w[patch.points] > 0.0):
            found.append(f"Joint '{name}' carries no friction: its pressure or friction is zero.")
        pressure = patch.joint.pressure
        if not isinstance(pressure, Bolts):
            continue
        for bolt, share in zip(pressure.bolts, patch.bolt_shares, strict=True):
            where = f"The bolt at ({bolt.at[0]:.4g}, {bolt.at[1]:.4g}) m in joint '{name}'"
            if share < _WHOLE_RING:
                found.append(
                    f"{where} has {100 * share:.3g} % of its ring on the joint; its whole force "
                    "presses there."
                )
            distance = np.linalg.norm(structure.nodes[patch.nodes] - bolt.at, axis=1)
            points = int(np.count_nonzero(distance <= pressure.outer_radius(bolt)))
            if points < _FEWEST_POINTS:
                found.append(
                    f"{where} presses {points} nodes within its ring, which is few: refine the "
                    "mesh around it."
                )
    return found
