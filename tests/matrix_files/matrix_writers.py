"""Small writers of matrices in the formats of other programs, after their documentation.

Formats that a program here writes are written by it: CalculiX's files stand in ``calculix``, and
pyYeti writes OUTPUT4.
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse


def abaqus_rows(path: Path, A: Any, labels: np.ndarray, half: str = "whole") -> None:
    """``*MATRIX OUTPUT, FORMAT=MATRIX INPUT``: the whole matrix, or one half by any order.

    Abaqus Keywords Guide, "*MATRIX INPUT": row node, row degree of freedom, column node, column
    degree of freedom, entry; lower triangular, upper triangular or square.
    """
    entries = sparse.coo_array(A)
    kept = {
        "whole": np.ones(entries.nnz, dtype=bool),
        "lower": entries.coords[0] >= entries.coords[1],
        "upper": entries.coords[0] <= entries.coords[1],
    }
    # Abaqus orders its unknowns otherwise inside, so that a half is one by another order.
    order = np.random.default_rng(0).permutation(len(labels))
    kept["other"] = order[entries.coords[0]] >= order[entries.coords[1]]
    rows = zip(*(x[kept[half]] for x in (*entries.coords, entries.data)), strict=True)
    lines = [
        f"{labels[i][0]},{labels[i][1]}, {labels[j][0]},{labels[j][1]}, {x:.17e}"
        for i, j, x in rows
    ]
    path.write_text("\n".join(lines) + "\n")


def coordinates(path: Path, A: Any) -> None:
    """``*MATRIX OUTPUT, FORMAT=COORDINATE``: row, column, entry, counted from 1."""
    entries = sparse.coo_array(A)
    rows = zip(*entries.coords, entries.data, strict=True)
    path.write_text("".join(f"{i + 1}, {j + 1}, {x:.17e}\n" for i, j, x in rows))


def substructure(path: Path, matrices: dict[str, Any], labels: np.ndarray, modes: int = 0) -> None:
    """``*SUBSTRUCTURE MATRIX OUTPUT, OUTPUT FILE=USER DEFINED``: cards of a linear user element.

    Abaqus Keywords Guide, "*USER ELEMENT" and "*MATRIX": degrees of freedom of the first node, then
    of those nodes, by their position, at which others begin; the lower half by rows, four numbers
    in a line, each row in a line of its own. The last unknowns may be modes, without a node.
    """
    own = labels[: len(labels) - modes]
    nodes, first = np.unique(own[:, 0], return_index=True)
    nodes = nodes[np.argsort(first)]
    lines = ["**", "** SUBSTRUCTURE", f"*USER ELEMENT, NODES= {len(nodes) + modes}, LINEAR"]
    lines += ["** ELEMENT NODES"]
    lines += [
        "** " + ", ".join(map(str, nodes[k : k + 10])) + "," for k in range(0, len(nodes), 10)
    ]
    for position, node in enumerate(nodes, start=1):
        directions = ", ".join(str(x) for x in own[own[:, 0] == node, 1])
        lines.append(directions if position == 1 else f"{position}, {directions}")
    lines += [f"{len(nodes) + 1}, 1"] if modes else []
    for kind, A in matrices.items():
        lines.append(f"*MATRIX, TYPE={kind}")
        for i, row in enumerate(np.asarray(A)):
            cells = [f"{x:.16e}" for x in row[: i + 1]]
            lines += [", ".join(cells[k : k + 4]) + "," for k in range(0, i + 1, 4)]
    path.write_text("\n".join(lines) + "\n")


def dmig(path: Path, matrices: dict[str, Any], labels: np.ndarray, free: bool = False) -> None:
    """A punch file with DMIG entries, symmetric by the lower half.

    MSC Nastran Quick Reference Guide, "DMIG": a header with form 6 and type 2 (double precision),
    columns in fields of 16 characters with exponents by D, or between commas.
    """
    lines = ["$TITLE = LAP", "BEGIN BULK", "GRID           1       0      0.      0.      0."]
    for name, A in matrices.items():
        lines.append(f"DMIG    {name:8}       0       6       2       0{'':16}{len(labels):8}")
        rows = sparse.csr_array(sparse.triu(A))  # columns of the lower half
        for column, (node, direction) in enumerate(labels):
            own = slice(rows.indptr[column], rows.indptr[column + 1])
            if own.start == own.stop:
                continue
            head = f"DMIG*   {name:16}{node:16}{direction:16}"
            lines.append(f"DMIG*,{name},{node},{direction}," if free else head)
            for i, x in zip(rows.indices[own], rows.data[own], strict=True):
                point, component = labels[i]
                value = f"{x:.9E}".replace("E", "D")
                cells = f"*       {point:16}{component:16}{value:>16}"
                lines.append(f"*,{point},{component},{x:.16E}" if free else cells)
    path.write_text("\n".join(lines) + "\nENDDATA\n")
