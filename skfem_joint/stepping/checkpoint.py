"""Checkpoints: a run saved between its chunks, so that it can go on after it was killed.

A checkpoint is one ``.npz`` of plain arrays. It takes its place only when it is whole, is never
loaded by anything that can run code, and goes on only with the run that wrote it: it carries a
fingerprint of the scene and its mesh, of the package's code, of all that is integrated, and of its
own arrays. Every array is compared with what the run would have saved after as many steps.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.ground.array_files import DAMAGE, npz_arrays
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import replacing
from skfem_joint.ground.plain_values import fingerprint
from skfem_joint.ground.rows import code_version

Arrays = Mapping[str, NDArray[Any]]

_FORM = 5


@dataclass(frozen=True)
class Checkpoint:
    """File that a run is saved to, and continued from.

    Attributes
    ----------
    path : Path
        The file, ``.npz``.
    origin : str
        Fingerprint of what the run comes from: its scene and mesh.
    every : int, optional
        Steps after which to save, where a chunk ends; never if None.
    resume : bool
        Whether to go on from the file if it is there.
    """

    path: Path
    origin: str
    every: int | None = None
    resume: bool = False

    def due(self, done: int, saved: int, n_steps: int) -> bool:
        """Whether to save after ``done`` of ``n_steps`` steps when ``saved`` of them are saved."""
        return self.every is not None and (done - saved >= self.every or saved < done == n_steps)

    def save(self, parts: Mapping[str, Arrays], run: str, done: int, elapsed: float) -> None:
        """Save a run, ``run`` being the fingerprint of what is integrated.

        ``parts`` are arrays by name, by the name of the part of the run that keeps them.

        Raises
        ------
        InputError
            If the file cannot be written; the one before it stays.
        """
        notes = {"form": _FORM, "version": code_version(), "origin": self.origin}
        notes |= {"run": run, "done": done, "elapsed": elapsed}
        notes["digest"] = fingerprint(parts, done, elapsed)
        arrays: dict[str, Any] = {
            f"{part}/{name}": array for part, own in parts.items() for name, array in own.items()
        }
        with replacing(self.path) as temporary, temporary.open("wb") as file:
            np.savez(file, **arrays, notes=np.array(json.dumps(notes)))

    def load(self, run: str) -> tuple[dict[str, dict[str, NDArray[Any]]], int, float] | None:
        """Parts as they were saved, steps done and time taken (s); None: nothing to go on from.

        Raises
        ------
        InputError
            If the file cannot be read, or another scene, mesh, version or model has written it.
        """
        if not self.resume or not self.path.exists():
            return None
        try:
            with self.path.open("rb") as file:
                arrays = npz_arrays(file)
            notes = json.loads(str(arrays.pop("notes")))
            parts: dict[str, dict[str, NDArray[Any]]] = {}
            for key, array in arrays.items():
                part, name = key.split("/", 1)
                parts.setdefault(part, {})[name] = array
            written = (notes["form"], notes["version"], notes["origin"])
            same_run, done, elapsed = notes["run"] == run, notes["done"], notes["elapsed"]
            if type(done) is not int or done < 1:
                raise ValueError(f"found {done!r} steps done")
            if type(elapsed) is not float or not 0.0 <= elapsed < math.inf:
                raise ValueError(f"found {elapsed!r} s of run time")
            if written[0] == _FORM and notes["digest"] != fingerprint(parts, done, elapsed):
                raise ValueError("its arrays are not those that were written")
        except DAMAGE as error:
            raise self.unreadable(str(error) or type(error).__name__) from error
        advice = "give that back, or remove the checkpoint and start the run again"
        if written[:2] != (_FORM, code_version()):
            raise InputError(
                f"{self.path}: was written by version {written[1]}, this is {code_version()}; "
                f"{advice}"
            )
        if written[2] != self.origin:
            raise InputError(f"{self.path}: was written for another scene or mesh; {advice}")
        if not same_run:
            raise InputError(
                f"{self.path}: the model made from the scene differs from the one that was saved, "
                f"as on another machine or with other libraries; {advice}"
            )
        return parts, done, elapsed

    def unreadable(self, why: str) -> InputError:
        """Error of a file that is no checkpoint of a run, or a damaged one."""
        return InputError(
            f"{self.path}: cannot be read as a checkpoint ({why}); remove it and start the run "
            "again"
        )


@dataclass(frozen=True)
class Checkpoints:
    """Checkpoints of all models of a study, in the folder of its results.

    Attributes
    ----------
    folder : Path
        Made if it does not exist.
    every, resume
        As in `Checkpoint`.
    """

    folder: Path
    every: int | None = None
    resume: bool = False

    def __post_init__(self) -> None:
        if self.every is not None and self.every < 1:
            raise InputError(f"--checkpoint-every: found {self.every}, must be >= 1")
        object.__setattr__(self, "folder", Path(self.folder))
        if self.every is not None:
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(
                    f"{self.folder}: cannot be made ({error.strerror or error}); choose another "
                    "folder"
                ) from error
        if not self.resume and self.files():
            raise InputError(
                f"--out {self.folder}: holds {', '.join(path.name for path in self.files())} of a "
                "run that did not end; go on with --resume, or remove what is to be lost"
            )

    def files(self) -> list[Path]:
        """Checkpoints in the folder."""
        return sorted(self.folder.glob("checkpoint_*.npz"))

    def of(self, model: str, origin: str) -> Checkpoint:
        """Checkpoint of one model."""
        path = self.folder / f"checkpoint_{model}.npz"
        return Checkpoint(path, origin, self.every, self.resume)

    def remove(self, models: Iterable[str]) -> None:
        """Remove those of some models, when their results are written."""
        for model in models:
            self.of(model, "").path.unlink(missing_ok=True)
