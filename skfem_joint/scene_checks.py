"""Mistakes between the tables of a scene, and between a scene and its mesh."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint import loads
from skfem_joint.errors import InputError
from skfem_joint.meshing import BarMesh
from skfem_joint.plate_mesh import PlateMesh
from skfem_joint.scene_messages import found_text, key_path, listed
from skfem_joint.scene_plates import (
    PlateJoint,
    PlatePressureByPosition,
    PlateReduction,
    PlateSupport,
)
from skfem_joint.scene_tables import FEWEST_STEPS_PER_PERIOD, Joint, Override, Reduction, Time
from skfem_joint.scene_values import MOST, AnyMesh

IntArray = NDArray[np.int64]


def time_step(time: Time, period: float | None) -> float:
    """Length of a step, s."""
    if time.step is not None:
        return time.step
    if period is None:
        raise InputError("time.cycles: the loads have no common period")
    return period / time.steps_per_cycle


def n_steps(time: Time) -> int:
    """Number of steps; the last one ends at the end of the run or just beyond it."""
    if time.duration is not None and time.step is not None:
        return math.ceil(min(time.duration / time.step, 1e18) * (1 - 1e-9))
    return (time.cycles or 0) * time.steps_per_cycle


def _check_overrides(key: str, regions: Mapping[str, Override], mesh: AnyMesh) -> Iterator[str]:
    for (name, one), (other_name, other) in combinations(regions.items(), 2):
        both = one.model_fields_set & other.model_fields_set
        if both and np.intersect1d(mesh.regions[name], mesh.regions[other_name]).size:
            yield (
                f"{key_path((key, 'regions', other_name))}: found {' and '.join(sorted(both))}, "
                f"which region '{name}' also sets; the two regions share elements, so only one may"
            )


def _check_joints(joints: tuple[Joint, ...], bar: BarMesh) -> Iterator[str]:
    for (i, one), (j, other) in combinations(enumerate(joints), 2):
        elements = np.intersect1d(bar.regions[one.region], bar.regions[other.region])
        nodes = np.intersect1d(bar.region_nodes(one.region), bar.region_nodes(other.region))
        if elements.size:
            yield (
                f"joint[{j}].region: found '{other.region}', which shares {elements.size} elements "
                f"with joint[{i}] ('{one.region}'); joints must not overlap"
            )
        elif nodes.size and one.to_joint().beta != other.to_joint().beta:
            key = "beta" if one.law == other.law else "law"
            yield (
                f"joint[{j}].{key}: found {found_text(getattr(other, key))}, must be "
                f"{found_text(getattr(one, key))} as in joint[{i}], with which it shares a node"
            )


def _check_points(tables: Mapping[str, Any], bar: BarMesh) -> Iterator[str]:
    held = {bar.points[name] for name in tables["support"].fixed}
    free = listed(name for name, node in bar.points.items() if node not in held)
    for i, item in enumerate(tables.get("load", ())):
        if bar.points.get(item.on) in held:
            yield (
                f"load[{i}].on: found '{item.on}', which is fixed, so the support takes the whole "
                f"load; free points of the mesh: {free}"
            )
    output = tables.get("output")
    for i, name in enumerate(output.points if output else ()):
        if bar.points[name] in held:
            yield (
                f"output.points[{i}]: found '{name}', which is fixed and never moves; "
                f"free points of the mesh: {free}"
            )


def _check_time(time: Time, items: tuple[Any, ...]) -> Iterator[str]:
    amplitudes = [item.to_load() for item in items]
    period = loads.common_period(amplitudes)
    if time.cycles is not None and period is None:
        yield (
            f"time.cycles: found {time.cycles}, but the loads have no common period; "
            "give duration and step instead"
        )
        return
    step = time_step(time, period)
    count = n_steps(time)
    if not (0 < step < math.inf and count <= MOST):
        yield f"time: found {count:.3g} steps of {step:.3g} s, must be at most {MOST:.0e} steps"
        return
    key = "time.steps_per_cycle" if time.step is None else "time.step"
    found = f"found {time.steps_per_cycle if time.step is None else format(time.step, 'g')}"
    for i, load in enumerate(amplitudes):
        fastest = load.highest_frequency
        if fastest is None or isinstance(load, loads.Table | loads.RampAndHold):
            continue
        if isinstance(load, loads.Harmonic | loads.MultiHarmonic):
            longest, what = 1 / (FEWEST_STEPS_PER_PERIOD * fastest), "an eighth of the period"
        else:
            longest, what = 1 / (2 * fastest), "the rise time or duration"
        if step > longest * (1 + 1e-9):
            allowed = (
                f"must be <= {longest:.4g}"
                if time.step is not None
                else f"must be >= {math.ceil(step * time.steps_per_cycle / longest * (1 - 1e-9))}"
            )
            yield f"{key}: {found}, {allowed}: a step must not be longer than {what} of load[{i}]"


def _check_reduction(
    reduction: Reduction, joints: tuple[Joint, ...], bar: BarMesh
) -> Iterator[str]:
    element_lengths = np.diff(bar.mesh.p[0])
    lengths = {
        joint.region: float(element_lengths[bar.regions[joint.region]].sum()) for joint in joints
    }
    key: tuple[str, ...] = ("reduction", "active_length")
    asked = reduction.active_length
    if isinstance(asked, str):
        return
    if isinstance(asked, float):
        wanted = [(key, region, asked) for region in lengths]
    else:
        wanted = [((*key, region), region, length) for region, length in asked.items()]
    for where, region, length in wanted:
        if region not in lengths:
            yield (
                f"{key_path(where)}: found '{region}', which is no joint; joints: {listed(lengths)}"
            )
        elif length > lengths[region] * (1 + 1e-9):
            yield (
                f"{key_path(where)}: found {length:g}, must be <= {lengths[region]:g}, "
                f"the length of joint '{region}'"
            )


def _numbers(plate: PlateMesh, kind: str, name: str) -> IntArray:
    """Elements of a region, or facets of a boundary."""
    return plate.regions[name] if kind == "region" else plate.boundaries[name]


def _bodies(plate: PlateMesh, kind: str, name: str) -> IntArray:
    """Bodies that a region or boundary belongs to."""
    numbers = _numbers(plate, kind, name)
    elements = numbers if kind == "region" else plate.mesh.f2t[0, numbers]
    return np.unique(plate.body[elements])


def vertices(plate: PlateMesh, name: str) -> IntArray:
    """Vertices of a point, boundary or region."""
    if name in plate.points:
        return np.array([plate.points[name]])
    if name in plate.boundaries:
        return np.unique(plate.mesh.facets[:, plate.boundaries[name]])
    return np.unique(plate.mesh.t[:, plate.regions[name]])


def held_names(support: PlateSupport, plate: PlateMesh) -> set[str]:
    """Points, boundaries and regions that cannot move at all."""
    held: dict[str, list[IntArray]] = {"x": [], "y": []}
    for name, ways in support.named:
        for way in ways:
            held[way].append(vertices(plate, name))
    none = np.array([], dtype=np.int64)
    both = np.intersect1d(np.concatenate([none, *held["x"]]), np.concatenate([none, *held["y"]]))
    names = {*plate.points, *plate.boundaries, *plate.regions}
    return {name for name in names if np.isin(vertices(plate, name), both).all()}


def _check_plate_joints(joints: tuple[PlateJoint, ...], plate: PlateMesh) -> Iterator[str]:
    for (i, one), (j, other) in combinations(enumerate(joints), 2):
        if one.kind != other.kind:
            continue
        shared = np.intersect1d(
            _numbers(plate, one.kind, one.name), _numbers(plate, other.kind, other.name)
        )
        if shared.size:
            what = "elements" if one.kind == "region" else "edges"
            yield (
                f"joint[{j}].{other.kind}: found '{other.name}', which shares {shared.size} {what} "
                f"with joint[{i}] ('{one.name}'); joints must not overlap"
            )
    for i, joint in enumerate(joints):
        yield from _check_against(i, joint, plate)
        pressure = joint.pressure
        if isinstance(pressure, PlatePressureByPosition):
            s = np.array(pressure.axis) @ plate.mesh.p[:, vertices(plate, joint.name)]
            first, last = pressure.positions[0], pressure.positions[-1]
            tolerance = 1e-9 * float(np.ptp(plate.mesh.p, axis=1).max())
            if first > s.min() + tolerance or last < s.max() - tolerance:
                yield (
                    f"joint[{i}].pressure.positions: found {first:g} to {last:g} m, must cover the "
                    f"joint, which reaches from {s.min():g} to {s.max():g} m along the axis"
                )


def _check_against(i: int, joint: PlateJoint, plate: PlateMesh) -> Iterator[str]:
    if joint.against is None:
        return
    key = f"joint[{i}].against"
    same_kind = plate.regions if joint.kind == "region" else plate.boundaries
    if joint.against not in same_kind:
        is_kind = "boundary" if joint.kind == "region" else "region"
        plural = "regions" if joint.kind == "region" else "boundaries"
        yield (
            f"{key}: found '{joint.against}', which is a {is_kind}; a {joint.kind} is needed, as "
            f"'{joint.name}' is one; {plural} of the mesh: {listed(same_kind)}"
        )
        return
    mine, theirs = (_bodies(plate, joint.kind, name) for name in (joint.name, joint.against))
    if np.intersect1d(mine, theirs).size:
        yield (
            f"{key}: found '{joint.against}', which belongs to the same body as '{joint.name}'; "
            "a joint presses two bodies on each other, meshed apart from each other"
        )


def _check_plate_names(tables: Mapping[str, Any], plate: PlateMesh) -> Iterator[str]:
    held = held_names(tables["support"], plate)
    free = listed({*plate.points, *plate.boundaries} - held)
    for i, item in enumerate(tables.get("load", ())):
        if item.on in held:
            yield (
                f"load[{i}].on: found '{item.on}', which is fixed, so the support takes the whole "
                f"load; free points and boundaries of the mesh: {free}"
            )
    output = tables.get("output")
    for i, name in enumerate(output.points if output else ()):
        if name in held:
            yield (
                f"output.points[{i}]: found '{name}', which is fixed and never moves; "
                f"free points and boundaries of the mesh: {free}"
            )


def _check_plate_reduction(
    reduction: PlateReduction, joints: tuple[PlateJoint, ...]
) -> Iterator[str]:
    names = [joint.name for joint in joints]
    if isinstance(reduction.active_length, dict):
        for name in reduction.active_length:
            if name not in names:
                yield (
                    f"{key_path(('reduction', 'active_length', name))}: found '{name}', which is "
                    f"no joint; joints: {listed(names)}"
                )
    if reduction.reference == "paper":
        for i, joint in enumerate(joints):
            if joint.axis is None:
                yield (
                    f"joint[{i}].axis: missing, must be given with reduction.reference = 'paper': "
                    "the direction [x, y] along which the reference modes are laid; or use "
                    "reference = 'self'"
                )


def relations(tables: Mapping[str, Any], mesh: AnyMesh | None) -> Iterator[str]:
    """Mistakes between tables, for those tables that are right in themselves."""
    for key in ("material", "section"):
        if mesh is not None and key in tables:
            yield from _check_overrides(key, tables[key].regions, mesh)
    if isinstance(mesh, PlateMesh):
        if "joint" in tables:
            yield from _check_plate_joints(tables["joint"], mesh)
        if "support" in tables:
            yield from _check_plate_names(tables, mesh)
    elif mesh is not None:
        if "joint" in tables:
            yield from _check_joints(tables["joint"], mesh)
        if "support" in tables:
            yield from _check_points(tables, mesh)
    if "time" in tables and "load" in tables:
        yield from _check_time(tables["time"], tables["load"])
    if "models" in tables and "joint" in tables:
        models, joints = tables["models"], tables["joint"]
        if "reduced" in models.run and not joints:
            yield (
                "models.run: found 'reduced' in a scene without [[joint]]; a linear scene has "
                "nothing to reduce by joint modes, run 'full' alone"
            )
        elif joints and "reduction" in tables:
            if isinstance(mesh, PlateMesh):
                if "reduced" in models.run:
                    yield from _check_plate_reduction(tables["reduction"], joints)
            elif mesh is not None:
                yield from _check_reduction(tables["reduction"], joints, mesh)
