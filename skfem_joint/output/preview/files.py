"""The file of a preview."""

from __future__ import annotations

from pathlib import Path

from skfem_joint.errors import InputError
from skfem_joint.output.plots import save_figure
from skfem_joint.output.preview.marks import Preview
from skfem_joint.output.preview.sheet import preview_figure


def write_preview(path: str | Path, preview: Preview, *, overwrite: bool = False) -> Path:
    """Draw a preview as a PNG.

    Parameters
    ----------
    path : str or Path
        File that ends in ``.png``, in a folder that exists.
    preview : Preview
    overwrite : bool
        Whether a file of this name may be replaced.

    Raises
    ------
    InputError
        For another ending, a file that is there already or cannot be written, without matplotlib,
        and for solids without pyvista or a GL library.
    """
    check_target(path := Path(path), overwrite=overwrite)
    return save_figure(path, preview_figure(preview))


def check_target(path: Path, *, overwrite: bool = False) -> None:
    """Refuse a path of another ending than ``.png``, or of a file that may not be replaced."""
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: found ending {path.suffix!r}, must be '.png'")
    if path.exists() and not overwrite:
        raise InputError(
            f"{path}: is there already and stays as it is; choose another file by --out, or give "
            "--overwrite"
        )
