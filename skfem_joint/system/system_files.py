"""Systems in ``.npz`` files of plain arrays, without pickles: loading them runs no code.

A dense array is a member such as ``M``. A sparse matrix is stored as by `scipy.sparse.save_npz`, in
members ``M/data``, ``M/indices`` and so on. The member ``description`` is a text in JSON: the form
of the file, names, notes, the shape of each load over time, and a digest of all that is written: a
file that was changed since is refused.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator

from skfem_joint.ground import loads
from skfem_joint.ground.array_files import DAMAGE, npz_arrays
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import replacing
from skfem_joint.ground.plain_values import PlainForm, fingerprint
from skfem_joint.system.contacts import Contact
from skfem_joint.system.normal import NormalPart
from skfem_joint.system.served import Point, Range, Served
from skfem_joint.system.system import AppliedLoad, System

_KIND = {"kind": "skfem_joint system", "form": 4}  #: files of another form are refused
#: Shapes of loads that a file can hold.
_SHAPES = (
    *(loads.Harmonic, loads.MultiHarmonic, loads.Triangle, loads.HalfSine, loads.Versine),
    *(loads.RampAndHold, loads.Rectangle, loads.Table, loads.Scaled, loads.SweptSine),
)
_FORM = PlainForm((System, AppliedLoad, Contact, NormalPart, Served, Range, Point, *_SHAPES))


def save(system: System, path: str | Path) -> Path:
    """Save a system to a file: matrices, contact, loads, names and basis.

    Contact that opens is kept with the system. A model for a range keeps what it needs to serve it
    and to state its errors. A reduced or condensed system keeps its ``T``, which expands its runs
    to the structure, and the ``shares`` of its contact points. A reduced one does not keep what it
    was made of: it runs, and serves no response, damping curve or ring-down. The system that `load`
    returns integrates to the same bits.

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
        If a load is a plain function of time or a shape of the user, if the model was condensed by
        parts, if the name does not end on
        ``.npz``, and if the file cannot be written.
    """
    path = _checked(path)
    for load in system.loads:
        if type(shape := load.amplitude.shape) not in _SHAPES:
            kind = type(shape).__name__
            raise InputError(
                f"load on {load.on!r}: found a "
                f"{'plain function of time' if kind == 'Function' else kind}, which a file cannot "
                "hold; give its values as sj.Table(times, forces), or a shape such as sj.Harmonic"
            )
    if isinstance(system.T, LinearOperator):
        raise InputError(
            "save: found a model condensed by parts, whose displacements come from solutions with "
            "the full system; save replace(model, T=None), whose runs are not expanded to it"
        )
    arrays: dict[str, Any] = {}

    def keep(name: str, array: NDArray[Any]) -> str:
        arrays[name] = array
        return name

    content: dict[str, Any] = _KIND | {"system": _FORM.encoded(system, keep)}
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
        size = sum(array.nbytes for array in arrays.values())
        system = _FORM.decoded(content["system"], lambda name: arrays[name][()], size)
        if not isinstance(system, System):
            raise ValueError("it holds something else")
    except (InputError, *DAMAGE) as error:
        reason = str(error) or type(error).__name__
        reason = f"it has no {reason}" if isinstance(error, KeyError) else reason
        raise InputError(f"{path}: cannot be read as a saved system: {reason}") from error
    return system


def _checked(path: str | Path) -> Path:
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise InputError(f"{path}: found ending {path.suffix!r}, must be '.npz'")
    return path
