"""Time series for ParaView: bodies as grids, a VTK file a block and frame, and their indices.

VTK's own writer writes the files, appended and compressed by LZ4, the fastest that ParaView reads.
pyvista's ``save`` is not used: it ends the process on a full disk where VTK's writer says that it
could not write, and it is 2 to 23 times slower.
"""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import needed, replacing, safe_names
from skfem_joint.output.fields import (
    CELL_ARRAYS,
    MORE_CELL_ARRAYS,
    MORE_POINT_ARRAYS,
    POINT_ARRAYS,
    Frames,
    frames_of,
)
from skfem_joint.output.tables import write_csv
from skfem_joint.results.borders import of_cells
from skfem_joint.stepping.recording import Run
from skfem_joint.structure.structure import Structure

#: Space between bodies that lie on each other, in thicknesses of the lower one.
GAP = 0.5

# Linear cells by dimension and corners: name in VTK, corners next to the first corner, and order of
# corners that turns a cell that is inside out.
_CELLS: dict[tuple[int, int], tuple[str, tuple[int, ...], tuple[int, ...]]] = {
    (1, 2): ("LINE", (1,), (1, 0)),
    (2, 3): ("TRIANGLE", (1, 2), (2, 1, 0)),
    (2, 4): ("QUAD", (1, 3), (3, 2, 1, 0)),
    (3, 4): ("TETRA", (1, 2, 3), (1, 0, 2, 3)),
    (3, 6): ("WEDGE", (), ()),
    (3, 8): ("HEXAHEDRON", (1, 3, 4), (4, 5, 6, 7, 0, 1, 2, 3)),
}
# scikit-fem's corners in VTK's order, around the lower face and then around the upper one.
_HEXAHEDRON = (0, 3, 6, 2, 1, 5, 7, 4)


@dataclass(frozen=True)
class Block:
    """A body, or a face at which bodies touch, as a grid.

    Attributes
    ----------
    label : str
        Name of the body, empty if there is only one; ``"contact NAME"`` for a face.
    grid : pyvista.UnstructuredGrid
        Its cells and points, with the values that do not change in time.
    nodes : ndarray of int, shape (n_points,)
        Displacement node of each point.
    cells : ndarray of int, shape (n_cells,)
        Linear sub-cell of each cell.
    """

    label: str
    grid: Any
    nodes: IntArray
    cells: IntArray

    def fill(self, arrays: Mapping[str, NDArray[Any]]) -> Any:
        """Set the grid to the values of a frame, from :meth:`Frames.arrays`; returns it."""
        for name, array in arrays.items():
            if name in CELL_ARRAYS | MORE_CELL_ARRAYS:
                self.grid.cell_data[name] = array[self.cells]
            else:
                self.grid.point_data[name] = array[self.nodes]
        return self.grid


def blocks_of(structure: Structure) -> list[Block]:
    """Each body of a structure as a grid with its cell data; see :func:`write_series`."""
    mesh = structure.mesh
    corners, directions, section = (
        corners_of(structure),
        _directions(structure),
        _section(structure),
    )
    shift = stack_heights(structure)[:, np.newaxis] * directions[-1:].sum(axis=0)
    of_cell = mesh.body[structure.body.cell_element]
    blocks = []
    for number, label in enumerate(_labels(structure)):
        cells = np.flatnonzero(of_cell == number)
        elements, width = structure.body.cell_element[cells], corners.shape[1]
        # Where the section changes, a node has points of each.
        _, step = np.unique(section[elements], axis=0, return_inverse=True)
        pairs = np.column_stack([corners[cells].ravel(), np.repeat(step.ravel(), width)])
        _, first, place = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
        connections = np.asarray(place).reshape(cells.size, width)
        nodes, size = pairs[first, 0], np.repeat(section[elements], width, axis=0)[first]
        points, dim = structure.positions[nodes] + shift[number], structure.dim
        for k, direction in enumerate(directions):
            n, half = len(points), 0.5 * size[:, k : k + 1] * direction
            points = np.vstack([points - half, points + half])
            nodes, size, dim = np.tile(nodes, 2), np.tile(size, (2, 1)), dim + 1
            other = connections[:, ::-1] if dim == 2 else connections  # a line's corners go around
            connections = np.hstack([connections, other + n])
        grid = _grid(structure, _CELLS[dim, connections.shape[1]][0], connections, points, elements)
        if len(directions):
            grid.cell_data["thickness"] = section[elements, -1]
        blocks.append(Block(label, grid, nodes, cells))
    return blocks


def faces_of(structure: Structure) -> list[Block]:
    """Faces of solids that touch, by the names of joints and of what they are pressed against."""
    blocks = []
    for label, corners in _touching(structure).items():
        nodes, place = np.unique(corners, return_inverse=True)
        cells, number = _behind(structure.body.cells, corners), np.reshape(place, corners.shape)
        kind, elements = _CELLS[2, corners.shape[1]][0], structure.body.cell_element[cells]
        grid = _grid(structure, kind, number, structure.positions[nodes], elements)
        blocks.append(Block(label, grid, nodes, cells))
    return blocks


def _touching(structure: Structure) -> dict[str, IntArray]:
    """Corners of the faces that touch, for solids alone: a plate's block itself shows its edges."""
    bounds = structure.mesh.boundaries if structure.dim == 3 else {}
    pairs = [(patch.joint.on, patch.joint.against) for patch in structure.patches]
    names = dict.fromkeys(name for pair in pairs for name in pair if name in bounds)
    return {f"contact {name}": structure.body.facet_cells(bounds[name])[0] for name in names}


def _behind(cells: IntArray, facets: IntArray) -> IntArray:
    """Cell behind each facet of a border: the cell that has all corners of the facet."""
    of_facets, of_all = (
        of_cells(some.ravel(), some.shape[1] * np.arange(len(some) + 1), int(cells.max()) + 1)
        for some in (facets, cells)
    )
    return np.asarray((of_facets @ of_all.T).argmax(axis=1), dtype=np.intp).ravel()


def _grid(
    structure: Structure, kind: str, corners: IntArray, points: FloatArray, elements: IntArray
) -> Any:
    """Grid of cells that are parts of ``elements``, with their regions, bodies and units."""
    pyvista, mesh = needed("pyvista", "vtk"), structure.mesh
    region, names = np.full(mesh.n_elements, -1, dtype=np.int32), list(mesh.regions)
    for name in sorted(names, key=lambda name: len(mesh.regions[name]), reverse=True):
        region[mesh.regions[name]] = names.index(name)
    collapsed = {"QUAD": "TRIANGLE", "HEXAHEDRON": "WEDGE"}.get(kind)
    kept = once(corners) if collapsed else np.ones(corners.shape, dtype=np.bool_)
    count = kept.sum(axis=1)
    types = np.full(len(corners), pyvista.CellType[kind], dtype=np.uint8)
    types[count < corners.shape[1]] = pyvista.CellType[collapsed or kind]
    used = np.column_stack([np.ones(len(corners), dtype=np.bool_), kept])
    grid = pyvista.UnstructuredGrid(np.column_stack([count, corners])[used], types, points)
    grid.cell_data["region"] = region[elements]
    grid.cell_data["body"] = mesh.body[elements].astype(np.int32)
    meanings = POINT_ARRAYS | MORE_POINT_ARRAYS | CELL_ARRAYS | MORE_CELL_ARRAYS
    meanings |= {"thickness": "m"}
    _add_texts(grid, "units", [f"{name}: {meaning}" for name, meaning in meanings.items()])
    _add_texts(grid, "region_names", names)
    return grid


def once(corners: IntArray) -> BoolArray:
    """Where corners of quadrilaterals or hexahedra, in VTK's order, do not repeat the one before.

    Those in which some do are the triangles and wedges that they stand for.
    """
    rings = corners.reshape(len(corners), -1, 4)  # of a hexahedron two
    return np.asarray((rings != np.roll(rings, 1, axis=2)).reshape(corners.shape))


def _add_texts(grid: Any, name: str, texts: Sequence[str]) -> None:
    """Give a grid a field array of texts, in UTF-8: pyvista's own way refuses all but ASCII."""
    from vtkmodules.vtkCommonCore import vtkStringArray

    array = vtkStringArray()
    array.SetName(name)
    for text in texts:
        array.InsertNextValue(text)
    grid.GetFieldData().AddArray(array)


def _labels(structure: Structure) -> list[str]:
    """Name of each body: the region that is exactly the body; empty if there is only one body."""
    mesh = structure.mesh
    count = int(mesh.body.max()) + 1
    if count == 1:
        return [""]
    labels = [f"body {number + 1}" for number in range(count)]
    for name, elements in mesh.regions.items():
        number = mesh.body[elements[0]]
        if np.array_equal(elements, np.flatnonzero(mesh.body == number)):
            labels[number] = name
    return labels


def _directions(structure: Structure) -> FloatArray:
    """Directions of a bar's width (horizontal, across it) and of the thickness, (3 - dim, 3)."""
    if structure.dim > 1:
        return np.eye(3)[structure.dim :]
    along = structure.body.axes[0]
    across = np.cross([0.0, 0.0, 1.0], along)
    length = np.linalg.norm(across)
    across = across / length if length > 1e-6 else np.array([0.0, 1.0, 0.0])
    return np.array([across, np.cross(along, across)])


def _section(structure: Structure) -> FloatArray:
    """Width and thickness of each element, to which it is swept, (n_elements, 3 - dim), m."""
    names = ("width", "thickness")[structure.dim - 1 :]
    sizes = [structure.body.properties[name] for name in names]
    return np.reshape(np.transpose(sizes), (structure.mesh.n_elements, 3 - structure.dim))


def stack_heights(structure: Structure) -> FloatArray:
    """How far each body is moved in the direction of its thickness, m, so that bodies lie apart.

    Only bodies whose *cells* are pressed on another body lie on it; bodies that touch at facets are
    beside each other already.
    """
    body = structure.mesh.body
    height = np.zeros(int(body.max()) + 1)
    thick = np.zeros(height.size)
    np.maximum.at(thick, body, structure.body.properties["thickness"])
    above = {
        (int(upper), int(lower))
        for patch in structure.patches
        if patch.other is not None and patch.normal is None
        for upper in np.unique(structure.body.body_of_node[patch.nodes])
        for lower in np.unique(structure.body.body_of_node[np.unique(patch.other.tocsr().indices)])
        if upper != lower
    }
    for _ in height:  # each round settles at least one more layer
        for upper, lower in above:
            least = height[lower] + (0.5 + GAP) * thick[lower] + 0.5 * thick[upper]
            height[upper] = max(height[upper], least)
    return height


def corners_of(structure: Structure) -> IntArray:
    """Corners of the linear sub-cells in VTK's order, turned so that their size is positive."""
    cells = structure.body.cells
    if cells.shape[1] == 8:
        cells = cells[:, _HEXAHEDRON]
    _, beside, turned = _CELLS[structure.dim, cells.shape[1]]
    edges = structure.nodes[cells[:, beside]] - structure.nodes[cells[:, :1]]
    outside = np.linalg.det(edges) > 0.0
    return np.asarray(np.where(outside[:, np.newaxis], cells, cells[:, turned]), dtype=np.intp)


def write_vtk(path: str | Path, structure: Structure, runs: Mapping[str, Run]) -> list[Path]:
    """Write the stored fields of runs as a series that ParaView opens, with their loads beside it.

    The series has displacement, velocity, slip, friction traction, stick and slip, pressure,
    friction work, stress and von Mises stress of every run, on all nodes and elements; its files
    say their units. Fields of contact come from the runs themselves, also those of condensed and
    reduced models. `skfem_joint.output.series.write_series` says how bodies are shown.

    Parameters
    ----------
    path : str or Path
        Index of the series, such as ``"out/fields.pvd"``; folders are made.
    structure : Structure
        That the systems of all runs were made from.
    runs : mapping of str to Run
        Runs by the names they are shown with; full, condensed or reduced ones, with fields stored
        at the same times, ``save=Save(fields=True)``. Frames beyond the shortest are left out.

    Returns
    -------
    list of Path
        The index, the files of the frames in ``out/fields/``, and ``out/fields_load.csv`` with the
        forces (N) over time (s) of the first run's loads.

    Raises
    ------
    InputError
        If the path does not end in ``.pvd``: it is left as it is. If a run stored no fields or
        other times, or is not one of this structure; for names that lead to one file, a path that
        cannot be written, and without pyvista.
    """
    path, frames = Path(path), frames_of(structure, runs)
    files = write_series(path, frames)
    load = path.with_name(f"{path.stem}_load.csv")
    write_load(load, frames)
    return [*files, load]


def write_series(path: str | Path, frames: Frames) -> list[Path]:
    """Write histories as a series that ParaView opens; returns the index and the frames' files.

    Each body of each model is a block, named "full: upper" by the region that is exactly the body,
    else "full: body 1"; a body that is alone has the model's name. Models lie on each other: switch
    blocks off or move them in ParaView. A bar is swept to its width and thickness, a plate to its
    thickness, with the mesh in the middle. Bodies whose *cells* are pressed on another one are
    moved apart: the pressed body lies above the other, with a gap of half of the other's thickness.
    Faces of solids that touch are blocks too, named "full: contact NAME" by their boundary.

    Points carry `POINT_ARRAYS`, and of `MORE_POINT_ARRAYS` those of clamping bolts and of contact
    that opens: its present pressure and gap. The body that is not
    pressed carries the reaction: the integral of traction over either face is the same force with
    opposite signs, as are those of pressures and friction work. Slip and gap are means there over
    what lies on it. Cells carry `CELL_ARRAYS`
    (see :meth:`Frames.arrays`), with `MORE_CELL_ARRAYS` likewise, ``region`` (position in the
    field array ``region_names``, -1 without one; of overlapping regions the one with fewest
    elements), ``body`` and ``thickness`` (m, not of solids). The field array ``units`` says this in
    each file. Elements of second order come as linear cells on their nodes, prisms as wedges.

    ``NAME.pvd`` is the index of ``NAME/frame_0000.vtm`` and so on, which name the blocks in
    ``NAME/BLOCK_0000.vtu``: ParaView and pyvista show the names. Folders are made. Every file takes
    its place only when it is whole, the index last: whatever ends the writing leaves an index of
    the frames that are done. InputError for a path of another ending, which is left as it is, a
    path that cannot be written, and without pyvista.
    """
    index, names = Path(path), _names(frames)
    if index.suffix.lower() != ".pvd":
        raise InputError(f"{index}: found ending {index.suffix!r}, must be '.pvd'")
    blocks = [*blocks_of(frames.structure), *faces_of(frames.structure)]
    files = series_files(index, frames)
    try:
        index.with_suffix("").mkdir(parents=True, exist_ok=True)
        index.unlink(missing_ok=True)  # it would list old frames among new ones
    except OSError as error:
        raise InputError(f"{index}: cannot be written: {error}") from error
    done = 0
    try:
        for k, time in enumerate(frames.times):
            targets = iter(files[k][1:])
            for field in frames.fields:
                arrays = frames.arrays(field, k)
                for block in blocks:
                    grid = block.fill(arrays)
                    grid.field_data["TimeValue"] = [time]
                    _write_grid(next(targets), grid)
            _write_index(files[k][0], "vtkMultiBlockDataSet", files[k][1:], "name", names)
            done = k + 1
    finally:
        if done:
            times = [repr(float(time)) for time in frames.times[:done]]
            firsts = [row[0] for row in files[:done]]
            _write_index(index, "Collection", firsts, "timestep", times)
    return [index, *itertools.chain(*files)]


def _names(frames: Frames) -> list[str]:
    """Names of the blocks of a series."""
    labels = [*_labels(frames.structure), *_touching(frames.structure)]
    models = [field.name for field in frames.fields]
    return [f"{model}: {label}" if label else model for model in models for label in labels]


def series_files(index: Path, frames: Frames) -> list[list[Path]]:
    """Files of a series without its index: for each frame a list of blocks, then the blocks."""
    names, count = [f"{name}_{{}}.vtu" for name in safe_names(_names(frames))], len(frames.times)
    digits, folder = max(4, len(str(count - 1))), index.with_suffix("")
    numbers = [f"{k:0{digits}d}" for k in range(count)]
    return [[folder / name.format(k) for name in ("frame_{}.vtm", *names)] for k in numbers]


def _write_grid(file: Path, grid: Any) -> None:
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    with replacing(file) as temporary:
        writer = vtkXMLUnstructuredGridWriter()
        writer.SetInputData(grid)
        writer.SetFileName(str(temporary))
        writer.SetDataModeToAppended()
        writer.EncodeAppendedDataOff()
        writer.SetCompressorTypeToLZ4()
        if not writer.Write():
            raise OSError("VTK could not write it; is the disk full?")


def _write_index(
    path: Path, kind: str, files: Sequence[Path], name: str, values: Sequence[str]
) -> None:
    """Write an index in VTK's format: names of files, each with the value of an attribute."""
    root = ET.Element("VTKFile", type=kind, version="1.0")
    listed = ET.SubElement(root, kind)
    for number, (file, value) in enumerate(zip(files, values, strict=True)):
        place = file.relative_to(path.parent).as_posix()
        what = {"index": str(number), "file": place, name: value}
        ET.SubElement(listed, "DataSet", what)
    ET.indent(root)
    with replacing(path) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def write_load(path: Path, frames: Frames) -> None:
    """Write columns "time, s" and "force on PLACE, N" beside a series, for its ParaView script."""
    columns = np.column_stack([frames.load_times, *frames.forces.values()])
    names = ["time, s", *(f"force on {on}, N" for on in frames.forces)]
    write_csv(path, [names, *columns.tolist()])
