"""The table of matrices of one's own, and the files that it names."""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PrivateAttr, Tag
from scipy import sparse

from skfem_joint.arrays import FloatArray, as_dense
from skfem_joint.errors import InputError, refuse
from skfem_joint.files import read_whole
from skfem_joint.scene.messages import LIST, NUMBER, WORD
from skfem_joint.scene.values import FileName, SceneTable, key, one_of
from skfem_joint.structure import MatrixModel
from skfem_joint.system import vector_of
from skfem_joint.unknowns import dof_numbers

#: What the readers raise for files that are damaged or of another kind.
_FAILURES = (
    *(ValueError, TypeError, KeyError, IndexError, AttributeError, OSError, EOFError),
    *(NotImplementedError, OverflowError, MemoryError, zipfile.BadZipFile, zlib.error),
)
_WITH_VARIABLE = re.compile(r"(.+\.(?:mat|npz)):(\w+)", re.IGNORECASE)
_Dof = Annotated[int, Field(ge=0)]


class MatricesTable(SceneTable):
    """``[matrices]``: the structure as matrices, such as another program exports them."""

    K: FileName = key(
        "stiffness matrix, N/m; a file, relative to the scene: .npz of scipy.sparse, MatrixMarket "
        ".mtx or MATLAB .mat, where 'model.mat:K' names a variable"
    )
    M: FileName = key("mass matrix, kg; a file as for K")
    C: FileName | None = key("damping matrix, N s/m; a file as for K", None)
    contact: dict[str, FileName] = key(
        "pairs of nodes by the name of the contact: CSV or a file as for K, a row each of x, y, z "
        "degrees of freedom of the first node, of the second (none: a rigid base), normal x, y, z "
        "and area in m²; empty, or a number below first, where there is no degree of freedom",
        {},
    )
    fixed: Annotated[
        Annotated[FileName, Tag(WORD)]
        | Annotated[tuple[_Dof, ...], Field(strict=False), Tag(LIST)],
        one_of(WORD, otherwise=LIST),
    ] = key("degrees of freedom that are held: a list, or CSV or a file as for K", ())
    points: dict[
        str,
        Annotated[
            Annotated[FileName, Tag(WORD)] | Annotated[_Dof, Tag(NUMBER)],
            one_of(WORD),
        ],
    ] = key(
        "what is loaded or observed, by name: a degree of freedom, or CSV or a file as for K with "
        "a vector of all",
        {},
    )
    first: Literal[0, 1] = key("number of the first degree of freedom, in files too", 0)
    _read: dict[str, Any] = PrivateAttr(default_factory=dict)

    def model(self, folder: Path, how: Mapping[str, Any]) -> MatrixModel:
        """Structure with the matrices in files of a folder, which are read once.

        Raises
        ------
        InputError
            Files that cannot be read, and what is wrong in them, by key and file.
        """
        files = {k: name for k in ("K", "M", "C") if (name := getattr(self, k)) is not None}
        files |= {f"contact.{name}": file for name, file in self.contact.items()}
        files |= {f"points.{k}": file for k, file in self.points.items() if isinstance(file, str)}
        files |= {"fixed": self.fixed} if isinstance(self.fixed, str) else {}
        problems: list[str] = []
        for where, file in files.items():
            if where not in self._read:
                try:
                    self._read[where] = read_array(folder, file)
                except InputError as error:
                    problems += [f"matrices.{where}: {problem}" for problem in error.problems]
        refuse(problems)
        found = self._read
        refuse(
            f"matrices.{k}: {files[k]}: found shape {found[k].shape}, must be a square matrix"
            for k in files
            if k in ("K", "M", "C") and not (found[k].ndim == 2 and len({*found[k].shape}) == 1)
        )
        n = found["K"].shape[0]
        try:
            return MatrixModel(
                **{k: sparse.csr_array(found[k]) for k in ("K", "M", "C") if k in found},
                contacts={k: self._pairs(as_dense(found[f"contact.{k}"])) for k in self.contact},
                points={k: self._point(k, n) for k in self.points},
                fixed=dof_numbers(as_dense(found.get("fixed", self.fixed)), n, "fixed", self.first),
                first=self.first,
                **how,
            )
        except InputError as error:
            raise InputError([_placed(problem, files) for problem in error.problems]) from error

    def _pairs(self, rows: FloatArray) -> FloatArray:
        """Rows of a contact whose degrees of freedom count from 0."""
        pairs = np.atleast_2d(rows).copy()
        pairs[:, :6] -= self.first
        return pairs

    def _point(self, name: str, n: int) -> FloatArray:
        given = self._read.get(f"points.{name}", self.points[name])
        if not isinstance(given, int):
            given = as_dense(given)
            given = given.ravel() if given.size == n else given
        return vector_of(given, n, f"points.{name}", self.first)


def _placed(problem: str, files: Mapping[str, str]) -> str:
    """A problem that starts with a key of the matrices, with the file that it is in."""
    where, _, what = problem.partition(": ")
    if where not in (*files, "fixed") and not where.startswith("points."):
        return problem
    return f"matrices.{where}: " + (f"{files[where]}: " if where in files else "") + what


def read_array(folder: Path, name: str) -> Any:
    """Array, sparse if it is stored so, from a .npz, .mtx, .mat or .csv file, by its ending.

    Raises
    ------
    InputError
        A file that cannot be read or is none of these, is damaged, or has no such variable.
    """
    file, variable = match.groups() if (match := _WITH_VARIABLE.fullmatch(name)) else (name, None)
    path = folder / file
    if path.suffix.lower() not in _READERS:
        raise InputError(
            f"{path}: unknown ending {path.suffix!r}, must be one of {', '.join(_READERS)}"
        )
    content = read_whole(path)
    try:
        found = _READERS[path.suffix.lower()](content)
    except _FAILURES as error:
        later = content[:128].startswith(b"MATLAB 7.3")
        cure = "; of version 7.3: save it with -v7" if later else ""
        raise InputError(f"{path}: is damaged, or no such file: {error}{cure}") from error
    if isinstance(found, dict):
        if variable is None and len(found) == 1:
            (variable,) = found
        if variable not in found:
            names = ", ".join(sorted(found)) or "none"
            what = "name one, as in" if variable is None else f"found no {variable!r}, as in"
            raise InputError(f"{path}: {what} '{file}:NAME'; it has {names}")
        found = found[variable]
    elif variable is not None:
        raise InputError(f"{path}: holds one sparse matrix without a name; leave ':{variable}' out")
    if not np.issubdtype(found.dtype, np.number) or np.issubdtype(found.dtype, np.complexfloating):
        raise InputError(f"{path}: found {found.dtype} values, must be real numbers")
    return found


def _npz(content: bytes) -> Any:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        if "format" not in arrays:
            return {name: arrays[name] for name in arrays}
    return sparse.load_npz(io.BytesIO(content))


def _mtx(content: bytes) -> Any:
    from scipy.io import mmread

    return mmread(io.BytesIO(content))


def _mat(content: bytes) -> dict[str, Any]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        found = loadmat(io.BytesIO(content))
    except MatReadError as error:
        raise ValueError(error) from error
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _csv(content: bytes) -> FloatArray:
    """Rows of numbers, NaN for nothing; a header and what follows a ``#`` are passed over."""
    rows: list[list[float]] = []
    for number, line in enumerate(content.decode("utf-8-sig").splitlines(), start=1):
        text = line.split("#", 1)[0].strip()
        try:
            row = [float(cell) if cell.strip() else np.nan for cell in text.split(",")]
        except ValueError as error:
            if not rows and not re.search(r"(^|,)\s*[\d.+-]+\s*(,|$)", text):
                continue
            raise ValueError(f"line {number}: {error}") from error
        if text and rows and len(row) != len(rows[0]):
            raise ValueError(f"line {number}: found {len(row)} columns, must be {len(rows[0])}")
        rows += [row] if text else []
    return np.array(rows)


_READERS: Mapping[str, Callable[[bytes], Any]] = {
    ".npz": _npz,
    ".mtx": _mtx,
    ".mat": _mat,
    ".csv": _csv,
}
