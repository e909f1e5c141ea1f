"""Time series for ParaView: one VTK file a model and frame, and a ``.pvd`` index of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.contact import PressureTable
from skfem_joint.errors import InputError
from skfem_joint.structure import Structure
from skfem_joint.vtk_files import needed_pyvista, region_numbers, series_problems, write_frames

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
    problems = _problems(index, structure, times, fields, shape)
    if problems:
        raise InputError(problems)
    grid, source = _grid(structure, shape)
    axis = _axis(structure)

    def grids(k: int) -> Iterator[Any]:
        for field in fields:
            for name in ("displacement", "velocity", "friction_force"):
                values = getattr(field, name)[k, source]
                grid.point_data[name] = values[:, None] * axis
            grid.point_data["slip_state"] = field.slip_state[k, source].astype(np.int8)
            yield grid

    return write_frames(index, times, [field.name for field in fields], grids)


def _problems(
    index: Path,
    structure: Structure,
    times: FloatArray,
    fields: Sequence[Field],
    shape: str,
) -> list[str]:
    problems = series_problems(index, times, [field.name for field in fields])
    if shape not in SHAPES:
        problems.append(f"shape: found {shape!r}, must be one of {', '.join(SHAPES)}")
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
    pyvista = needed_pyvista("files for ParaView")
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
    grid.cell_data["region"] = region_numbers(regions, n_elements)
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
