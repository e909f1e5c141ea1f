"""Scenes that come with the package, each with the question it answers, and their copies.

They are ``examples/*.toml`` with meshes in ``meshes/``. A wheel has both folders inside the
package, as ``pyproject.toml`` says; in a checkout they stand beside it.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from skfem_joint.ground.errors import InputError, closest, listed, refuse
from skfem_joint.ground.files import holding, read_text, read_whole, replacing

#: Question that each scene answers, by its name; also the title of its script
#: in the gallery, ``examples/NAME.py``.
QUESTIONS = {
    "plate_bolts": "Which of two bolts slips, and does a model of 13 unknowns see the same?",
    "lap_joint_reference": "How much energy does a lap joint lose in a cycle?",
    "lap_joint_case_I": "Do the modes of one joint serve another?",
    "structure_harmonic": "How close is a model of 15 unknowns to one of 200?",
    "structure_impulse": "How fast does a joint damp what a blow leaves?",
    "plate_reference": "How far does slip reach into an area?",
    "two_plates": "Where do two plates slip on each other?",
    "solid_lap_joint": "Where do two bolted solids slip on each other?",
    "lap_joint_sweep": "What do friction and load do to the energy lost?",
}
#: How a shipped scene names a mesh; the mesh of a copy stands beside it.
_MESH = re.compile(r'"\.\./meshes/([\w.-]+)"')


def shipped_scene(name: str) -> Path:
    """File of a shipped scene, where the package has it.

    Parameters
    ----------
    name : str
        One of `QUESTIONS`.

    Returns
    -------
    Path
        To be read by `load_scene`, or by `load_sweep` if it has a ``[sweep]``.

    Raises
    ------
    InputError
        There is no such scene.
    """
    if name not in QUESTIONS:
        hint = closest(name, QUESTIONS)
        raise InputError(f"example: found '{name}', must be one of {listed(QUESTIONS)}{hint}")
    return _root() / "examples" / f"{name}.toml"


def write_shipped(name: str, folder: Path) -> list[Path]:
    """Write a shipped scene and the meshes it names into a folder, which is made if need be.

    Parameters
    ----------
    name : str
        One of `QUESTIONS`.
    folder : Path
        Where the files go; those that are there stay as they are.

    Returns
    -------
    list of Path
        The files; the scene is the first one.

    Raises
    ------
    InputError
        There is no such scene, a file of one of these names is there, or the folder cannot be
        written to; nothing is written then.
    """
    source = shipped_scene(name)
    text = read_text(source)
    contents = {folder / f"{name}.toml": _MESH.sub(r'"\1"', text).encode()}
    for mesh in dict.fromkeys(_MESH.findall(text)):
        contents[folder / mesh] = read_whole(source.parents[1] / "meshes" / mesh)
    with holding(folder):
        refuse(
            f"{path}: is there already and is not overwritten; choose another folder by --out"
            for path in contents
            if os.path.lexists(path)
        )
        for path, content in contents.items():
            with replacing(path) as temporary:
                temporary.write_bytes(content)
    return [*contents]


def _root() -> Path:
    """Folder that has ``examples/`` and ``meshes/``: of the installed package, or the checkout."""
    package = Path(__file__).parents[1]
    installed = package / "shipped"
    return installed if installed.is_dir() else package.parent
