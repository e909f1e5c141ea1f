"""Values of the package in other forms: as JSON and arrays for files, and results as tables.

Files are read without running code.

A digest of them says whether they are the same.

Dataclasses become their fields by name, and are made again from those: only classes that the reader
lists are made. Tuples, lists, mappings with names, numbers and texts are what they are.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.ground.array_files import sparse_array, sparse_parts
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import needed

#: Called with a name and an array; returns what stands for the array in JSON.
Keep = Callable[[str, NDArray[Any]], Any]
#: Key of an object of JSON that stands for an array, a matrix, a tuple or a dataclass begins so.
_TAG = "!"


class PlainForm:
    """JSON form of values among which may be dataclasses of some classes.

    Parameters
    ----------
    classes : iterable of type
    """

    def __init__(self, classes: Iterable[type]) -> None:
        self.classes: dict[str, Any] = {one.__name__: one for one in classes}

    @property
    def names(self) -> dict[str, list[str]]:
        """Names of the fields that are kept, by class."""
        return {name: _kept(one) for name, one in self.classes.items()}

    def encoded(self, value: Any, keep: Keep, name: str = "") -> Any:
        """JSON form of a value; ``keep`` takes arrays by their place below ``name``.

        TypeError for what has no such form, such as a function.
        """

        def inner(part: Any, place: object) -> Any:
            return self.encoded(part, keep, f"{name}/{place}" if name else str(place))

        def parts(mapping: Mapping[str, Any]) -> dict[str, Any]:
            return {place: inner(part, place) for place, part in mapping.items()}

        if isinstance(value, np.ndarray | np.generic):
            return {"!array": keep(name, np.asarray(value))}
        if sparse.issparse(value):
            return {"!sparse": parts(sparse_parts(value))}
        if isinstance(value, tuple | list):
            items = [inner(item, k) for k, item in enumerate(value)]
            return {"!tuple": items} if isinstance(value, tuple) else items
        kind = type(value)
        if is_dataclass(kind) and self.classes.get(kind.__name__) is kind:
            return {_TAG + kind.__name__: parts({x: getattr(value, x) for x in _kept(kind)})}
        if isinstance(value, Mapping):
            if all(isinstance(key, str) and not key.startswith(_TAG) for key in value):
                return parts(value)
            if all(isinstance(key, int) for key in value):
                return {"!numbered": [[key, inner(part, key)] for key, part in value.items()]}
            raise TypeError(f"names of a mapping must be texts without {_TAG!r} in front, or ints")
        if value is None or isinstance(value, bool | int | float | str):
            return value
        raise TypeError(f"a {kind.__name__} has no plain form")

    def decoded(self, form: Any, fetch: Callable[[Any], Any], size: int = 0) -> Any:
        """Value of a JSON form; ``fetch`` gives the array of what ``keep`` returned for it.

        Whatever is wrong raises one of `skfem_joint.ground.array_files.DAMAGE`; of sparse matrices
        of a file of ``size`` bytes what `sparse_array` refuses.
        """

        def parts(mapping: Mapping[str, Any]) -> dict[str, Any]:
            return {name: self.decoded(part, fetch, size) for name, part in mapping.items()}

        if isinstance(form, list):
            return [self.decoded(item, fetch, size) for item in form]
        if not isinstance(form, dict):
            return form
        tag = next(iter(form), "")
        match tag:
            case "!array":
                return fetch(form[tag])
            case "!sparse":
                return sparse_array(parts(form[tag]).__getitem__, size)
            case "!tuple":
                return tuple(self.decoded(form[tag], fetch, size))
            case "!numbered":
                return dict(self.decoded(form[tag], fetch, size))
        if tag.startswith(_TAG):
            name = tag.removeprefix(_TAG)
            if name not in self.classes:
                raise ValueError(f"it holds {name!r}, which is none of the package")
            return self.classes[name](**parts(form[tag]))
        return parts(form)


def _kept(kind: Any) -> list[str]:
    """Fields of a dataclass by which its values are compared."""
    return [each.name for each in fields(kind) if each.compare]


def fingerprint(*parts: Any) -> str:
    """Hexadecimal digest of numbers, texts, arrays, and dataclasses, mappings and lists of them.

    Raises
    ------
    InputError
        For anything else, such as plain functions of time, which cannot be distinguished.
    """
    digest = sha256()

    def add(part: Any) -> None:
        digest.update(type(part).__name__.encode() + b"\0")
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype.str}{part.shape}".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        elif sparse.issparse(part):
            rows = sparse.csr_array(part).sorted_indices()  # which others may sort in place
            add([part.shape, rows.indptr.astype(np.int64), rows.indices.astype(np.int64)])
            add(rows.data)
        elif is_dataclass(part):
            add({x.name: getattr(part, x.name) for x in fields(part) if x.compare})
        elif isinstance(part, Mapping):
            add([len(part), *part.items()])
        elif isinstance(part, Sequence) and not isinstance(part, str):
            digest.update(f"{len(part)}".encode())
            for item in part:
                add(item)
        elif part is None or isinstance(part, str | bool | int | float | np.number):
            digest.update(repr(part).encode() + b"\0")
        else:
            raise InputError(
                f"checkpoint: a {type(part).__name__} cannot be told from another one; give loads "
                "such as sj.Harmonic and sj.Table instead of plain functions of time, or go "
                "without checkpoints"
            )

    add(parts)
    return digest.hexdigest()


class Tabular:
    """Result whose values are columns of one length."""

    @property
    @abstractmethod
    def table(self) -> Mapping[str, Any]:
        """Columns by their names, which end with the unit; arrays or lists of one length."""

    def to_pandas(self) -> Any:
        """Table as a ``pandas.DataFrame``: a column for each name, with its unit at the end.

        Raises
        ------
        InputError
            If pandas is missing.
        """
        return needed("pandas", "pandas").DataFrame(dict(self.table))


def spread(name: str, values: Any, labels: Iterable[Any] | None = None) -> dict[str, Any]:
    """Columns of an array (rows, k), with a label or number in place of the {} in their name."""
    columns = np.asarray(values).T
    return dict(zip(map(name.format, labels or range(len(columns))), columns, strict=True))
