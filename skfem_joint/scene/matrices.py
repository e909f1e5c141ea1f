"""The table of matrices of one's own, and the files that it names."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, Tag
from scipy import sparse

from skfem_joint.array_files import read_array
from skfem_joint.arrays import FloatArray, as_dense
from skfem_joint.errors import InputError, refuse
from skfem_joint.mesh.named import name_problems
from skfem_joint.scene.messages import LIST, NUMBER, WORD, mistake
from skfem_joint.scene.values import FileName, SceneTable, key, one_of
from skfem_joint.structure import MatrixModel
from skfem_joint.structure.matrices import COLUMNS
from skfem_joint.system import vector_of
from skfem_joint.unknowns import dof_numbers

_Dof = Annotated[int, Field(ge=0)]


def _is_name(name: str) -> str:
    if problems := name_problems(name=[name]):
        raise mistake(problems[0])
    return name


_Name = Annotated[str, AfterValidator(_is_name)]


class MatricesTable(SceneTable):
    """``[matrices]``: the structure as matrices, such as another program exports them."""

    K: FileName = key(
        "stiffness matrix, N/m; a file, relative to the scene: .npz of scipy.sparse, MatrixMarket "
        ".mtx or MATLAB .mat, where 'model.mat:K' names a variable"
    )
    M: FileName = key("mass matrix, kg; a file as for K")
    C: FileName | None = key("damping matrix, N s/m; a file as for K", None)
    contact: dict[_Name, FileName] = key(
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
        _Name,
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
        refuse(
            f"matrices.{k}: {files[k]}: found shape {found[k].shape}, more values than {n} degrees "
            "of freedom can have"
            for k in files
            if k not in ("K", "M", "C") and math.prod(found[k].shape) > COLUMNS * n
        )
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
