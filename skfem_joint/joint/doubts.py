"""Sentences about bodies and meshes that are allowed but suggest a mistake of the user.

`skfem_joint.structure.doubts.doubted` collects them; ``skfem-joint check`` and runs show them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from skfem_joint.body.body import SECTION, Body
from skfem_joint.body.nodes import Nodes, feet
from skfem_joint.joint.patch import Patch
from skfem_joint.mesh.cells import CONFORMING
from skfem_joint.system.system import System

#: Least number of elements in the length of a wave.
_PER_WAVELENGTH = 6


def unusual_values(body: Body) -> Iterator[str]:
    """Sentences about material and sizes that suggest other units than SI."""
    # From soft rubber to diamond, and from foam to osmium.
    for name, (least, most), unit, steel in (
        ("E", (1e6, 2e12), "Pa", "2e11"),
        ("density", (5.0, 3e4), "kg/m3", "7850"),
    ):
        values = body.properties[name]
        if not least <= values.min() <= values.max() <= most:
            worst = values.min() if values.min() < least else values.max()
            yield f"material.{name} is {worst:.4g} {unit}; steel has {steel}: is it in {unit}?"
    size = float(np.ptp(body.nodes, axis=0).max())
    given = [name for name in SECTION[body.dim] if getattr(body, name)]
    across = {name: body.properties[name].min() for name in given}
    ratios = [size / extent for extent in across.values()]
    # Largest extent of a structure, m, and length over thickness or width: a body outside of these
    # was probably drawn in other units.
    (least, most), (shortest, longest) = (1e-3, 100.0), (0.1, 2000.0)
    if not least <= size <= most or not all(shortest < ratio < longest for ratio in ratios):
        words = {"width": "wide", "thickness": "thick"}
        also = "".join(f", {extent:.4g} m {words[name]}" for name, extent in across.items())
        yield (
            f"The structure is {size:.4g} m long{also}: is the mesh in metres? mesh.scale = 1e-3 "
            "reads one in millimetres; sections are in metres too."
        )


def per_wavelength(body: Body, frequency: float) -> tuple[float, float]:
    """Speed (m/s) of the slowest bulk wave, and the fewest elements in its length.

    ``frequency`` is in Hz. An element of second order counts as two.
    """
    stretching, shear = body.lame()
    speed = np.sqrt((shear if shear.any() else stretching) / body.properties["density"])
    size = np.ptp(body.mesh.mesh.p[:, body.mesh.mesh.t], axis=1).max(axis=0)
    return float(speed.min()), float((body.mesh.order * speed / (frequency * size)).min())


def coarse_for_waves(body: Body, system: System) -> Iterator[str]:
    """Sentence about elements that are too long for the waves that the loads excite."""
    frequency = max((load.amplitude.highest_frequency or 0.0 for load in system.loads), default=0.0)
    fewest = per_wavelength(body, frequency)[1] if frequency > 0.0 else np.inf
    if fewest < _PER_WAVELENGTH:
        yield (
            f"There are {fewest:.2g} elements in the length of the slowest wave at {frequency:.5g} "
            f"Hz, the highest frequency of the loads; {_PER_WAVELENGTH:g} are the least: "
            "refine the mesh, or check frequency, rise_time, E and density."
        )


def oscillating_impacts(body: Body, patches: Sequence[Patch]) -> Iterator[str]:
    """Sentences about faces that will hit each other while a consistent mass acts.

    With 100 elements along a bar that hits a wall the force behind the impact swings by 20 to 50 %
    with a consistent mass, by 0.3 % with a lumped one.
    """
    for patch in patches:
        if patch.joint.opens and patch.joint.gap > 0.0 and body.mass != "lumped":
            cure = "give material.mass_matrix = 'lumped'"
            if body.mesh.order > 1:
                cure = "take elements of first order with material.mass_matrix = 'lumped'"
            yield (
                f"Joint '{patch.joint.name}' starts apart, so that its faces will hit each other: "
                "behind an impact forces oscillate by 20 to 50 % with a consistent mass, by its "
                f"own dispersion, and hardly with a lumped one; {cure}."
            )


def faces_apart(grid: Nodes, patches: Sequence[Patch]) -> Iterator[str]:
    """Sentences about faces that are apart on the mesh and that a given pressure presses.

    Distances to curved faces are in part those of their straight edges.
    """
    for patch in patches:
        joint, mesh = patch.joint, grid.mesh
        if joint.against not in mesh.boundaries or joint.pressed_by_bolts or not patch.nodes.size:
            continue
        _, foot = feet(grid, str(joint.against), grid.nodes[patch.nodes], 0.0)
        apart = np.linalg.norm(foot - grid.nodes[patch.nodes], axis=1)
        ends = mesh.mesh.p[:, mesh.mesh.facets[:, mesh.boundaries[joint.on]]]
        size = float(np.ptp(ends, axis=1).max())
        flat = patch.normal is not None and np.ptp(patch.normal, axis=0).max() < CONFORMING
        # Distance of curved faces over the size of their facets that is reported.
        if apart.max() > (CONFORMING if flat else 0.05) * size:
            yield (
                f"Joint '{joint.name}' and '{joint.against}' are up to {apart.max():.3g} m apart "
                f"on the mesh, {apart.mean():.3g} m in the mean, and its pressure acts across that "
                "distance as if they touched: move the bodies on each other, or let bolts close "
                "the gap (pressure = 'preload')."
            )
