"""Time series for ParaView: one VTK file a model and frame, and a ``.pvd`` index of them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.contact import PressureTable
from skfem_joint.errors import InputError
from skfem_joint.files import replacing, safe_name
from skfem_joint.structure import Structure

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

#: How the bar is drawn: swept to its width and thickness, or as a line.
SHAPES = ("swept", "line")

# Corners of a section in halves of width and thickness, counter-clockwise seen along the bar.
_CORNERS = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@dataclass(frozen=True)
class Field:
    """History of one model on all nodes of the bar.

    Attributes
    ----------
    name : str
        Name of the model's block, e.g. "full".
    displacement, velocity : ndarray, shape (frames, n_nodes)
        Along the bar, m and m/s.
    friction_force : ndarray, shape (frames, n_nodes)
        Along the bar, of the whole node, N.
    slip_state : ndarray of int, shape (frames, n_nodes)
        -1 no contact, 0 stick, 1 slip.
    """

    name: str
    displacement: FloatArray
    velocity: FloatArray
    friction_force: FloatArray
    slip_state: NDArray[np.int8]


def write_series(
    path: str | Path,
    structure: Structure,
    times: FloatArray,
    fields: Sequence[Field],
    *,
    shape: str = "swept",
) -> list[Path]:
    """Write histories as a series that ParaView opens, with a named block for each model.

    ``NAME.pvd`` is the index of ``NAME/BLOCK_0000.vtu`` and so on. Nodes carry ``displacement``
    (m), ``velocity`` (m/s) and ``friction_force`` (N) as vectors in space along the bar, and
    ``slip_state``. A swept bar has the nodal values at all corners of the node's section; where
    the section changes, the node has the corners of both. Elements carry ``clamping_pressure``
    (Pa, 0 outside joints) and ``region``: the position of the element's region in the field array
    ``region_names``, -1 without one, and of regions that overlap the one with fewest elements.

    Every file takes its place only when it is whole, the index last. An interruption by the
    keyboard leaves an index of the frames done until then and is raised again.

    Parameters
    ----------
    path : str or Path
        File name of the index, ending in ".pvd"; folders are made.
    structure : Structure
    times : ndarray, shape (frames,)
        Increasing, s.
    fields : sequence of Field
        One for each block, all at the same ``times``; frames beyond the last of them, which a
        model has when another was interrupted, are left out.
    shape : {"swept", "line"}
        Hexahedra with the section's width (across, horizontal) and thickness, or lines.

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
    blocks = [safe_name(field.name) for field in fields]
    problems = _problems(index, structure, times, fields, blocks, shape)
    if problems:
        raise InputError(problems)
    grid, source = _grid(structure, shape)
    axis = _axis(structure)
    folder = index.with_suffix("")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        index.unlink(missing_ok=True)  # it would list old frames among new ones
    except OSError as error:
        raise InputError(f"{index}: cannot be written: {error}") from error

    digits = max(4, len(str(times.size - 1)))
    frames: list[list[Path]] = []
    try:
        for k, time in enumerate(times):
            files = [folder / f"{block}_{k:0{digits}d}.vtu" for block in blocks]
            for file, field in zip(files, fields, strict=True):
                for name in ("displacement", "velocity", "friction_force"):
                    values = getattr(field, name)[k, source]
                    grid.point_data[name] = values[:, None] * axis
                grid.point_data["slip_state"] = field.slip_state[k, source].astype(np.int8)
                grid.field_data["TimeValue"] = [time]
                _write_grid(file, grid)
            frames.append(files)
        _write_index(index, times, fields, frames)
    except KeyboardInterrupt:
        if frames:
            _write_index(index, times, fields, frames)
        raise
    return [index, *(file for files in frames for file in files)]


def _problems(
    index: Path,
    structure: Structure,
    times: FloatArray,
    fields: Sequence[Field],
    blocks: Sequence[str],
    shape: str,
) -> list[str]:
    problems = []
    if index.suffix != ".pvd":
        problems.append(f"{index}: the name of a series for ParaView must end in .pvd")
    if shape not in SHAPES:
        problems.append(f"shape: found {shape!r}, must be one of {', '.join(SHAPES)}")
    if times.ndim != 1 or times.size == 0 or not np.all(np.isfinite(times)):
        problems.append("times: must be at least one finite number")
    elif np.any(np.diff(times) <= 0.0):
        problems.append("times: must be increasing")
    if not fields:
        problems.append("fields: found none, there must be at least one to write")
    if len({block.casefold() for block in blocks}) < len(blocks):
        names = ", ".join(repr(field.name) for field in fields)
        problems.append(f"fields: the names {names} lead to files of the same name")
    for field in fields:
        for name in ("displacement", "velocity", "friction_force", "slip_state"):
            found = getattr(field, name).shape
            if len(found) != 2 or found[0] < times.size or found[1] != structure.n_nodes:
                problems.append(
                    f"{field.name}.{name}: found shape {found}, must be (frames, nodes) = "
                    f"{(times.size, structure.n_nodes)}"
                )
    return problems


def _axis(structure: Structure) -> FloatArray:
    """Return the unit vector along the bar."""
    along = structure.bar.coordinates[-1] - structure.bar.coordinates[0]
    return np.asarray(along / np.linalg.norm(along))


def _grid(structure: Structure, shape: str) -> tuple[Any, IntArray]:
    """Grid with what does not change in time, and the node that each of its points stands for."""
    try:
        import pyvista
    except ImportError as error:
        raise InputError(
            "files for ParaView need pyvista: pip install 'skfem-joint[vtk]', or switch them off"
        ) from error

    n_elements = structure.E.size
    if shape == "line":
        source = np.arange(structure.n_nodes)
        points = structure.bar.coordinates
        cells = {pyvista.CellType.LINE: np.column_stack([source[:-1], source[1:]])}
    else:
        section = np.column_stack([structure.width, structure.thickness])
        jump = np.any(section[1:] != section[:-1], axis=1)
        left = np.arange(n_elements) + np.concatenate([[0], np.cumsum(jump)])
        node, size = np.empty(left[-1] + 2, dtype=np.intp), np.empty((left[-1] + 2, 2))
        for end in (0, 1):
            node[left + end] = np.arange(n_elements) + end
            size[left + end] = section
        corners = (size[:, None, :] * _CORNERS) @ _section_directions(_axis(structure))
        points = (structure.bar.coordinates[node][:, None, :] + corners).reshape(-1, 3)
        source = np.repeat(node, len(_CORNERS))
        cells = {pyvista.CellType.HEXAHEDRON: len(_CORNERS) * left[:, None] + np.arange(8)}

    grid = pyvista.UnstructuredGrid(cells, points)
    regions = structure.bar.regions
    region = np.full(n_elements, -1, dtype=np.int32)
    for name in sorted(regions, key=lambda name: regions[name].size, reverse=True):
        region[regions[name]] = list(regions).index(name)
    grid.cell_data["region"] = region
    if regions:
        grid.field_data["region_names"] = list(regions)
    pressure = np.zeros(n_elements)
    middle = structure.position[structure.bar.mesh.t].mean(axis=0)
    for joint in structure.joints:
        elements, p = structure.bar.regions[joint.region], joint.pressure
        pressure[elements] = p(middle[elements]) if isinstance(p, PressureTable) else p
    grid.cell_data["clamping_pressure"] = pressure
    return grid, source


def _section_directions(axis: FloatArray) -> FloatArray:
    """Directions of width (horizontal, across the bar) and thickness, shape (2, 3)."""
    across = np.cross([0.0, 0.0, 1.0], axis)
    length = np.linalg.norm(across)
    across = across / length if length > 1e-6 else np.array([0.0, 1.0, 0.0])
    return np.array([across, np.cross(axis, across)])


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
    index: Path, times: FloatArray, fields: Sequence[Field], frames: Sequence[Sequence[Path]]
) -> None:
    root = ET.Element("VTKFile", type="Collection", version="0.1")
    collection = ET.SubElement(root, "Collection")
    for time, files in zip(times[: len(frames)], frames, strict=True):
        for part, (field, file) in enumerate(zip(fields, files, strict=True)):
            ET.SubElement(
                collection,
                "DataSet",
                timestep=repr(float(time)),
                part=str(part),
                name=field.name,
                file=file.relative_to(index.parent).as_posix(),
            )
    ET.indent(root)
    with replacing(index) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)
