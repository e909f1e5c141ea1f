"""A file is whole or not there, nothing else is left in its folder, and one run writes to it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import holding, read_whole, replacing, safe_name, safe_names

Files = dict[str, str]


def contents(folder: Path) -> Files:
    return {path.name: path.read_text() for path in folder.iterdir() if path.is_file()}


@pytest.fixture(params=[{}, {"a.txt": "old"}], ids=["new file", "file that is there"])
def before(request, tmp_path):
    """What lies in the folder before a.txt is written."""
    files: Files = request.param
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    return files


def test_the_file_takes_its_place_only_when_the_block_is_done(tmp_path, before):
    with replacing(tmp_path / "a.txt") as temporary:
        assert temporary.parent == tmp_path  # the same disk, so that the file can be renamed
        temporary.write_text("half")
        assert contents(tmp_path) == {**before, temporary.name: "half"}
        temporary.write_text("whole")
    assert contents(tmp_path) == {"a.txt": "whole"}


@pytest.mark.parametrize(
    "error", [ValueError("no"), KeyboardInterrupt(), InputError("no"), OSError(28, "it is full")]
)
def test_an_error_in_the_block_leaves_the_folder_as_it_was(tmp_path, before, error):
    """It passes as it is, but what the system refuses is an input error with its reason."""
    path = tmp_path / "a.txt"

    def write():
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(InputError if isinstance(error, OSError) else type(error)) as caught:
        write()
    if isinstance(error, OSError):
        assert str(caught.value) == f"{path}: cannot be written: it is full"
    else:
        assert caught.value is error
    assert contents(tmp_path) == before


@pytest.mark.parametrize("full", ["of the file", "of its name"])
def test_a_file_is_on_the_disk_before_it_takes_its_place_and_its_name_after(
    tmp_path, before, full, monkeypatch
):
    def flush(descriptor):
        if Path(f"/proc/self/fd/{descriptor}").is_dir() == (full == "of its name"):
            raise OSError(28, "it is full")

    monkeypatch.setattr("skfem_joint.ground.files.os.fsync", flush)
    with (
        pytest.raises(InputError, match="cannot be written: it is full"),
        replacing(tmp_path / "a.txt") as temporary,
    ):
        temporary.write_text("whole")
    assert contents(tmp_path) == (before if full == "of the file" else {"a.txt": "whole"})


def test_a_place_that_cannot_be_written_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("text")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "kept").write_text("text")
    for place in ("missing/a.txt", "file/a.txt", "folder"):
        with pytest.raises(InputError, match="cannot be written: "), replacing(tmp_path / place):
            assert place == "folder"  # of the others the block does not begin
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "folder", "kept"]


@pytest.mark.parametrize("name", ["../../a", "/a", "..\\a", 'C:"<a>"|?*', "a\0b\n"])
def test_any_name_makes_a_file_in_the_folder_it_is_meant_for(tmp_path, name):
    path = tmp_path / f"hysteresis_{safe_name(name)}.png"
    with replacing(path):
        pass
    assert list(tmp_path.iterdir()) == [path]
    assert len(path.name) == len("hysteresis_.png") + len(name)


def test_names_of_the_same_file_are_numbered():
    assert safe_names(["a b", "a_b_2", "a_b", "A:B"]) == ["a_b", "a_b_2", "a_b_3", "A_B_4"]


def test_a_file_is_read_whole_but_what_never_ends_or_is_too_large_is_not(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "large").write_bytes(b"12345678")
    (tmp_path / "whole").write_bytes(b"\0whole\n")
    assert read_whole(tmp_path / "whole", 7) == b"\0whole\n"
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


def in_a_process(code: str, folder: Path) -> subprocess.Popen[str]:
    lines = "import os, sys\nfrom pathlib import Path\nfrom skfem_joint.ground.files import *\n"
    command = [sys.executable, "-c", f"{lines}folder = Path(sys.argv[1])\n{code}", str(folder)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def test_only_what_dead_processes_left_is_removed(tmp_path):
    (tmp_path / "fields").mkdir()
    killed = in_a_process(
        "with replacing(folder / 'fields' / 'b.vtu'), replacing(folder / 'a.txt'):\n"
        "    os.kill(os.getpid(), 9)",
        tmp_path,
    )
    killed.communicate()
    assert len(list(tmp_path.rglob(".unfinished-*"))) == 2
    users = {".hidden": "of the user", ".unfinished-symphony": "of the user"}
    for name, text in users.items():
        (tmp_path / name).write_text(text)
    with holding(tmp_path / "below"), replacing(tmp_path / "below" / "c.txt") as other:
        with holding(tmp_path):
            left = {path.name for path in tmp_path.iterdir() if path.is_file()}
            assert left > set(users)
            assert not any(path.suffix == ".txt" for path in tmp_path.iterdir())
            assert not list((tmp_path / "fields").iterdir())
        assert other.exists()
    assert contents(tmp_path) == users


def test_a_second_run_in_a_folder_is_refused_until_the_first_has_ended_or_died(tmp_path):
    folder = tmp_path / "new" / "out"
    wait = "with holding(folder):\n    print('held', flush=True)\n    sys.stdin.read()"
    for end in ("whole", "killed"):
        first = in_a_process(wait, folder)
        assert first.stdout.readline() == "held\n"
        with pytest.raises(InputError, match=f"another run .process {first.pid}."), holding(folder):
            pass
        with holding(folder / "below"), holding(tmp_path):  # others are not in the way
            pass
        if end == "killed":
            first.kill()
        first.communicate("")
        with holding(folder):
            with pytest.raises(InputError, match="another run"), holding(folder):
                pass
            assert [path.name for path in folder.iterdir() if path.is_file()] != []
        assert [path.name for path in folder.iterdir()] == ["below"]


def test_runs_that_take_turns_in_a_folder_are_never_in_it_together(tmp_path):
    code = (
        "from skfem_joint.ground.errors import InputError\n"
        "been_in = 0\n"
        "while been_in < 50:\n"
        "    try:\n"
        "        with holding(folder):\n"
        "            os.close(os.open(folder / 'inside', os.O_CREAT | os.O_EXCL))\n"
        "            os.unlink(folder / 'inside')\n"
        "            been_in += 1\n"
        "    except InputError: pass\n"
    )
    runs = [in_a_process(code, tmp_path) for _ in range(3)]
    for run in runs:
        run.communicate()
    assert [run.returncode for run in runs] == [0, 0, 0]


def test_a_folder_that_cannot_be_made_or_written_to_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "deeper" / "still", Path("/proc/out")):
        with pytest.raises(InputError, match=f"{folder}.*cannot be written to"), holding(folder):
            pass
