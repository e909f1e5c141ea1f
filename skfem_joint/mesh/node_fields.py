"""Fields of nodes in mesh files of Gmsh ($NodeData), such as those of views that were saved."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import read_whole
from skfem_joint.mesh.gmsh import check_msh
from skfem_joint.mesh.reading import group_nodes


def node_field(path: Path, name: str, on: str) -> tuple[FloatArray, FloatArray]:
    """Places of the nodes of a physical group, and the values that a field has there.

    Parameters
    ----------
    path : Path
        Gmsh file.
    name : str
        Of the field: the first text of its section $NodeData.
    on : str
        Name of the group.

    Returns
    -------
    places : ndarray, shape (k, 3)
        In the unit of the file.
    values : ndarray, shape (k,)

    Raises
    ------
    InputError
        If the file cannot be read as a mesh, if it has no such group, or not one such field of
        one component, and if nodes of the group have no value.
    """
    nodes, places = group_nodes(path, on)
    data = read_whole(path)
    number = np.sort(check_msh(data)[1])[nodes]
    try:
        fields = [*_node_data(data)]
    except (ValueError, IndexError, OverflowError, MemoryError) as error:
        raise InputError(f"{path}: a section $NodeData is cut or damaged: {error}") from error
    found = [(tags, values) for title, tags, values in fields if title == name]
    titles = dict.fromkeys(title for title, _, _ in fields)
    where = f"{path}: field {name!r}"
    if len(found) != 1:
        raise InputError(
            f"{where}: found {len(found)} of this name in $NodeData, must be one; the file has "
            f"{', '.join(titles) or 'none'}"
        )
    ((tags, values),) = found
    if values.shape[1] != 1:
        raise InputError(f"{where}: found {values.shape[1]} components, must be one")
    known = dict(zip(tags.tolist(), values[:, 0].tolist(), strict=True))
    there = np.array([known.get(tag, np.nan) for tag in number.tolist()])
    lacks = ~np.isfinite(there)
    if lacks.any():
        raise InputError(
            f"{where}: {np.count_nonzero(lacks)} of {nodes.size} nodes of {on!r} have no finite "
            f"value, first node {number[lacks][0]}"
        )
    return places, there


def _node_data(data: bytes) -> Iterator[tuple[str, IntArray, FloatArray]]:
    """Title, numbers of nodes (k,), and values (k, components) of each section $NodeData.

    ValueError, IndexError, OverflowError or MemoryError if a section is damaged.
    """
    head = re.search(rb"\$MeshFormat\s+\S+\s+(\d)", data)
    binary = head is not None and head[1] == b"1"
    for match in re.finditer(rb"^\$NodeData[ \t]*\r?\n(.*?)^\$EndNodeData", data, re.M | re.S):
        rest, tags = match[1], list[list[bytes]]()
        for _ in range(3):  # texts, real numbers, whole numbers: a count, then a line for each
            count, _, rest = rest.partition(b"\n")
            *lines, rest = rest.split(b"\n", int(count))
            tags.append(lines)
        components, count = int(tags[2][1]), int(tags[2][2])
        if binary:
            record = np.dtype([("tag", "i4"), ("value", "f8", (components,))])
            rows = np.frombuffer(rest, record, count)
            numbers, values = rows["tag"].astype(np.intp), rows["value"].astype(np.float64)
        else:
            table = np.array(rest.split(), dtype=np.float64).reshape(count, 1 + components)
            numbers, values = table[:, 0].astype(np.intp), table[:, 1:]
        yield tags[0][0].decode().strip().strip('"'), numbers, values
