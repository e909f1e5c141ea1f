"""Only files of this program are ever removed or replaced, and only as it wrote them."""

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from skfem_joint import __version__
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import holding, replacing
from skfem_joint.output.folder import kept
from skfem_joint.output.record import LIST, clear, writing

OURS = {"history.npz": "ours", "fields/full_0000.vtu": "ours too"}


def write(folder: Path, files: dict[str, str]) -> None:
    """Write files as a command does, of which some may be below the folder."""
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with replacing(folder / name) as temporary:
            temporary.write_text(text)


@pytest.fixture
def out(tmp_path):
    """Folder with results of a command, and a file that lies beside it."""
    (tmp_path / "kept").write_text("of the user")
    folder = tmp_path / "out"
    folder.mkdir()
    with writing(folder, {"title": "a bar", "peak": [0.1, 1e-9]}):
        write(folder, OURS)
    return folder


def tree(folder: Path) -> dict[str, str]:
    """Every file below a folder, but its list, with its text; links are not followed."""
    return {
        path.relative_to(folder).as_posix(): os.readlink(path) if path.is_symlink()
        else path.read_text()
        for path in folder.rglob("*")
        if path.name != LIST and (path.is_symlink() or path.is_file())
    }  # fmt: skip


def assert_refused(folder: Path, *words: str) -> None:
    """A command is refused with status 2 and these words, and removes nothing."""
    before = tree(folder.parent)
    with pytest.raises(InputError) as caught, kept(folder, drawn=False):
        pass
    assert caught.value.exit_status == 2
    for word in (str(folder), *words):
        assert word in str(caught.value)
    assert tree(folder.parent) == before


def test_a_summary_carries_the_program_and_the_files(out):
    content = json.loads((out / "summary.json").read_text())
    assert content["title"] == "a bar"
    assert content["files"] == [*OURS]
    by = content["written_by"]
    assert (by["program"], by["version"]) == ("skfem_joint", __version__)
    assert f"numpy {np.__version__}," in by["libraries"]
    assert set(tree(out)) == {"summary.json", *OURS}


def test_own_files_are_removed_and_no_others(out):
    (out / "notes.txt").write_text("of the user")
    (out / "fields" / "notes.txt").write_text("of the user")
    for _ in range(2):
        with kept(out, drawn=False) as notes:
            assert "notes.txt" in " ".join(notes)
        assert set(tree(out)) == {"notes.txt", "fields/notes.txt"}
    (out / "notes.txt").unlink()
    (out / "fields" / "notes.txt").unlink()
    with kept(out, drawn=False) as notes:
        assert notes == []
    assert not (out / LIST).exists()


@pytest.mark.parametrize("name", ["summary.json", "notes.txt", "sub/", "history.npz"])
def test_a_folder_of_somebody_else_is_refused(name, tmp_path):
    out = tmp_path / "out"
    file = out / name / "raw.bin" if name == "sub/" else out / name
    file.parent.mkdir(parents=True)
    file.write_text("of the user")
    assert_refused(out, name, "is not empty", "--overwrite")


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        *((name, "with remarks of the user", "changed") for name in OURS),
        ("summary.json", "{}", "changed"),
        ("backbone.csv", "of the user, and results might replace it", "--overwrite"),
        *(
            (LIST, text, "is not a list of files that skfem-joint wrote")
            for text in ("my files\n", '{"program": 1}\n[]\n', '{"program": "other"}\n', "[")
        ),
    ],
)
def test_what_is_not_as_it_was_written_is_refused_and_left_as_it_is(name, text, words, out):
    (out / name).write_text(text)
    assert_refused(out, name, words)
    if name in OURS:
        with pytest.raises(InputError, match="is there"), writing(out, {}):
            write(out, OURS)
        assert (out / name).read_text() == text


def test_a_change_that_keeps_the_size_is_seen_by_the_time(out):
    time = (out / "history.npz").stat().st_mtime_ns
    (out / "history.npz").write_text("mine")
    os.utime(out / "history.npz", ns=(time, time + 1))
    assert_refused(out, "history.npz", "changed")


def test_what_others_go_on_from_and_empty_folders_are_no_files_of_other_origin(tmp_path):
    (tmp_path / "fields").mkdir()
    names = {"checkpoint_full.npz", "sweep_rows.jsonl", f"range_{'0' * 16}.npz", ".hidden"}
    for name in names:
        (tmp_path / name).write_text("of an earlier run")
    with kept(tmp_path, drawn=False) as notes:
        assert notes == []
    assert set(tree(tmp_path)) == names


def test_folders_below_are_left_alone(out):
    """Those of other commands' results, and those that no results have, whatever is in them."""
    (out / "data").mkdir()
    (out / "data" / "mine.csv").write_text("of the user")
    (out / "second").mkdir()
    with writing(out / "second", {}):
        write(out / "second", OURS)
    inner = {f"second/{name}" for name in ("summary.json", *OURS)}
    with kept(out, drawn=False) as notes:
        assert "data/" in " ".join(notes)
        assert "second" not in " ".join(notes)
    assert set(tree(out)) == {"data/mine.csv", *inner}
    (out / "fields").mkdir()
    (out / "fields" / "mine.vtu").write_text("of the user")
    assert_refused(out, "fields/mine.vtu")


def test_overwriting_replaces_files_of_the_same_names_and_removes_no_others(out, tmp_path):
    """Those that were there when it was asked for, of other origin or changed, and never links."""
    (out / "history.npz").write_text("with remarks of the user")
    for name in ("backbone.csv", "backbone.png", "notes.txt"):
        (out / name).write_text("of the user")
    (out / "joint.png").symlink_to(tmp_path / "kept")
    with kept(out, drawn=False, overwrite=True) as notes:
        assert "backbone.csv, backbone.png, history.npz and others" in " ".join(notes)
        (out / "peaks.csv").write_text("of the user, later")
        with writing(out, {}):
            write(out, dict.fromkeys(("backbone.csv", "joint.png"), "ours"))
        with pytest.raises(InputError, match=r"peaks\.csv: is there"), writing(out, {}):
            write(out, {"peaks.csv": "ours"})
    assert tree(tmp_path) == {
        "kept": "of the user",
        "out/history.npz": "with remarks of the user",
        "out/summary.json": tree(out)["summary.json"],
        "out/peaks.csv": "of the user, later",
        "out/backbone.png": "of the user",
        "out/notes.txt": "of the user",
    }
    assert_refused(out, "backbone.png", "history.npz")  # it is asked for each time


def test_a_file_that_appears_during_the_run_costs_no_results(tmp_path):
    """Unless it has the name of one of them."""
    with kept(tmp_path, drawn=False):
        (tmp_path / "mine.csv").write_text("of the user")
        with writing(tmp_path, {}):
            write(tmp_path, OURS)
    assert set(tree(tmp_path)) == {"summary.json", "mine.csv", *OURS}


def test_a_list_moved_beside_other_files_removes_none(out, tmp_path):
    other = tmp_path / "other"
    write(other, dict.fromkeys(OURS, "of the user"))
    (out / LIST).rename(other / LIST)
    assert_refused(other, *OURS)


def test_links_are_not_followed(out, tmp_path):
    """What a link leads to stays, even with the content that is listed."""
    away = tmp_path / "away"
    away.mkdir()
    for name in ("fields", "history.npz", "summary.json", LIST):
        (out / name).rename(away / name)
        (out / name).symlink_to(away / name)
        assert_refused(out, name)
        (out / name).unlink()
    for name in ("fields", "history.npz", ".skfem-joint-running"):
        (out / name).symlink_to(tmp_path / "kept")
        assert_refused(out)
        (out / name).unlink()


def test_a_summary_that_cannot_be_written_removes_nothing(out):
    before = tree(out)
    with pytest.raises(ValueError, match="not JSON compliant"), writing(out, {"peak": math.inf}):
        pass
    assert tree(out) == before


def test_the_folder_itself_may_be_a_link(out, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(out)
    with kept(link, drawn=False), writing(link, {"title": "again"}):
        write(link, OURS)
    assert set(tree(out)) == {"summary.json", *OURS}


@pytest.mark.parametrize("name", ["../kept", "/kept", "fields/../../kept", "", "."])
def test_names_in_a_list_cannot_leave_the_folder(name, out, tmp_path):
    """Not even one that is forged whole, with the right size and time."""
    name = f"{tmp_path}{name}" if name.startswith("/") else name
    status = (tmp_path / "kept").stat()
    with (out / LIST).open("a") as file:
        file.write(json.dumps([name, status.st_size, status.st_mtime_ns, True]) + "\n")
    with kept(out, drawn=False):
        pass
    assert tree(tmp_path) == {"kept": "of the user"}


@pytest.mark.parametrize("error", [KeyboardInterrupt(), InputError("the disk is full")])
def test_what_was_written_before_an_error_is_listed_in_the_summary(error, out):
    def interrupted() -> None:
        with writing(out, {}):
            write(out, {"joint.png": "ours"})
            raise error

    with pytest.raises(type(error)):
        interrupted()
    assert json.loads((out / "summary.json").read_text())["files"] == ["joint.png"]
    assert set(tree(out)) == {"summary.json", "joint.png"}


KILLED = """
import os, sys
from pathlib import Path
from skfem_joint.ground.files import holding, replacing
from skfem_joint.output.record import writing

def write(folder, moment, names):
    count = 0
    def kill(event, arguments):
        nonlocal count
        if event in ("open", "os.rename", "os.remove") and str(folder) in str(arguments[0]):
            count += 1
            if count == moment:
                os.kill(os.getpid(), 9)
    sys.addaudithook(kill)
    with holding(folder), writing(folder, {"title": f"moment {moment}"}):
        for k, name in enumerate(names):
            with replacing(folder / name) as temporary:
                temporary.write_text(f"{k}")
    os._exit(0)

for moment in range(1, 1000):
    folder = Path(sys.argv[1], str(moment))
    folder.mkdir()
    for when, names in ((0, ("a.csv", "history.npz")), (moment, ("a.csv", "joint.png", "a.csv"))):
        child = os.fork()
        if child == 0:
            write(folder, when, names)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        (folder / "notes.txt").write_text("of the user")
    if status == 0:
        break
    assert status == -9, status
"""


@pytest.mark.slow
def test_a_run_killed_at_any_moment_leaves_nothing_that_the_next_cannot_replace(tmp_path):
    """Before each opening, renaming and removal of a file, among them those of an earlier run."""
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=True)
    moments = list(tmp_path.iterdir())
    assert len(moments) > 20
    for out in moments:
        with kept(out, drawn=False):
            assert tree(out).keys() - {".skfem-joint-running"} == {"notes.txt"}


def test_what_appears_while_results_are_written_is_not_overwritten(out, tmp_path):
    def appears(name: str, make: Callable[[Path], object]) -> None:
        with writing(out, {}):
            make(out / name)
            write(out, {**OURS, "fields/kept": "ours"})

    with pytest.raises(InputError, match=r"history\.npz: is there"):
        appears("history.npz", lambda path: path.write_text("of the user"))
    assert (out / "history.npz").read_text() == "of the user"
    (out / "history.npz").unlink()
    with pytest.raises(InputError, match="is there"):
        appears("fields", lambda path: path.symlink_to(tmp_path))
    assert (tmp_path / "kept").read_text() == "of the user"
    with holding(out):
        clear(out, overwrite=True)
    assert set(tree(out)) == {"fields"}
