"""Series of VTK files and the ``.pvd`` index that makes them one for ParaView."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import InputError
from skfem_joint.files import replacing, safe_name

FloatArray = NDArray[np.float64]


def needed_pyvista(what: str) -> Any:
    """The library pyvista.

    Raises
    ------
    InputError
        If it is missing; ``what`` says what it is needed for.
    """
    try:
        import pyvista
    except ImportError as error:
        raise InputError(
            f"{what} need pyvista: pip install 'skfem-joint[vtk]', or switch them off"
        ) from error
    return pyvista


def region_numbers(regions: Mapping[str, NDArray[Any]], elements: int) -> NDArray[np.int32]:
    """Position in ``regions`` of the region of each element, -1 without one.

    Of regions that overlap it is the one with fewest elements.
    """
    names = list(regions)
    number = np.full(elements, -1, dtype=np.int32)
    for name in sorted(names, key=lambda name: regions[name].size, reverse=True):
        number[regions[name]] = names.index(name)
    return number


def series_problems(index: Path, times: FloatArray, names: Sequence[str]) -> list[str]:
    """Mistakes in what every series needs: the index's name, times, and names of blocks."""
    problems = []
    if index.suffix != ".pvd":
        problems.append(f"{index}: the name of a series for ParaView must end in .pvd")
    if times.ndim != 1 or times.size == 0 or not np.all(np.isfinite(times)):
        problems.append("times: must be at least one finite number")
    elif np.any(np.diff(times) <= 0.0):
        problems.append("times: must be increasing")
    if not names:
        problems.append("fields: found none, there must be at least one to write")
    if len({safe_name(name).casefold() for name in names}) < len(names):
        found = ", ".join(repr(name) for name in names)
        problems.append(f"fields: the names {found} lead to files of the same name")
    return problems


def write_frames(
    index: Path,
    times: FloatArray,
    names: Sequence[str],
    grids: Callable[[int], Iterable[Any]],
) -> list[Path]:
    """Write the frames of a series and its index.

    ``NAME.pvd`` is the index of ``NAME/BLOCK_0000.vtu`` and so on. Every file takes its place only
    when it is whole, the index last. An interruption by the keyboard leaves an index of the frames
    done until then and is raised again.

    Parameters
    ----------
    index : Path
    times : ndarray, shape (frames,)
    names : sequence of str
        Of the blocks.
    grids : callable
        From the number of a frame, the grid of each block; a grid may be used again once the next
        one is asked for.

    Returns
    -------
    list of Path
        The index and the files of the frames.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
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
            files = [folder / f"{safe_name(name)}_{k:0{digits}d}.vtu" for name in names]
            for file, grid in zip(files, grids(k), strict=True):
                grid.field_data["TimeValue"] = [time]
                write_grid(file, grid)
            frames.append(files)
        write_index(index, times, names, frames)
    except KeyboardInterrupt:
        if frames:
            write_index(index, times, names, frames)
        raise
    return [index, *(file for files in frames for file in files)]


def write_grid(file: Path, grid: Any) -> None:
    """Write a grid as ``.vtu``: appended and LZ4, the fastest that ParaView reads."""
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


def write_index(
    index: Path, times: FloatArray, names: Sequence[str], frames: Sequence[Sequence[Path]]
) -> None:
    """Write the index of the frames that are done."""
    root = ET.Element("VTKFile", type="Collection", version="0.1")
    collection = ET.SubElement(root, "Collection")
    for time, files in zip(times[: len(frames)], frames, strict=True):
        for part, (name, file) in enumerate(zip(names, files, strict=True)):
            ET.SubElement(
                collection,
                "DataSet",
                timestep=repr(float(time)),
                part=str(part),
                name=name,
                file=file.relative_to(index.parent).as_posix(),
            )
    ET.indent(root)
    with replacing(index) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)
