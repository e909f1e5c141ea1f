"""Sentences about bodies and meshes that are allowed but suggest a mistake of the user.

`skfem_joint.structure.doubts.doubted` collects them; ``skfem-joint check`` and runs show them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from skfem_joint.body.body import SECTION, Body
from skfem_joint.body.nodes import Nodes, feet
from skfem_joint.joint.gaps import surfaces
from skfem_joint.joint.joints import Joint
from skfem_joint.joint.patch import Patch
from skfem_joint.joint.pressure_space import PressureSpace
from skfem_joint.joint.scans import Scan
from skfem_joint.mesh.cells import CONFORMING
from skfem_joint.system.system import System

#: Least number of elements in the length of a wave.
_PER_WAVELENGTH = 6


def unusual_values(body: Body) -> Iterator[str]:
    """Sentences about material and sizes that suggest other units than SI."""
    # From soft rubber to diamond, and from foam to osmium, which has 22.6 g/cm3.
    for name, (least, most), unit, steel in (
        ("E", (1e6, 2e12), "Pa", "2e11"),
        ("density", (25.0, 3e4), "kg/m3", "7850"),
    ):
        values = body.properties[name]
        if not least <= values.min() <= values.max() <= most:
            worst = values.min() if values.min() < least else values.max()
            yield f"material.{name} is {worst:.4g} {unit}; steel has {steel}: is it in {unit}?"
    ratio = float(body.properties["poisson"].max())
    # A bar with one element of second order through the thickness bends with frequencies that are
    # 0.3 to 0.7 % too high at 0.3, 3 to 4 % at 0.48, 4 to 5 % at 0.499; of first order, hexahedra
    # with incompatible modes, 0.2, 2 and 8 %. With four elements of second order it is 1 %.
    if ratio >= 0.48 and (body.dim == 3 or body.plane == "strain"):
        yield (
            f"material.poisson is {ratio:g}: elements hardly change their volume and are too "
            "stiff, those of second order by some 5 % in the frequencies of what bends with one "
            "of them through its thickness, and 1 % with four; refine the mesh and compare."
        )
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
        starts_apart = patch.joint.has_gap and not patch.opening.force.any()
        if patch.joint.opens and starts_apart and body.mass != "lumped":
            cure = "give material.mass_matrix = 'lumped'"
            if body.mesh.order > 1:
                cure = "take elements of first order with material.mass_matrix = 'lumped'"
            yield (
                f"Joint '{patch.joint.name}' starts apart, so that its faces will hit each other: "
                "behind an impact forces oscillate by 20 to 50 % with a consistent mass, by its "
                f"own dispersion, and hardly with a lumped one; {cure}."
            )


def resolved_gaps(joints: Sequence[Joint], spaces: Mapping[int, PressureSpace]) -> Iterator[str]:
    """Sentences about how much of the gap of joints the contact points of the mesh resolve."""
    for i, space in spaces.items():
        found, scale = space.resolution, joints[i].gap_scale
        if found is not None:
            yield (
                f"Gap of joint '{joints[i].name}': up to {scale * found.largest:.4g} m, its root "
                f"mean square {scale * found.whole:.4g} m about the mean; the contact points "
                f"resolve {scale * found.resolved:.4g} m of it and leave "
                f"{scale * found.rest:.4g} m, {100.0 * found.lost:.2g} %."
            )


def doubtful_gaps(joints: Sequence[Joint], spaces: Mapping[int, PressureSpace]) -> Iterator[str]:
    """Sentences about gaps that the mesh does not resolve, or that are large beside the face."""
    for i, space in spaces.items():
        found, name = space.resolution, joints[i].name
        if found is None:
            continue
        largest = joints[i].gap_scale * found.largest
        # A face of 0.1 m that is 1 mm out of plane is bent, not rough or bowed.
        if largest > 0.01 * found.length:
            yield (
                f"The gap of joint '{name}' is up to {largest:.4g} m on a face {found.length:.4g} "
                "m long: is it in metres? A unit stands in brackets behind the name of a column, "
                "as in height (um)."
            )
        for scan in surfaces(joints[i].gap):
            # So much larger than the face is a scan whose places are in another unit.
            if isinstance(scan, Scan) and scan.extent > 30.0 * found.length:
                yield (
                    f"The scan {scan.name} of joint '{name}' is {scan.extent:.4g} m long, its face "
                    f"{found.length:.4g} m: are its places in metres? A unit stands in brackets "
                    "behind the name of a column, as in x (mm)."
                )
        # A tenth of the root mean square is a hundredth of its square.
        if found.lost > 0.1:
            yield (
                f"The contact points of joint '{name}' miss {100.0 * found.lost:.2g} % of the root "
                f"mean square of its gap, {joints[i].gap_scale * found.rest:.3g} m of "
                f"{joints[i].gap_scale * found.whole:.3g} m: what is finer than elements of the "
                "face does not act; refine them, or smooth the gap."
            )


def wider_than_other(body: Body, joints: Sequence[Joint]) -> Iterator[str]:
    """Sentences about bars, or edges of plates, that are pressed on narrower or thinner ones."""
    mesh, (width, thickness) = body.mesh, body.section
    for joint in joints:
        if joint.against is None:
            continue
        edge, pair = joint.on in mesh.boundaries, (joint.on, joint.against)
        across = thickness if edge else width
        parts = (mesh.mesh.f2t[0, mesh.boundaries[k]] if edge else mesh.regions[k] for k in pair)
        own, other = (float(across[part].max()) for part in parts)
        if own > other * (1.0 + 1e-9):
            yield (
                f"Joint '{joint.name}' is {own:.4g} m wide and pressed on '{joint.against}', "
                f"{other:.4g} m wide: its pressure and friction count on all of its own width; "
                "exchange the two, or give the pressed part the width of the contact."
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
