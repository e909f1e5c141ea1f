"""The table ``[matrices]``: a structure as matrices in files instead of a mesh."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, Tag

from skfem_joint.ground.array_files import read_array
from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.matrix_files.given import GivenMatrix
from skfem_joint.matrix_files.labels import place_of, read_labels
from skfem_joint.matrix_files.model import GivenModel, in_one_order
from skfem_joint.matrix_files.reading import read_matrix
from skfem_joint.matrix_files.units import SYSTEMS, in_si
from skfem_joint.mesh.named import name_problems
from skfem_joint.scene.messages import Form, mistake
from skfem_joint.scene.unknowns import NamedUnknowns, NumberedUnknowns
from skfem_joint.scene.values import FileName, SceneTable, TomlList, by_form, key
from skfem_joint.structure.matrices import COLUMNS, MatrixModel


def _is_name(name: str) -> str:
    if problems := name_problems(name=[name]):
        raise mistake(problems[0])
    return name


def _is_place(text: str) -> str:
    if place_of(text) is None:
        raise mistake(
            f"found {text!r}, must be a node, '12', or a node and a direction, '12.x': x, y, z, "
            "rx, ry, rz or 1 to 6"
        )
    return text


_Dof = Annotated[int, Field(ge=0)]
_Name = Annotated[str, AfterValidator(_is_name)]
_Held = Annotated[
    Annotated[Annotated[str, AfterValidator(_is_place)], Tag(Form.WORD)]
    | Annotated[_Dof, Tag(Form.NUMBER)],
    by_form(Form.WORD),
]


class MatricesTable(SceneTable):
    """``[matrices]``: the structure as matrices that another program has exported."""

    K: FileName = key(
        "stiffness matrix, N/m; a file, relative to the scene, whose format is told by its "
        "content: .npz of scipy.sparse, MatrixMarket, MATLAB, Abaqus .mtx, CalculiX .sti, Nastran "
        "OUTPUT4 or DMIG, ANSYS .full; 'model.mat:K' names a matrix in it"
    )
    M: FileName = key("mass matrix, kg; a file as for K")
    C: FileName | None = key("damping matrix, N s/m; a file as for K", None)
    units: Literal["m kg s", "mm t s", "mm kg ms", "mm kg s", "in lbf s"] = key(
        "units of length, mass (or force) and time of the files, which are converted to SI: those "
        "of the matrices, and of areas and gaps of contacts",
        "m kg s",
    )
    unknowns: FileName | None = key(
        "node and direction of each row of the matrices, where their files do not tell: a line "
        "'12.1' or '12, x' for each, as CalculiX's .dof",
        None,
    )
    contact: dict[_Name, FileName] = key(
        "pairs of nodes by the name of the contact, in a table: CSV, .npz, MatrixMarket or MATLAB; "
        "each row has the x, y and z degrees of freedom of the first node and of the second (none: "
        "a rigid base), the normal x, y, z, the area in m², and the gap in m if there are gaps; "
        "empty, or a number below first, where there is no degree of freedom. Where unknowns have "
        "names, the numbers of both nodes in place of the six. With contact = 'unilateral' in the "
        "joint the normal points from the first node to the second, or into the base",
        {},
    )
    fixed: Annotated[
        Annotated[FileName, Tag(Form.WORD)] | Annotated[TomlList[_Held], Tag(Form.LIST)],
        by_form(Form.WORD, otherwise=Form.LIST),
    ] = key(
        "degrees of freedom that are held: a list, or a table as for contacts. Where unknowns have "
        "names, nodes, 12, or nodes with a direction, '12.x'; in a table with a second column",
        (),
    )
    points: dict[
        _Name,
        Annotated[
            Annotated[FileName, Tag(Form.WORD)] | Annotated[_Dof, Tag(Form.NUMBER)],
            by_form(Form.WORD),
        ],
    ] = key(
        "loaded or observed points by name: a degree of freedom, or a table as for contacts with a "
        "vector of weights of all degrees of freedom. Where unknowns have names, '12.x', or rows "
        "of node, direction (1 to 6) and weight",
        {},
    )
    first: Literal[0, 1] = key("number of the first degree of freedom, also in the files", 0)
    _arrays: dict[str, Any] = PrivateAttr(default_factory=dict)
    _matrices: dict[str, GivenMatrix] = PrivateAttr(default_factory=dict)

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
        files, given = self._files(), self._given(folder)
        n = given.matrices["K"].shape[0]
        arrays = self._tables(folder, n)
        try:
            matrices = in_si(given.matrices, given.labels, self.units)
            values = {f"points.{k}": value for k, value in self.points.items()}
            values |= {"fixed": self.fixed} | arrays
            unknowns = (
                NumberedUnknowns(n, self.first, values)
                if given.labels is None
                else NamedUnknowns(given.labels, self.first)
            )
            return MatrixModel(
                **{k: A for k, A in matrices.items() if k in files},
                contacts={k: self._pairs(k, unknowns) for k in self.contact},
                points={
                    k: unknowns.weights(f"points.{k}", values[f"points.{k}"]) for k in self.points
                },
                fixed=np.union1d(unknowns.held(values["fixed"]), given.held).astype(np.intp),
                first=self.first,
                labels=given.labels,
                remarks=given.notes,
                **common,
            )
        except InputError as error:
            raise InputError([_with_file(problem, files) for problem in error.problems]) from error

    def _files(self) -> dict[str, str]:
        """Names of the files by the key, within this table, that names them."""
        values: dict[str, Any] = {"K": self.K, "M": self.M, "C": self.C, "fixed": self.fixed}
        values |= {f"contact.{name}": file for name, file in self.contact.items()}
        values |= {f"points.{name}": value for name, value in self.points.items()}
        if isinstance(self.unknowns, str):
            values["unknowns"] = self.unknowns
        return {
            where: value
            for where, value in values.items()
            if isinstance(value, str) and not (where.startswith("points.") and place_of(value))
        }

    def _given(self, folder: Path) -> GivenModel:
        """Matrices in one order of unknowns; each file is read once."""
        files, problems = self._files(), list[str]()
        for letter in (letter for letter in ("K", "M", "C") if letter in files):
            if letter not in self._matrices:
                try:
                    self._matrices[letter] = read_matrix(folder, files[letter], letter)
                except InputError as error:
                    problems += [f"matrices.{letter}: {problem}" for problem in error.problems]
        refuse(problems)
        matrices = {k: x for k, x in self._matrices.items() if k in files}
        refuse(
            f"matrices.{k}: {files[k]}: found shape {x.matrix.shape}, must be a square matrix"
            for k, x in matrices.items()
            if x.matrix.shape[0] != x.matrix.shape[1]
        )
        named = None
        try:
            if self.unknowns is not None:
                named = read_labels(folder / self.unknowns)
            return in_one_order(matrices, named)
        except InputError as error:
            where = "" if str(error).startswith(("K:", "M:", "C:", "unknowns:")) else "unknowns: "
            raise InputError(f"matrices.{where}{error}") from error

    def _tables(self, folder: Path, n: int) -> dict[str, Any]:
        """Arrays of contacts, points and supports; none is larger than their numbers allow."""
        files, problems = self._files(), list[str]()
        tables = [k for k in files if k not in ("K", "M", "C", "unknowns")]
        for where in (where for where in tables if where not in self._arrays):
            try:
                self._arrays[where] = read_array(folder, files[where])
            except InputError as error:
                problems += [f"matrices.{where}: {problem}" for problem in error.problems]
        refuse(problems)
        shapes = {where: self._arrays[where].shape for where in tables}
        refuse(
            f"matrices.{where}: {files[where]}: found shape {shape}, more values than {n} "
            "degrees of freedom can have"
            for where, shape in shapes.items()
            if math.prod(shape) > COLUMNS * n
        )
        return self._arrays

    def _pairs(self, name: str, unknowns: NamedUnknowns | NumberedUnknowns) -> FloatArray:
        """Rows of a contact with degrees of freedom that count from 0, in m² and m."""
        where, length = f"contact.{name}", SYSTEMS[self.units][0]
        pairs = unknowns.pairs(where, np.atleast_2d(as_dense(self._arrays[where])))
        pairs[:, 9:10] *= length**2
        pairs[:, 10:11] *= length
        return pairs


def _with_file(problem: str, files: Mapping[str, str]) -> str:
    """Problem of a `MatrixModel` with the key of the scene and the file that it is about."""
    where, _, what = problem.partition(": ")
    if where not in (*files, "fixed") and not where.startswith("points."):
        return problem
    return f"matrices.{where}: " + (f"{files[where]}: " if where in files else "") + what
