"""The table ``[matrices]``: a structure as matrices in files instead of a mesh."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, Tag
from scipy import sparse

from skfem_joint.ground.array_files import read_array
from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.mesh.named import name_problems
from skfem_joint.scene.messages import Form, mistake
from skfem_joint.scene.values import FileName, SceneTable, TomlList, by_form, key
from skfem_joint.structure.matrices import COLUMNS, MatrixModel
from skfem_joint.system.system import vector_of
from skfem_joint.system.unknowns import dof_numbers


def _is_name(name: str) -> str:
    if problems := name_problems(name=[name]):
        raise mistake(problems[0])
    return name


_Dof = Annotated[int, Field(ge=0)]
_Name = Annotated[str, AfterValidator(_is_name)]


class MatricesTable(SceneTable):
    """``[matrices]``: the structure as matrices that another program has exported."""

    K: FileName = key(
        "stiffness matrix, N/m; a file, relative to the scene: .npz of scipy.sparse, MatrixMarket "
        ".mtx or MATLAB .mat, where 'model.mat:K' names a variable"
    )
    M: FileName = key("mass matrix, kg; a file as for K")
    C: FileName | None = key("damping matrix, N s/m; a file as for K", None)
    contact: dict[_Name, FileName] = key(
        "pairs of nodes by the name of the contact: CSV or a file as for K; each row has the x, y "
        "and z degrees of freedom of the first node and of the second (none: a rigid base), the "
        "normal x, y, z, the area in m², and the gap in m if there are gaps; empty, or a number "
        "below first, where there is no degree of freedom. With contact = 'unilateral' in the "
        "joint the normal points from the first node to the second, or into the base",
        {},
    )
    fixed: Annotated[
        Annotated[FileName, Tag(Form.WORD)] | Annotated[TomlList[_Dof], Tag(Form.LIST)],
        by_form(Form.WORD, otherwise=Form.LIST),
    ] = key("degrees of freedom that are held: a list, or CSV or a file as for K", ())
    points: dict[
        _Name,
        Annotated[
            Annotated[FileName, Tag(Form.WORD)] | Annotated[_Dof, Tag(Form.NUMBER)],
            by_form(Form.WORD),
        ],
    ] = key(
        "loaded or observed points by name: a degree of freedom, or CSV or a file as for K with a "
        "vector of weights of all degrees of freedom",
        {},
    )
    first: Literal[0, 1] = key("number of the first degree of freedom, also in the files", 0)
    _arrays: dict[str, Any] = PrivateAttr(default_factory=dict)

    def model(self, folder: Path, common: Mapping[str, Any]) -> MatrixModel:
        """Structure with the matrices in the files of a folder.

        Parameters
        ----------
        folder : Path
            Folder to which file names are relative. Each file is read once.
        common : mapping
            Joints and damping, as arguments of `MatrixModel`.

        Raises
        ------
        InputError
            For files that cannot be read and for mistakes in their contents, with key and file.
        """
        files, arrays = self._files(), self._read(folder)
        n = arrays["K"].shape[0]
        matrices = {k: sparse.csr_array(arrays[k]) for k in ("K", "M", "C") if k in files}
        try:
            return MatrixModel(
                **matrices,
                contacts={k: self._pairs(as_dense(arrays[f"contact.{k}"])) for k in self.contact},
                points={k: self._point(k, n) for k in self.points},
                fixed=dof_numbers(
                    as_dense(arrays.get("fixed", self.fixed)), n, "fixed", self.first
                ),
                first=self.first,
                **common,
            )
        except InputError as error:
            raise InputError([_with_file(problem, files) for problem in error.problems]) from error

    def _files(self) -> dict[str, str]:
        """Names of the files by the key, within this table, that names them."""
        values: dict[str, Any] = {"K": self.K, "M": self.M, "C": self.C, "fixed": self.fixed}
        values |= {f"contact.{name}": file for name, file in self.contact.items()}
        values |= {f"points.{name}": value for name, value in self.points.items()}
        return {where: value for where, value in values.items() if isinstance(value, str)}

    def _read(self, folder: Path) -> dict[str, Any]:
        """Arrays by key; those of K, M and C are square, and no other is larger than they allow."""
        files = self._files()
        problems: list[str] = []
        for where, file in files.items():
            if where not in self._arrays:
                try:
                    self._arrays[where] = read_array(folder, file)
                except InputError as error:
                    problems += [f"matrices.{where}: {problem}" for problem in error.problems]
        refuse(problems)
        shapes = {where: self._arrays[where].shape for where in files}
        square = [where for where in ("K", "M", "C") if where in files]
        refuse(
            f"matrices.{where}: {files[where]}: found shape {shapes[where]}, must be a square "
            "matrix"
            for where in square
            if len(shapes[where]) != 2 or len({*shapes[where]}) != 1
        )
        n = shapes["K"][0]
        refuse(
            f"matrices.{where}: {files[where]}: found shape {shapes[where]}, more values than {n} "
            "degrees of freedom can have"
            for where in files
            if where not in square and math.prod(shapes[where]) > COLUMNS * n
        )
        return self._arrays

    def _pairs(self, rows: FloatArray) -> FloatArray:
        """Rows of a contact with degrees of freedom that count from 0."""
        pairs = np.atleast_2d(rows).copy()
        pairs[:, :6] -= self.first
        return pairs

    def _point(self, name: str, n: int) -> FloatArray:
        """Weights of a point, shape (n,)."""
        value = self._arrays.get(f"points.{name}", self.points[name])
        if not isinstance(value, int):
            value = as_dense(value)
            value = value.ravel() if value.size == n else value
        return vector_of(value, n, f"points.{name}", self.first)


def _with_file(problem: str, files: Mapping[str, str]) -> str:
    """Problem of a `MatrixModel` with the key of the scene and the file that it is about."""
    where, _, what = problem.partition(": ")
    if where not in (*files, "fixed") and not where.startswith("points."):
        return problem
    return f"matrices.{where}: " + (f"{files[where]}: " if where in files else "") + what
