"""Scenes for the tests: changed texts, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import pytest

from skfem_joint.errors import InputError
from skfem_joint.scene import load_scene


def with_changes(text: str, changes: tuple[tuple[str, str], ...]) -> str:
    """The text with some of its parts exchanged, each of which stands in it once."""
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} must stand in the good scene once"
        text = text.replace(old, new)
    return text


def problems_of(path: Path) -> list[str]:
    """What is wrong with a scene, without the file name that starts every line."""
    with pytest.raises(InputError) as caught:
        load_scene(path)
    assert caught.value.exit_status == 2
    assert all(problem.startswith(f"{path}: ") for problem in caught.value.problems)
    return [problem.removeprefix(f"{path}: ") for problem in caught.value.problems]
