"""Systems in ``.npz`` files of plain arrays, without pickles: loading them runs no code.

A dense array is a member such as ``M``. A sparse matrix is stored as by `scipy.sparse.save_npz`, in
members ``M/data``, ``M/indices`` and so on. The member ``description`` is a text in JSON: the form
of the file, names, notes, the shape of each load over time, and a digest of all that is written: a
file that was changed since is refused.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint import loads
from skfem_joint.array_files import (
    DAMAGE,
    fingerprint,
    npz_arrays,
    sparse_array,
    sparse_parts,
)
from skfem_joint.contacts import Contact
from skfem_joint.errors import InputError
from skfem_joint.files import replacing
from skfem_joint.loads import Amplitude, Harmonic, MultiHarmonic, Scaled, Table
from skfem_joint.normal import NormalPart
from skfem_joint.served import Point, Range, Served
from skfem_joint.system import AppliedLoad, System

_KIND = {"kind": "skfem_joint system", "form": 3}  #: files of another form are refused
_ARRAYS = ("M", "C", "K", "P", "T")
_CONTACT = ("B", "given", "beta", "stiffness", "directions", "gain", "J", "shares")
_NORMAL = ("N", "gap", "force", "stiffness", "area", "shares")
_OPTIONAL = ("T", "shares")
_NUMBERS = ("accuracy", "reached", "law")  # of what a model for a range carries
#: Shapes of loads that are numbers alone.
_PLAIN = {
    shape.__name__: shape
    for shape in (
        Harmonic,
        loads.Triangle,
        loads.HalfSine,
        loads.Versine,
        loads.RampAndHold,
        loads.Rectangle,
    )
}


def save(system: System, path: str | Path) -> Path:
    """Save a system to a file: matrices, contact, loads, names and basis.

    Contact that opens is kept with the system. A model for a range keeps what it needs to serve it
    and to state its errors. A reduced or condensed system keeps its ``T``, which expands its runs
    to the structure, and the ``shares`` of its contact points. The system that `load` returns
    integrates to the same bits.

    Parameters
    ----------
    system : System
        Full, condensed or reduced. Its loads are shapes of the package, such as `Harmonic` or
        `Table`.
    path : str or Path
        File, ``.npz``; an existing file is replaced when the new file is complete.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If a load is a plain function of time or a shape of the user, if the name does not end on
        ``.npz``, and if the file cannot be written.
    """
    path = _checked(path)
    arrays: dict[str, Any] = {}
    content = _KIND | _content(system, "", arrays)
    content["digest"] = fingerprint(arrays, json.dumps(content))
    arrays["description"] = np.array(json.dumps(content))
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)
    return path


def load(path: str | Path) -> System:
    """Load a system that `save` wrote.

    Sizes, indices and the digest of all that was saved are checked before anything is computed with
    it, and nothing in the file is run.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    System

    Raises
    ------
    InputError
        If the file cannot be read, is damaged or changed, or holds no saved system.
    """
    path = _checked(path)
    if not path.is_file():
        raise InputError(f"{path}: cannot be read: there is no such file")
    try:
        with path.open("rb") as file:
            arrays = npz_arrays(file)
        content = json.loads(str(arrays.pop("description")))
        if content["kind"] != _KIND["kind"]:
            raise ValueError("it holds something else")
        if content["form"] != _KIND["form"]:
            raise ValueError(
                f"it has form {content['form']!r}, this version reads {_KIND['form']}: make the "
                "system and save it again"
            )
        if content.pop("digest") != fingerprint(arrays, json.dumps(content)):
            raise ValueError(
                "its content is not what was saved: change the system that load gives, as by "
                "dataclasses.replace, not the file"
            )
        system = _system(content, arrays)
    except (InputError, *DAMAGE) as error:
        reason = str(error) or type(error).__name__
        reason = f"it has no {reason}" if isinstance(error, KeyError) else reason
        raise InputError(f"{path}: cannot be read as a saved system: {reason}") from error
    return system


def _content(system: System, prefix: str, arrays: dict[str, Any]) -> dict[str, Any]:
    """Description of a system as JSON takes it; its arrays go to the ``arrays``."""
    contact = system.contact
    for of, owner, names in _parts(system, contact, contact.normal):
        for name in names:
            if (value := getattr(owner, name)) is not None:
                arrays |= _members(f"{prefix}{of}{name}", value)
    described = []
    for number, load in enumerate(system.loads):
        member = f"{prefix}load {number}"
        arrays[member] = load.vector
        shape = _described(load.amplitude, member, load.on, arrays)
        described.append({"on": load.on, "amplitude": shape})
    texts = {"points": list(system.points), "notes": list(system.notes)}
    content: dict[str, Any] = texts | {
        "joints": list(contact.joints),
        "loads": described,
        "made_for": system.made_for,
    }
    if system.serves is not None:  # which is a second system, with numbers
        content["serves"] = _serves_content(system.serves, arrays)
    return content


def _serves_content(serves: Served, arrays: dict[str, Any]) -> dict[str, Any]:
    """Description of what a model for a range carries; its arrays go to the ``arrays``."""
    arrays["known"] = serves.known
    numbers = {name: float(getattr(serves, name)) for name in _NUMBERS}
    point = None if serves.point is None else asdict(serves.point)
    range_ = {name: asdict(serves.range)[name] for name in ("slip", "frequency", "limits")}
    return numbers | {
        "range": range_,
        "factors": dict(serves.factors),
        "shared": dict(serves.shared),
        "point": point,
        "larger": _content(serves.larger, "larger/", arrays),
    }


def _checked(path: str | Path) -> Path:
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise InputError(f"{path}: found ending {path.suffix!r}, must be '.npz'")
    return path


def _members(name: str, value: Any) -> dict[str, NDArray[Any]]:
    """Arrays of a matrix by the names of their members."""
    if not sparse.issparse(value):
        return {name: np.asarray(value)}
    return {f"{name}/{part}": array for part, array in sparse_parts(value).items()}


def _described(
    amplitude: Amplitude, member: str, on: str, arrays: dict[str, Any]
) -> dict[str, Any]:
    """Shape of a load as JSON takes it; the columns of a table go to the ``arrays``."""
    kind = type(amplitude).__name__
    if _PLAIN.get(kind) is type(amplitude):
        values = {x.name: float(getattr(amplitude, x.name)) for x in fields(amplitude)}
        return {"shape": kind, **values}
    if type(amplitude) is MultiHarmonic:
        parts = [_described(part, member, on, arrays) for part in amplitude.components]
        return {"shape": kind, "components": parts}
    if type(amplitude) is Scaled:
        of = _described(amplitude.of, member, on, arrays)
        return {"shape": kind, "of": of, "factor": float(amplitude.factor)}
    if type(amplitude) is Table:
        arrays |= {f"{member}/times": amplitude.times, f"{member}/forces": amplitude.forces}
        return {"shape": kind}
    raise InputError(
        f"load on {on!r}: found a {'plain function of time' if kind == 'Function' else kind}, "
        "which a file cannot hold; give its values as sj.Table(times, forces), or a shape of "
        "skfem_joint.loads"
    )


def _system(
    content: Mapping[str, Any], arrays: dict[str, NDArray[Any]], prefix: str = ""
) -> System:
    """System from a description and arrays, which are removed from the mapping as they are used."""
    size = sum(array.nbytes for array in arrays.values())
    values: list[dict[str, Any]] = []
    for of, _, names in _parts(System, Contact, NormalPart):
        values.append({name: _matrix(f"{prefix}{of}{name}", arrays, size) for name in names})
        for name in names:
            if values[-1][name] is None and name not in _OPTIONAL:
                raise KeyError(of + name)
    own, of_contact, of_normal = values
    texts = {name: tuple(content[name]) for name in ("points", "joints", "notes")}
    contact = Contact(joints=texts.pop("joints"), normal=NormalPart(**of_normal), **of_contact)
    applied = tuple(
        _load(described, f"{prefix}load {number}", arrays)
        for number, described in enumerate(content["loads"])
    )
    if not prefix and "serves" in content:
        own["serves"] = _served(content["serves"], arrays)
    return System(contact=contact, loads=applied, made_for=content["made_for"], **(own | texts))


def _parts(system: Any, contact: Any, normal: Any) -> tuple[tuple[str, Any, tuple[str, ...]], ...]:
    """Prefix and names of the arrays of a system, of its contact and of its normal part."""
    return ("", system, _ARRAYS), ("contact ", contact, _CONTACT), ("normal ", normal, _NORMAL)


def _served(content: Mapping[str, Any], arrays: dict[str, NDArray[Any]]) -> Served:
    """What a model for a range carries, from its description."""
    larger, point = _system(content["larger"], arrays, "larger/"), content["point"]
    known = arrays.pop("known")
    return Served(
        range=Range.of(content["range"]),
        larger=larger,
        factors=content["factors"],
        shared=content["shared"],
        known=known,
        point=None if point is None else Point(**point),
        **{name: content[name] for name in _NUMBERS},
    )


def _matrix(name: str, arrays: dict[str, NDArray[Any]], size: int) -> Any:
    """Dense or sparse array of a name, removed from the ``arrays``; None if there is none."""
    parts = {key: arrays.pop(key) for key in list(arrays) if key.startswith(f"{name}/")}
    if name in arrays:
        array = arrays.pop(name)
        if array.dtype.kind not in "iuf":
            raise ValueError(f"{name} holds {array.dtype} values, must be real numbers")
        return array
    if not parts:
        return None
    return sparse_array(lambda part: parts[f"{name}/{part}"], size)


def _load(
    described: Mapping[str, Any], member: str, arrays: dict[str, NDArray[Any]]
) -> AppliedLoad:
    amplitude = _amplitude(described["amplitude"], member, arrays)
    return AppliedLoad(arrays.pop(member), amplitude, described["on"])


def _amplitude(
    described: Mapping[str, Any], member: str, arrays: dict[str, NDArray[Any]]
) -> Amplitude:
    """Shape of a load from its description by `_described`."""
    given = dict(described)
    kind = given.pop("shape")
    if kind in _PLAIN:
        return _PLAIN[kind](**given)
    if kind == "MultiHarmonic":
        names = "amplitude", "frequency", "phase"
        parts = [Harmonic(*(part[name] for name in names)) for part in given["components"]]
        return MultiHarmonic(parts)
    if kind == "Scaled":
        return Scaled(_amplitude(given["of"], member, arrays), given["factor"])
    if kind == "Table":
        return Table(*(arrays.pop(f"{member}/{name}") for name in ("times", "forces")))
    raise ValueError(f"{member} has the shape {kind!r:.60}, which is none of the package")
