"""Time series of plates for ParaView: each body of each model a named block of one series."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.errors import InputError
from skfem_joint.files import replacing
from skfem_joint.plate import PlateStructure
from skfem_joint.vtk_files import needed_pyvista, region_numbers, series_problems, write_frames

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

#: How plates are drawn: swept to their thickness, or as surfaces.
SHAPES = ("swept", "flat")

#: Space between bodies that lie on each other, in thicknesses of the lower one.
GAP = 0.5

#: What the arrays of a series mean.
UNITS = (
    "displacement: m",
    "velocity: m/s",
    "friction_traction: Pa, on the body of the block",
    "slip_state: -1 no contact, 0 stick, 1 slip",
    "contact_state: as slip_state, of the cell",
    "pressure: Pa, clamping",
    "friction_work_density: J/m^2, since the start",
    "thickness: m",
)


@dataclass(frozen=True)
class PlateField:
    """History of one model on all displacement nodes of the plates.

    Attributes
    ----------
    name : str
        Name of the model's blocks, e.g. "full".
    displacement, velocity : ndarray, shape (frames, N, 2)
        m and m/s.
    traction : ndarray, shape (frames, N, 2)
        Friction traction on the pressed body, Pa; 0 off its contact.
    slip_state : ndarray of int, shape (frames, N)
        -1 no contact, 0 stick, 1 slip.
    friction_work : ndarray, shape (frames, N)
        Density of the friction work since the start, J/m2; 0 off the contact.
    """

    name: str
    displacement: FloatArray
    velocity: FloatArray
    traction: FloatArray
    slip_state: NDArray[np.int8]
    friction_work: FloatArray


@dataclass(frozen=True)
class LoadHistory:
    """Histories of the loads, for the curve beside a picture.

    Attributes
    ----------
    times : ndarray, shape (rows,)
        s; as fine as the run stored them, not only the frames of the fields.
    forces : mapping of str to ndarray, shape (rows,)
        Total force of each load by where it acts, N.
    """

    times: FloatArray
    forces: Mapping[str, FloatArray]


@dataclass(frozen=True)
class Block:
    """One body as a grid.

    Attributes
    ----------
    label : str
        Name of the body: its region if one is exactly the body, else "body 1" and so on. Empty
        for a body that is alone.
    grid : pyvista.UnstructuredGrid
        With what does not change in time.
    nodes, cells : ndarray of int
        Displacement node of each point, linear sub-cell of each cell.
    """

    label: str
    grid: Any
    nodes: IntArray
    cells: IntArray


def write_series(
    path: str | Path,
    structure: PlateStructure,
    times: FloatArray,
    fields: Sequence[PlateField],
    pressure: FloatArray,
    *,
    shape: str = "swept",
) -> list[Path]:
    """Write histories of plates as a series that ParaView opens.

    Each body of each model is a block, named "full: upper" by the region that is exactly the body,
    else "full: body 1"; a body that is alone has the model's name. Models lie on each other: switch
    blocks off or move them in ParaView. Bodies that lie on each other, which is what the contact of
    a *region* with another body means, are moved apart along z: the pressed body lies above the
    other, by its thickness and half of it as a gap. Bodies whose contact is a *boundary* are seen
    from their side, lie beside each other as it is, and are not moved.

    Nodes carry the vectors ``displacement`` (m), ``velocity`` (m/s), ``friction_traction`` (Pa),
    and ``slip_state``, ``pressure`` (Pa) and ``friction_work_density`` (J/m2). The body that is not
    pressed carries the reaction, and the other values as means over what lies on it: traction times
    nodal contact area adds up to the same force with the opposite sign. Cells carry
    ``contact_state``, the slip state for pictures (-1 unless the whole cell, or with a boundary an
    edge of it, may touch and half of it does; 1 if at least half of that slips), ``region``
    (position in the field array ``region_names``, -1 without one; of overlapping regions the one
    with fewest elements), ``body`` and ``thickness`` (m). The field array ``units`` says this in
    each file. Elements of second order come as linear cells on their nodes.

    Parameters
    ----------
    path : str or Path
        File name of the index, ending in ".pvd"; folders are made.
    structure : PlateStructure
    times : ndarray, shape (frames,)
        Increasing, s.
    fields : sequence of PlateField
        One for each model, all at the same ``times``; frames beyond the last of them are left out.
    pressure : ndarray, shape (N,)
        Clamping pressure on the pressed nodes, Pa; 0 elsewhere.
    shape : {"swept", "flat"}
        Hexahedra and wedges with the plate's thickness, or surfaces at half of it.

    Returns
    -------
    list of Path
        The index and the files of the frames.

    Raises
    ------
    InputError
        Shapes or names that do not fit, a path that cannot be written, or pyvista is missing.
    """
    index = Path(path)
    times = np.asarray(times, dtype=float)
    problems = series_problems(index, times, [field.name for field in fields])
    problems += field_problems(structure, times.size, fields, pressure, shape)
    if problems:
        raise InputError(problems)
    blocks = plate_blocks(structure, shape)
    contact = Contact(structure)
    names = [
        f"{field.name}: {block.label}" if block.label else field.name
        for field in fields
        for block in blocks
    ]

    def grids(k: int) -> Iterator[Any]:
        for field in fields:
            values = contact.values(field, k, pressure)
            for block in blocks:
                yield filled(block, values)

    return write_frames(index, times, names, grids)


def write_load(index: str | Path, load: LoadHistory) -> Path:
    """Write the load histories beside a series, for ``examples/paraview_joint.py``.

    ``NAME_load.csv`` beside ``NAME.pvd`` has the columns "time, s" and "force on PLACE, N".

    Raises
    ------
    InputError
        Histories of another length than the times, or a file that cannot be written.
    """
    index = Path(index)
    for on, force in load.forces.items():
        if np.shape(force) != np.shape(load.times):
            raise InputError(
                f"load on {on!r}: found shape {np.shape(force)}, must be that of the times "
                f"{np.shape(load.times)}"
            )
    path = index.with_name(f"{index.stem}_load.csv")
    columns = np.column_stack([load.times, *load.forces.values()])
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time, s", *(f"force on {on}, N" for on in load.forces)])
        writer.writerows(columns.tolist())
    return path


def field_problems(
    structure: PlateStructure,
    frames: int,
    fields: Sequence[PlateField],
    pressure: FloatArray,
    shape: str,
) -> list[str]:
    """Mistakes in the arrays that are to be drawn."""
    problems = []
    n = structure.nodes.shape[0]
    if shape not in SHAPES:
        problems.append(f"shape: found {shape!r}, must be one of {', '.join(SHAPES)}")
    if np.shape(pressure) != (n,):
        problems.append(f"pressure: found shape {np.shape(pressure)}, must be (nodes,) = {(n,)}")
    wanted: dict[str, tuple[int, ...]] = {
        "displacement": (n, 2),
        "velocity": (n, 2),
        "traction": (n, 2),
        "slip_state": (n,),
        "friction_work": (n,),
    }
    for field in fields:
        for name, rest in wanted.items():
            found = getattr(field, name).shape
            if len(found) != 1 + len(rest) or found[0] < frames or found[1:] != rest:
                problems.append(
                    f"{field.name}.{name}: found shape {found}, must be (frames, nodes"
                    f"{', 2' if len(rest) == 2 else ''}) = {(frames, *rest)}"
                )
    return problems


def plate_blocks(structure: PlateStructure, shape: str = "swept") -> list[Block]:
    """Grid of each body with its cell data; see :func:`write_series`.

    Raises
    ------
    InputError
        If pyvista is missing.
    """
    pyvista = needed_pyvista("files for ParaView")
    plate = structure.plate
    region = region_numbers(plate.regions, plate.body.size)
    bottom = _bottoms(structure)
    corners = _counter_clockwise(structure)
    body = plate.body[structure.cell_element]
    blocks = []
    for number, label in enumerate(_labels(structure)):
        cells = np.flatnonzero(body == number)
        elements = structure.cell_element[cells]
        size, width = structure.thickness[elements], corners.shape[1]
        # Where the thickness changes, a node has a point at each of them.
        _, step = np.unique(size, return_inverse=True)
        pairs = np.column_stack([corners[cells].ravel(), np.repeat(step, width)])
        _, first, point = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
        point = np.asarray(point).reshape(cells.size, width)
        nodes, height = pairs[first, 0], np.repeat(size, width)[first]
        flat = structure.nodes[nodes]
        if shape == "flat":
            kind = pyvista.CellType.TRIANGLE if width == 3 else pyvista.CellType.QUAD
            points = np.column_stack([flat, bottom[number] + 0.5 * height])
            connections = point
        else:
            kind = pyvista.CellType.WEDGE if width == 3 else pyvista.CellType.HEXAHEDRON
            lower = np.column_stack([flat, np.full(nodes.size, bottom[number])])
            points = np.vstack([lower, lower + np.outer(height, [0.0, 0.0, 1.0])])
            connections = np.hstack([point, point + nodes.size])
            nodes = np.tile(nodes, 2)
        grid = pyvista.UnstructuredGrid({kind: connections}, points)
        grid.cell_data["region"] = region[elements]
        grid.cell_data["body"] = np.full(cells.size, number, dtype=np.int32)
        grid.cell_data["thickness"] = size
        if plate.regions:
            grid.field_data["region_names"] = list(plate.regions)
        grid.field_data["units"] = list(UNITS)
        blocks.append(Block(label, grid, nodes, cells))
    return blocks


def filled(block: Block, values: Mapping[str, NDArray[Any]]) -> Any:
    """Grid of a block with the values of one frame, as :meth:`Contact.values` gives them."""
    for name, array in values.items():
        if name == "contact_state":
            block.grid.cell_data["contact_state"] = array[block.cells]
            continue
        at_points = array[block.nodes]
        if at_points.ndim == 2:
            at_points = np.column_stack([at_points, np.zeros(at_points.shape[0])])
        block.grid.point_data[name] = at_points
    return block.grid


class Contact:
    """What the contact does to both bodies, from what it does to the pressed one.

    Parameters
    ----------
    structure : PlateStructure
    """

    def __init__(self, structure: PlateStructure) -> None:
        self.structure = structure

    @cached_property
    def _reaction_by_patch(self) -> list[sparse.csr_array]:
        """Means, at the nodes of the other body, of what acts on the pressed one, (N, N) each."""
        n = self.structure.nodes.shape[0]
        means = []
        for patch in self.structure.patches:
            if patch.other is None:
                means.append(sparse.csr_array((n, n)))
                continue
            # Elements of second order have shapes below zero, which would be negative areas.
            weights = sparse.csr_array(patch.other.maximum(0.0))
            of_node = patch.area / np.asarray(weights.sum(axis=1))
            shares = sparse.csr_array((sparse.diags_array(of_node) @ weights).T)
            area = np.asarray(shares.sum(axis=1))
            scale = np.divide(1.0, area, out=np.zeros(n), where=area > 0.0)
            k = patch.nodes.size
            pick = sparse.csr_array((np.ones(k), (np.arange(k), patch.nodes)), shape=(k, n))
            mean = sparse.csr_array(sparse.diags_array(scale) @ shares @ pick)
            mean.eliminate_zeros()
            means.append(mean)
        return means

    @cached_property
    def reaction(self) -> sparse.csr_array:
        """Sum of the means over all patches, shape (N, N)."""
        n = self.structure.nodes.shape[0]
        return sum(self._reaction_by_patch, start=sparse.csr_array((n, n)))

    @cached_property
    def _cell_means(self) -> sparse.csr_array:
        """Means over the contact nodes of each cell that is in contact, shape (cells, N)."""
        n, cells = self.structure.nodes.shape[0], self.structure.cells
        inside = np.zeros(cells.shape, dtype=bool)
        for patch, means in zip(self.structure.patches, self._reaction_by_patch, strict=True):
            pressed = np.zeros(n, dtype=bool)
            pressed[patch.nodes] = True
            held = np.zeros(n, dtype=bool)
            held[patch.held_nodes] = True
            for side in (pressed, np.diff(means.indptr) > 0):
                touching = side[cells]
                count = np.count_nonzero(touching | held[cells], axis=1)
                least = cells.shape[1] if patch.joint.kind == "region" else 2
                inside |= touching & (count >= least)[:, np.newaxis]
        row, column = np.nonzero(inside)
        weight = 1.0 / np.count_nonzero(inside, axis=1)[row]
        return sparse.csr_array((weight, (row, cells[row, column])), shape=(cells.shape[0], n))

    def values(
        self, field: PlateField, frame: int, pressure: FloatArray
    ) -> dict[str, NDArray[Any]]:
        """Arrays of one frame on all nodes by their names in the series.

        "contact_state" is that of the linear sub-cells.
        """
        reaction, own = self.reaction, field.slip_state[frame]
        state = np.maximum(own, _mean_state(reaction, own))
        work, traction = field.friction_work[frame], field.traction[frame]
        return {
            "displacement": field.displacement[frame],
            "velocity": field.velocity[frame],
            "friction_traction": traction - reaction @ traction,
            "slip_state": state,
            "pressure": pressure + reaction @ pressure,
            "friction_work_density": work + reaction @ work,
            "contact_state": _mean_state(self._cell_means, state),
        }


def _mean_state(means: sparse.csr_array, state: NDArray[np.int8]) -> NDArray[np.int8]:
    """State of a mean: in contact if half of it is, and slipping if half of that slips."""
    contact, slip = means @ (state >= 0).astype(float), means @ (state == 1).astype(float)
    found = np.where(2.0 * slip >= contact * (1.0 - 1e-12), 1, 0)
    return np.where(contact >= 0.5 * (1.0 - 1e-12), found, -1).astype(np.int8)


def _labels(structure: PlateStructure) -> list[str]:
    """Name of each body."""
    body = structure.plate.body
    count = int(body.max()) + 1
    if count == 1:
        return [""]
    labels = [f"body {number + 1}" for number in range(count)]
    for name, elements in structure.plate.regions.items():
        number = body[elements[0]] if elements.size else -1
        if number >= 0 and np.array_equal(np.sort(elements), np.flatnonzero(body == number)):
            labels[number] = name
    return labels


def _bottoms(structure: PlateStructure) -> FloatArray:
    """Height of the lower side of each body."""
    body = structure.plate.body
    bottom = np.zeros(int(body.max()) + 1)
    thickness = np.array(
        [structure.thickness[body == number].max() for number in range(bottom.size)]
    )
    of_node = np.empty(structure.nodes.shape[0], dtype=np.intp)
    of_node[structure.cells] = body[structure.cell_element][:, None]
    above = {
        (int(upper), int(lower))
        for patch in structure.patches
        if patch.other is not None and patch.joint.kind == "region"
        for upper in np.unique(of_node[patch.nodes])
        for lower in np.unique(of_node[patch.other.tocsr().indices])
        if upper != lower
    }
    for _ in bottom:  # each round settles at least one more layer
        for upper, lower in above:
            least = bottom[lower] + (1.0 + GAP) * thickness[lower]
            bottom[upper] = max(bottom[upper], least)
    return bottom


def _counter_clockwise(structure: PlateStructure) -> IntArray:
    """Corners of the sub-cells, turning from x to y."""
    x, y = structure.nodes[structure.cells].transpose(2, 0, 1)
    area = np.sum(x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y, axis=1)
    return np.asarray(
        np.where((area < 0.0)[:, None], structure.cells[:, ::-1], structure.cells), dtype=np.intp
    )
