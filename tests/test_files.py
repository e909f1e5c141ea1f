"""A file is whole or not there, and nothing else is left in its folder."""

from __future__ import annotations

import os
import string
from pathlib import Path

import pytest

from skfem_joint.errors import InputError
from skfem_joint.files import read_whole, remove_unfinished, replacing, safe_name


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir() if path.is_file()}


def write_half(path: Path, error: BaseException) -> None:
    with replacing(path) as temporary:
        temporary.write_text("half")
        raise error


@pytest.fixture(params=[{}, {"a.txt": "old"}], ids=["new file", "file that is there"])
def before(request: pytest.FixtureRequest, tmp_path: Path) -> dict[str, str]:
    """What lies in the folder before a.txt is written."""
    files: dict[str, str] = request.param
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    return files


def test_the_file_takes_its_place_only_when_the_block_is_done(
    tmp_path: Path, before: dict[str, str]
) -> None:
    path = tmp_path / "a.txt"
    with replacing(path) as temporary:
        assert temporary.parent == tmp_path  # the same disk, so that the file can be renamed
        assert contents(tmp_path) == {**before, temporary.name: ""}
        temporary.write_text("half")
        assert contents(tmp_path) == {**before, temporary.name: "half"}
        temporary.write_text("whole")
    assert contents(tmp_path) == {"a.txt": "whole"}


@pytest.mark.parametrize("error", [ValueError("no"), KeyboardInterrupt(), InputError("no")])
def test_an_error_in_the_block_passes_and_leaves_the_folder_as_it_was(
    tmp_path: Path, before: dict[str, str], error: BaseException
) -> None:
    with pytest.raises(type(error)) as caught:
        write_half(tmp_path / "a.txt", error)
    assert caught.value is error
    assert contents(tmp_path) == before


def test_an_interruption_of_the_last_step_leaves_the_folder_as_it_was(
    tmp_path: Path, before: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("skfem_joint.files.os.replace", interrupted)
    with pytest.raises(KeyboardInterrupt), replacing(tmp_path / "a.txt") as temporary:
        temporary.write_text("whole")
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (OSError(28, "No space left on device"), "No space left on device"),
        (OSError("is the disk full?"), "is the disk full?"),
    ],
)
def test_a_disk_that_fails_in_the_block_is_an_input_error_with_its_reason(
    tmp_path: Path, before: dict[str, str], error: OSError, reason: str
) -> None:
    path = tmp_path / "a.txt"
    with pytest.raises(InputError) as caught:
        write_half(path, error)
    assert caught.value.problems == [f"{path}: cannot be written: {reason}"]
    assert contents(tmp_path) == before


@pytest.mark.parametrize("place", ["missing/a.txt", "file/a.txt"])
def test_a_place_without_a_folder_is_an_input_error_before_the_block_begins(
    tmp_path: Path, place: str
) -> None:
    (tmp_path / "file").write_text("text")
    begun = False
    with (
        pytest.raises(InputError, match=r"a\.txt: cannot be written: "),
        replacing(tmp_path / place),
    ):
        begun = True
    assert not begun
    assert [path.name for path in tmp_path.rglob("*")] == ["file"]
    assert contents(tmp_path) == {"file": "text"}


def test_a_folder_of_the_same_name_stays_and_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "a.txt").mkdir()
    (tmp_path / "a.txt" / "kept").write_text("text")
    with (
        pytest.raises(InputError, match=r"a\.txt: cannot be written: "),
        replacing(tmp_path / "a.txt") as temporary,
    ):
        temporary.write_text("whole")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]
    assert contents(tmp_path / "a.txt") == {"kept": "text"}


# Names


@pytest.mark.parametrize("name", ["free_end", "joint-2", "v1.5", "Stoß", "接合"])
def test_a_name_of_letters_digits_dots_and_dashes_is_kept(name: str) -> None:
    assert safe_name(name) == name


def test_all_else_becomes_an_underscore_one_for_one() -> None:
    kept = set(string.ascii_letters + string.digits + "_.-")
    for character in map(chr, range(128)):
        assert safe_name(character) == (character if character in kept else "_")
    assert safe_name("left end/bolt 2") == "left_end_bolt_2"


@pytest.mark.parametrize("name", ["../../a", "/a", "..\\a", 'C:"<a>"|?*', "a\0b\n"])
def test_any_name_makes_a_file_in_the_folder_it_is_meant_for(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"hysteresis_{safe_name(name)}.png"
    with replacing(path):
        pass
    assert list(tmp_path.iterdir()) == [path]
    assert len(path.name) == len("hysteresis_.png") + len(name)


# Reading


def test_a_file_is_read_whole(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"\0whole\n")
    assert read_whole(tmp_path / "a") == b"\0whole\n"
    assert read_whole(tmp_path / "a", 7) == b"\0whole\n"


def test_what_never_ends_or_is_too_large_is_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "large").write_bytes(b"12345678")
    wrong = {
        tmp_path / "pipe": "not a file",
        Path("/dev/zero"): "not a file",
        tmp_path / "folder": "not a file",
        tmp_path / "large": "found 8 bytes, must be at most 7",
        tmp_path / "missing": "No such file",
        tmp_path / "a\0b": "null",
    }
    for path, reason in wrong.items():
        with pytest.raises(InputError) as caught:
            read_whole(path, 7)
        assert str(caught.value).startswith(f"{path}: cannot be read: ")
        assert reason in str(caught.value)


def test_what_a_killed_process_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "fields"
    folder.mkdir()
    for path in (tmp_path / "a.txt", folder / "b.vtu"):
        path.write_text("whole")
        with replacing(path) as temporary:
            path.with_name(f"{temporary.name}-of-another").write_text("half")
    (tmp_path / ".hidden").write_text("of the user")
    remove_unfinished(tmp_path)
    left_over = sorted(path.name for path in tmp_path.rglob("*") if path.is_file())
    assert left_over == [".hidden", "a.txt", "b.vtu"]
