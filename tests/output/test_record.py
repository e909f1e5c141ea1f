"""Only files of this program are ever removed or replaced, and only as it wrote them."""

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from skfem_joint import __version__
from skfem_joint.errors import InputError
from skfem_joint.files import holding, replacing
from skfem_joint.output.folder import kept
from skfem_joint.output.record import LIST, clear, digest_of, writing

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
    """Every file below a folder with its text; links are not followed."""
    return {
        path.relative_to(folder).as_posix(): os.readlink(path) if path.is_symlink()
        else path.read_text()
        for path in folder.rglob("*")
        if path.is_symlink() or path.is_file()
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


def test_a_summary_carries_the_program_and_digests(out):
    content = json.loads((out / "summary.json").read_text())
    assert content["title"] == "a bar"
    assert content["files"] == {name: digest_of(out / name) for name in OURS}
    mark = content["written_by"]
    assert (mark["program"], mark["version"]) == ("skfem_joint", __version__)
    assert set(tree(out)) == {"summary.json", *OURS}


def test_own_files_are_removed_and_no_others(out):
    (out / "notes.txt").write_text("of the user")
    (out / "fields" / "notes.txt").write_text("of the user")
    with kept(out, drawn=False) as notes:
        assert "notes.txt" in " ".join(notes)
    assert set(tree(out)) == {"notes.txt", "fields/notes.txt"}


@pytest.mark.parametrize(
    "content",
    [
        '{"name": "my paper", "files": ["data.csv", "notes.txt", "sub/raw.bin"]}',
        '{"files": {"data.csv": "0"}, "written_by": "me"}',
        '{"files": {}, "written_by": {"program": "other", "version": "1", "digest": null}}',
        "[]", "null", "{", "\udc80", "[" * 100_000,
    ],
)  # fmt: skip
def test_a_summary_of_another_program_is_refused(content, tmp_path):
    out = tmp_path / "out"
    (out / "sub").mkdir(parents=True)
    for name in ("data.csv", "notes.txt", "sub/raw.bin"):
        (out / name).write_text("of the user")
    (out / "summary.json").write_bytes(content.encode(errors="surrogateescape"))
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match=r"summary\.json: is not the summary"), kept(out, False):
        pass
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def edited(out: Path, change: Callable[[dict], object]) -> None:
    content = json.loads((out / "summary.json").read_text())
    change(content)
    (out / "summary.json").write_text(json.dumps(content))


def test_a_summary_that_was_edited_is_refused(out):
    (out / "data.csv").write_text("of the user")
    edited(out, lambda content: content["files"].update({"data.csv": digest_of(out / "data.csv")}))
    assert_refused(out, "summary.json", "was changed")
    edited(out, lambda content: content["files"].pop("data.csv"))
    edited(out, lambda content: content.update(remark="to be kept"))
    assert_refused(out, "summary.json", "was changed")


@pytest.mark.parametrize("name", OURS)
def test_results_that_were_changed_are_neither_removed_nor_overwritten(name, out):
    (out / name).write_text("with remarks of the user")
    assert_refused(out, name, "changed")
    with pytest.raises(InputError, match="changed"), writing(out, {}):
        write(out, OURS)
    assert (out / name).read_text() == "with remarks of the user"


def test_a_summary_moved_beside_other_files_removes_none(out, tmp_path):
    other = tmp_path / "other"
    write(other, dict.fromkeys(OURS, "of the user"))
    (out / "summary.json").rename(other / "summary.json")
    assert_refused(other, *OURS)


def test_links_are_not_followed(out, tmp_path):
    """What a link leads to stays, even with the content that is listed."""
    away = tmp_path / "away"
    (out / "fields").rename(away)
    (out / "fields").symlink_to(away)
    assert_refused(out, "fields/full_0000.vtu")
    (out / "fields").unlink()
    (out / "history.npz").rename(away / "history.npz")
    (out / "history.npz").symlink_to(away / "history.npz")
    assert_refused(out, "history.npz")
    (out / "history.npz").unlink()
    (out / "history.npz").mkdir()
    assert_refused(out, "history.npz")
    (out / "history.npz").rmdir()
    (out / "summary.json").rename(away / "summary.json")
    (out / "summary.json").symlink_to(away / "summary.json")
    assert_refused(out, "summary.json")
    (out / "summary.json").unlink()
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


@pytest.mark.parametrize("name", ["../kept", "/kept", "fields/../../kept", "", ".", "./kept"])
def test_names_in_a_list_cannot_leave_the_folder(name, out, tmp_path):
    """Not even one that is forged whole, with the right digest."""
    name = f"{tmp_path}{name}" if name.startswith("/") else name
    first = json.dumps({"program": "skfem_joint", "version": __version__})
    lines = [first, json.dumps([name, digest_of(tmp_path / "kept")]), ""]
    (out / LIST).write_text("\n".join(lines))
    assert_refused(out, LIST)


def test_a_list_of_another_program_is_refused(out):
    for text in ("my files\n", '{"program": "other"}\n', "my files", '{"program": 1}\n[]\n'):
        (out / LIST).write_text(text)
        assert_refused(out, LIST)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), InputError("the disk is full")])
def test_what_was_written_before_an_error_is_listed_in_the_summary(error, out):
    def interrupted() -> None:
        with writing(out, {}):
            write(out, {"joint.png": "ours"})
            raise error

    with pytest.raises(type(error)):
        interrupted()
    assert json.loads((out / "summary.json").read_text())["files"].keys() == {"joint.png"}
    assert set(tree(out)) == {"summary.json", "joint.png"}


KILLED = """
import os, sys
from pathlib import Path
from skfem_joint.files import holding, replacing
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
    (folder / "notes.txt").write_text("of the user")
    for when, names in ((0, ("a.csv", "history.npz")), (moment, ("a.csv", "joint.png", "a.csv"))):
        child = os.fork()
        if child == 0:
            write(folder, when, names)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status == 0:
        break
    assert status == -9, status
"""


def test_a_run_killed_at_any_moment_leaves_nothing_that_the_next_cannot_replace(tmp_path):
    """Before each opening, renaming and removal of a file, among them those of an earlier run."""
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=True)
    moments = list(tmp_path.iterdir())
    assert len(moments) > 20
    assert any((out / LIST).exists() for out in moments)
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
        clear(out)
    assert set(tree(out)) == {"fields"}
