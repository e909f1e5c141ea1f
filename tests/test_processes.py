"""Processes of a command: they run no code of the current folder and leave interrupts to it."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from scene_texts import written

from skfem_joint.cli import INTERRUPTED
from skfem_joint.study.error_time import THREADS

MORE = """
[damping]
stiffness = 1e-5
[response]
frequencies = { from = 2200.0, to = 2300.0, points = 2 }
levels = [0.1]
[sweep]
"joint[0].friction" = [0.5, 0.6, 0.7, 0.8]
"""
#: What the first process that a command starts imports, and what those do that compute.
EARLY = ("multiprocessing", "pickle", "signal", "socket", "tempfile", "threading")
LATE = ("distributed", "numba", "numpy", "pyvista", "scipy", "skfem", "vtk")


@pytest.fixture
def scene(tmp_path):
    """A short scene, and the installed command, which is a file of its own."""
    (tmp_path / "bin").mkdir()
    lines = "import sys", "from skfem_joint.cli import main"
    guarded = "if __name__ == '__main__':", "    sys.exit(main())", ""
    (tmp_path / "bin" / "skfem-joint").write_text("\n".join(lines + guarded))
    (tmp_path / "here").mkdir()

    def write(cycles: int = 1, plots: bool = False) -> Path:
        output = ("every = 1", f"plots = {str(plots).lower()}\nvtk = false\nframes = 3")
        run = ('run = ["full", "reduced"]', 'run = ["full"]')
        changes = ("cycles = 3", f"cycles = {cycles}"), output, run
        return written(tmp_path / "here", *changes, more=MORE)

    return write


@pytest.mark.parametrize(
    ("command", "of_module"),
    [
        ("run", False),
        pytest.param("sweep --workers 2", False, marks=pytest.mark.slow),
        pytest.param("sweep --workers 2", True, marks=pytest.mark.slow),
        pytest.param("response --workers 2", False, marks=pytest.mark.slow),
        pytest.param("error-time --quick", False, marks=pytest.mark.slow),
        pytest.param("error-time --quick", True, marks=pytest.mark.slow),
    ],
)
def test_no_command_runs_code_of_the_current_folder(command, of_module, scene, tmp_path):
    path = scene(plots=command == "run")
    # With -m Python itself looks there, until the command begins.
    for name in LATE if of_module else (*EARLY, *LATE):
        hostile = f"open({str(tmp_path / 'hit')!r}, 'a').write('{name} ')\n"
        (path.parent / f"{name}.py").write_text(hostile)
    start = ["-m", "skfem_joint"] if of_module else [str(tmp_path / "bin" / "skfem-joint")]
    name, *options = command.split()
    ended = subprocess.run(
        [sys.executable, *start, name, str(path), "--out", "out", *options],
        cwd=path.parent, capture_output=True, text=True, timeout=600,
        env={key: value for key, value in os.environ.items() if key not in THREADS},
    )  # fmt: skip
    assert not (tmp_path / "hit").exists(), (tmp_path / "hit").read_text()
    assert ended.returncode == 0, ended.stderr


def children(pid: int) -> int:
    """Number of processes that one has started."""
    count = 0
    with suppress(OSError):
        for thread in Path(f"/proc/{pid}/task").iterdir():
            count += len((thread / "children").read_text().split())
    return count


#: Times (s) from the start of the second process of a sweep.
INTERRUPTS = [
    pytest.param(delay, marks=() if delay == 0.2 else pytest.mark.slow)
    for delay in (0.0, 0.2, 1.0, 3.0)
]


@pytest.mark.parametrize("delay", INTERRUPTS)
def test_an_interrupt_is_a_sentence_whenever_it_comes(delay, scene, tmp_path):
    """Ctrl-C reaches all processes of a terminal, here while the second one is being started."""
    script, path = tmp_path / "bin" / "skfem-joint", scene(cycles=3000)
    options = "--out", str(tmp_path / "out"), "--workers", "2"
    process = subprocess.Popen(
        [sys.executable, str(script), "sweep", str(path), *options],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    while process.poll() is None and children(process.pid) < 2:
        time.sleep(0.002)
    time.sleep(delay)
    os.killpg(process.pid, signal.SIGINT)
    said, errors = process.communicate(timeout=120)
    assert process.returncode == INTERRUPTED
    assert errors in ("", "skfem-joint: interrupted\n")
    assert errors or "The same command goes on." in said
