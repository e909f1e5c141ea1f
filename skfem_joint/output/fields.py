"""Stored fields of models on all displacement nodes, with the contact of both bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.joint.manifold import cells_of_boundary, cells_of_region
from skfem_joint.joint.pressure import nodal_pressure
from skfem_joint.results.contact_history import (
    check_fields,
    contact_history,
    displacements,
    gaps_of,
    limits_of,
    normal_forces,
)
from skfem_joint.results.history import States
from skfem_joint.results.stress import (
    StressCycle,
    cycle_period,
    middles,
    preload_stress,
    stress_notes,
    von_mises,
    within,
)
from skfem_joint.stepping.recording import Run
from skfem_joint.structure.model import AnyStructure
from skfem_joint.structure.structure import Structure
from skfem_joint.system.unknowns import selection

#: Arrays of a series and their units, the same for every dimension; vectors and tensors in space.
POINT_ARRAYS = {
    "displacement": "m",
    "velocity": "m/s",
    "slip": "m, of the body of the block against what it touches",
    "friction_traction": "Pa, on the body of the block; of reduced models sure where it slips",
    "slip_state": "-1 no contact, 0 stick, 1 slip",
    "pressure": "Pa, clamping",
    "friction_work_density": "J/m^2, since the start",
}
#: Beside these, the first two where contact opens, the last where bolts clamp.
MORE_POINT_ARRAYS = {
    "contact_pressure": "Pa, now, of contact that opens; 0 off its faces",
    "gap": "m, by which joints are open, 0 off their faces: now where contact opens, else under "
    "the preload",
    "preload_displacement": "m, at rest, by the preload alone; the others are beyond it",
}
CELL_ARRAYS = {
    "contact_state": "as slip_state, of the cell",
    "stress": "Pa, elastic, mean of the element, of vibration alone: XX, YY, ZZ, XY, YZ, XZ",
    "von_mises": "Pa, of the stress",
}
#: Beside these, the first two where bolts clamp, the others where enough times of the last cycle
#: are stored.
MORE_CELL_ARRAYS = {
    "preload_stress": "Pa, at rest, by the preload alone, as stress",
    "total_von_mises": "Pa, of preload and vibration together",
    "von_mises_range": "Pa, of largest less least stress, component by component, in the last "
    "cycle: twice the alternating stress",
    "von_mises_mean": "Pa, of the middle of both with the preload, negative in pressure",
}


@dataclass(frozen=True)
class Field:
    """History of a model on all N displacement nodes.

    Attributes
    ----------
    name : str
        Of the model's blocks, such as ``"full"``.
    displacement, velocity : ndarray, shape (frames, N, dim)
        m and m/s.
    slip, friction_traction : ndarray, shape (frames, N, dim)
        Of the pressed body, m and Pa; 0 off its contact.
    slip_state : ndarray of int, shape (frames, N)
        -1 no contact, 0 stick, 1 slip.
    friction_work_density : ndarray, shape (frames, N)
        Since the start, J/m^2; 0 off the contact.
    contact_pressure, gap : ndarray, shape (frames, N), or None
        Of contact that opens, on the pressed body, Pa and m; 0 off it. None where none opens.
    last_cycle : dict of str to ndarray, shape (elements,)
        Range and mean of the stress in the last cycle, Pa, by the names of their arrays; none
        without a cycle that has enough frames.
    """

    name: str
    displacement: FloatArray
    velocity: FloatArray
    slip: FloatArray
    friction_traction: FloatArray
    slip_state: States
    friction_work_density: FloatArray
    contact_pressure: FloatArray | None = None
    gap: FloatArray | None = None
    last_cycle: dict[str, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True)
class Frames:
    """What a series or a picture shows: fields of models of a structure at common times.

    Attributes
    ----------
    structure : Structure
        With a mesh of N displacement nodes.
    times : ndarray, shape (frames,)
        Increasing, s.
    fields : sequence of Field
        A history of each model; frames beyond the last time are left out.
    load_times : ndarray, shape (rows,)
        Times of the forces, finer than the frames, s.
    forces : mapping of str to ndarray, shape (rows,)
        Force of the loads by the place where they act, N.
    """

    structure: Structure
    times: FloatArray
    fields: Sequence[Field]
    load_times: FloatArray = field(default_factory=lambda: np.zeros(0))
    forces: Mapping[str, FloatArray] = field(default_factory=dict)

    @cached_property
    def pressure(self) -> FloatArray:
        """Clamping pressure on the pressed nodes, 0 elsewhere, shape (N,), Pa.

        On an edge where joints meet it is the force of all of them over the area of all.
        """
        force, area = np.zeros((2, len(self.structure.nodes)))
        for patch in self.structure.patches:
            force[patch.nodes] += patch.normal_force
            area[patch.nodes] += patch.area
            force[patch.held_nodes] += patch.held_forces
            area[patch.held_nodes] += patch.held_areas
        return np.divide(force, area, out=np.zeros_like(area), where=area > 0.0)

    @cached_property
    def _preloaded(self) -> dict[str, FloatArray]:
        """Gap of constant contact, and displacement, of a preload on all nodes, if there is one."""
        preload, gap = self.structure.preload, np.zeros(len(self.structure.nodes))
        if preload is None:
            return {}
        known = [
            (patch.other, joint)
            for patch, joint in zip(self.structure.patches, preload.joints, strict=True)
            if joint is not None and not patch.joint.opens
        ]
        area = sum((joint.area for _, joint in known), np.zeros(gap.size))
        for held, joint in known:
            nodes = np.flatnonzero(joint.area)
            other = None if held is None else joint.other[nodes]
            own = np.zeros(gap.size)  # joints that meet share nodes
            own[nodes] = joint.gap[nodes] * joint.area[nodes] / area[nodes]
            gap += own + _means(_shares(other, nodes, joint.area[nodes], gap.size)) @ own
        moved = self.structure.body.in_space(preload.displacement)
        return {"gap": gap, "preload_displacement": moved}

    @cached_property
    def _preload_stress(self) -> FloatArray:
        """Stress of each element by the preload, (elements, 6), Pa."""
        return preload_stress(self.structure)

    def _stresses(self, field: Field, frame: int) -> dict[str, FloatArray]:
        """Arrays of stress of a frame on linear sub-cells, with those of preload and last cycle."""
        vibration = self.structure.stress(field.displacement[frame])
        arrays = {"stress": vibration, "von_mises": von_mises(vibration)}
        if self.structure.preload is not None:
            rest = self._preload_stress
            arrays |= {"preload_stress": rest, "total_von_mises": von_mises(rest + vibration)}
        of_cell = self.structure.body.cell_element
        return {name: x[of_cell] for name, x in (arrays | field.last_cycle).items()}

    @cached_property
    def _shares(self) -> list[sparse.csr_array]:
        """Area of pressed nodes that each node of the other body takes, by joint, (N, N), m^2."""
        n = len(self.structure.nodes)
        return [_shares(p.other, p.nodes, p.area, n) for p in self.structure.patches]

    @cached_property
    def _reaction(self) -> Any:
        """Means of values on the pressed bodies at the nodes of the others, (N, N)."""
        n = len(self.structure.nodes)
        return sum(map(_means, self._shares), start=sparse.csr_array((n, n)))

    @cached_property
    def _by_area(self) -> Any:
        """The same of values by area, (N, N): what acts on a node over its area of its own face."""
        body, patches = self.structure.body, self.structure.patches
        names = {patch.joint.against for patch in patches if patch.other is not None}
        area, mesh = np.zeros(len(body.nodes)), body.mesh
        for parts, cells_of in (
            (mesh.regions, cells_of_region),
            (mesh.boundaries, cells_of_boundary),
        ):
            if own := [parts[name] for name in names if name in parts]:
                cells, _, depth = cells_of(body, np.unique(np.concatenate(own)))
                area += nodal_pressure(body.nodes, cells, depth, 1.0, "")[1]
        over = np.divide(1.0, area, out=np.zeros_like(area), where=area > 0.0)
        whole = sum(self._shares, start=sparse.csr_array(2 * area.shape))
        return sparse.diags_array(over) @ whole

    @cached_property
    def _cell_means(self) -> sparse.csr_array:
        """Means over the corners of the linear sub-cells that may touch; else empty rows, (c, N).

        It takes as many touching corners as what is pressed has: those of a cell or of a facet.
        """
        cells, n = self.structure.body.cells, len(self.structure.nodes)
        once = np.ones(cells.shape, dtype=bool)  # a corner that stands twice counts once
        for j in range(1, cells.shape[1]):
            once[:, j] = (cells[:, :j] != cells[:, [j]]).all(axis=1)
        collapsed = ~once.all(axis=1)
        inside = np.zeros(cells.shape, dtype=bool)
        for patch, shares in zip(self.structure.patches, self._shares, strict=True):
            pressed, held = np.zeros((2, n), dtype=bool)
            pressed[patch.nodes], held[patch.held_nodes] = True, True
            for side in (pressed, np.diff(shares.indptr) > 0):
                touching = side[cells] & once
                count = np.count_nonzero(touching | (held[cells] & once), axis=1)
                corners = patch.cells.shape[1]
                least = np.where(collapsed, min(corners, 3), corners)  # of a triangle
                inside |= touching & (count >= least)[:, np.newaxis]
        row, column = np.nonzero(inside)
        weight = 1.0 / np.count_nonzero(inside, axis=1)[row]
        return sparse.csr_array((weight, (row, cells[row, column])), shape=(len(cells), n))

    def arrays(self, field: Field, frame: int) -> dict[str, NDArray[Any]]:
        """Values of one frame on all nodes, or linear sub-cells, by their names in a series.

        The body that is not pressed gets the reaction. "contact_state" is -1 unless the cell may
        touch and half of it does, 1 if half of that slips.
        """
        reaction, by_area, in_space = self._reaction, self._by_area, self.structure.body.in_space
        own, traction = field.slip_state[frame], field.friction_traction[frame]
        work, slip = field.friction_work_density[frame], field.slip[frame]
        state = np.maximum(own, _mean_state(reaction, own))
        return {
            "displacement": in_space(field.displacement[frame]),
            "velocity": in_space(field.velocity[frame]),
            "slip": in_space(slip - reaction @ slip),
            "friction_traction": in_space(traction - by_area @ traction),
            "slip_state": state,
            "pressure": self.pressure + by_area @ self.pressure,
            "friction_work_density": work + by_area @ work,
            **self._preloaded,
            **self._opened(field, frame),
            "contact_state": _mean_state(self._cell_means, state),
            **self._stresses(field, frame),
        }

    def _opened(self, field: Field, frame: int) -> dict[str, FloatArray]:
        """Present pressure and gap on all nodes, the gap beside that of a preload; {} without."""
        if field.contact_pressure is None or field.gap is None:
            return {}
        pressure, gap = field.contact_pressure[frame], field.gap[frame]
        apart = gap + self._reaction @ gap + self._preloaded.get("gap", 0.0)
        return {"contact_pressure": pressure + self._by_area @ pressure, "gap": apart}


def _shares(
    other: sparse.csr_array | None, nodes: IntArray, own: FloatArray, n: int
) -> sparse.csr_array:
    """Parts of the areas ``own``, m^2, of ``nodes`` that the other body's nodes take, (n, n)."""
    if other is None:
        return sparse.csr_array((n, n))
    # Elements of second order have shapes below zero, which would be negative areas.
    weights = sparse.csr_array(other).maximum(0.0)
    of_node = own / np.asarray(weights.sum(axis=1)).ravel()
    shares = sparse.csr_array((sparse.diags_array(of_node) @ weights).T @ selection(nodes, n))
    shares.eliminate_zeros()
    return shares


def _means(shares: sparse.csr_array) -> sparse.csr_array:
    """Matrix of means by areas, (n, n)."""
    area = np.asarray(shares.sum(axis=1)).ravel()
    scale = np.divide(1.0, area, out=np.zeros_like(area), where=area > 0.0)
    return sparse.csr_array(sparse.diags_array(scale) @ shares)


def _mean_state(means: sparse.csr_array, state: States) -> States:
    """Contact state from means: in contact if half of it is, slipping if half of that slips."""
    contact, slip = means @ (state >= 0).astype(float), means @ (state == 1).astype(float)
    slips = np.where(2.0 * slip >= contact * (1.0 - 1e-12), 1, 0)
    return np.where(contact >= 0.5 * (1.0 - 1e-12), slips, -1).astype(np.int8)


def frames_of(structure: AnyStructure, runs: Mapping[str, Run]) -> Frames:
    """Stored fields of runs by name, as far as all of them have come, with the loads of the first.

    Raises
    ------
    InputError
        If there is no run, a run stored no fields or other times or is not of this structure, or
        the structure is given by matrices alone.
    """
    structure = structure.meshed("fields need a mesh")
    given: object = runs
    if not isinstance(given, Mapping) or not given:
        raise InputError("runs: must be runs by name, such as {'full': run}, at least one")
    first = next(iter(runs.values()))
    times = min((run.field_times for run in runs.values()), key=len)
    for run in runs.values():
        check_fields(run)
        if not np.allclose(run.field_times[: times.size], times, rtol=1e-9, atol=0.0):
            raise InputError("runs: must store their fields at the same times; use one Save in all")
    rows = first.times if first.times.size else times
    forces: dict[str, FloatArray] = {}
    loads = first.system.loads
    for load, history in zip(loads, first.system.load_amplitudes(rows), strict=True):
        forces[load.on] = forces.get(load.on, 0.0) + history
    fields = [_field_of(structure, name, run) for name, run in runs.items()]
    return Frames(structure, times, fields, rows, forces)


def _field_of(structure: Structure, name: str, run: Run) -> Field:
    """Stored fields of a run on all displacement nodes."""
    u, v = displacements(structure, run)
    contact = contact_history(structure, run)
    system = contact.system
    slip, traction = np.zeros((2, *u.shape))
    density, pressed = np.zeros(u.shape[:2]), np.zeros(u.shape[1])
    limits = limits_of(system, forces := normal_forces(structure, run))
    states = np.full(u.shape[:2], -1, dtype=np.int8)
    for patch in structure.patches:
        pressed[patch.nodes] += patch.area  # of nodes that joints share that of all these joints
        states[:, patch.held_nodes] = 0  # which cannot slip, but may in another joint
    for number, patch in enumerate(structure.patches):
        points, nodes, area = patch.points, patch.nodes, pressed[patch.nodes]
        part = patch.area / area
        own = system.contact.J[[number]].toarray()[0, points]
        limit = own * limits[:, points] / area
        for k in range(patch.directions.shape[1]):
            free = system.contact.directions[points] > k
            row, along = system.contact.first_row[points[free]] + k, patch.directions[free, k]
            size = -limit[:, free] * contact.friction[:, row]
            traction[:, nodes[free]] += size[..., np.newaxis] * along
            slip[:, nodes[free]] += contact.slip[:, row, np.newaxis] * part[free, None] * along
        states[:, nodes] = contact.state[:, points]
        density[:, nodes] += contact.work[:, points] * own / area
    pressure = gap = None
    if run.normal_force.size:  # where contact opens
        pressure, gap = np.zeros((2, *u.shape[:2]))
        start, gaps = 0, gaps_of(structure, run)
        for face in (patch.opening for patch in structure.patches):
            own = slice(start, start + int(np.count_nonzero(face.moves)))
            start = own.stop
            force, apart = (np.tile(x, (len(gaps), 1)) for x in (face.force, face.gap))
            force[:, face.moves], apart[:, face.moves] = forces[:, own], gaps[:, own]
            pressure[:, face.nodes] = (face.means @ force.T).T / face.area
            gap[:, face.nodes] = np.where(force > 0.0, 0.0, apart)
            states[:, face.nodes] = np.where(force > 0.0, states[:, face.nodes], -1)
    last, period = {}, cycle_period(run)
    if period is not None and (rows := within(run.field_times, period)) is not None:
        at, stresses = middles(structure), map(structure.stress, u[rows])
        cycle = StressCycle.of(np.arange(len(at)), at, preload_stress(structure), stresses)
        last = {"von_mises_range": 2.0 * cycle.amplitude}
        if not stress_notes(structure):
            last["von_mises_mean"] = cycle.signed_mean
    return Field(name, u, v, slip, traction, states, density, pressure, gap, last)
