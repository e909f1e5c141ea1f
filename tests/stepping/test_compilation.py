"""Compiled code: when it is made, where it is kept, and what happens where it cannot be kept.

All in processes of their own, because a process compiles a function once.
"""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

HERE = Path(__file__).parent
#: Runs a function in a forked process, which then has imported but not compiled anything.
FORKED = """
    import os, sys, traceback
    def forked(function, *arguments):
        child = os.fork()
        if child == 0:
            try:
                function(*arguments)
            except BaseException:
                traceback.print_exc()
                os._exit(1)
            sys.stderr.flush()
            os._exit(0)
        assert os.waitpid(child, 0)[1] == 0, arguments
"""
#: Normalised friction at three slips, by a small function that calls another one.
FORCES = """
    import numpy as np
    from skfem_joint.minimise import law
    def forces(loaded):
        sigma = np.zeros(3)
        law.forces(np.full(3, 1e5), np.array([-1e-5, 0.0, 1e-5]), sigma)
        assert np.allclose(sigma, [-0.5, 0.0, 0.5], rtol=1e-15)
        assert bool(law.forces.entry.stats.cache_hits) == loaded
"""


def errors_of(*code: str, **environment: str) -> str:
    """Error output of code in a fresh interpreter that finds the helpers of the tests."""
    inherited = filter(None, [os.environ.get("PYTHONPATH")])
    paths = os.pathsep.join([str(HERE), str(HERE.parent / "structure"), *inherited])
    result = subprocess.run(
        [sys.executable, "-W", "always", "-c", "\n".join(map(textwrap.dedent, code))],
        capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": paths, **environment},
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return result.stderr


@pytest.mark.slow
def test_nothing_is_compiled_or_loaded_while_time_is_taken():
    """The first steps ask for the load; from then on no function meets new types."""
    code = """
        import numpy as np
        from numba.core.dispatcher import Dispatcher
        from skfem_joint.ground.loads import Amplitude
        from skfem_joint.runs.integrate import integrate
        from stepping_systems import of_stepper

        made, begun = [], []
        compile = Dispatcher.compile

        def counted(self, signature):
            made.append((self.py_func.__name__, signature))
            return compile(self, signature)

        Dispatcher.compile = counted

        class Watched(Amplitude):
            peak_value = 30e3
            corners = jumps = ()

            def __init__(self, jump):
                self.corners = self.jumps = jump

            def _force(self, t):
                if t.size in (2, 61) and t[-1] > 0.0:
                    begun.append(len(made))
                after = 20e3 * (t > self.jumps[0]) if self.jumps else 0.0
                return 30e3 * np.sin(np.minimum(t, 4e-5) * 3e4) + after

        def watch(kind, *jump):
            run = integrate(of_stepper(kind, Watched(jump)), step=5e-7, n_steps=60)
            assert run.friction_work.sum() > 0.0 and run.preparation_s > 0.0
            assert begun[0] > 0, made
            assert len(made) == begun[0], made[begun[0]:]

        forked(watch, "Coulomb", 4.3e-5)
        for kind in ("chain", "dense", "contact", "contact Coulomb", "relative"):
            forked(watch, kind)
    """
    errors_of(FORKED, code)


def test_a_run_without_friction_loads_no_compiler():
    code = """
        import sys
        from stepping_systems import of_stepper
        from skfem_joint.runs.integrate import integrate
        run = integrate(of_stepper("linear"), step=1e-5, n_steps=20)
        assert run.counters.friction_evaluations == 0 and run.peak[0] > 0.0
        heavy = {"numba", "meshio", "pyvista", "vtkmodules", "matplotlib"}
        assert "skfem" in sys.modules and not heavy & set(sys.modules)
    """
    errors_of(code)


def test_compiled_code_is_kept_and_renewed_where_its_files_are_damaged(tmp_path):
    code = """
        from pathlib import Path
        forked(forces, False)
        forked(forces, True)
        for kind, size in (("nbc", 1000), ("nbi", 20), ("nb?", 0)):
            files = list(Path(os.environ["NUMBA_CACHE_DIR"]).rglob("*." + kind))
            assert files
            for file in files:
                file.write_bytes(file.read_bytes()[:size])
            forked(forces, False)
        forked(forces, True)
    """
    assert errors_of(FORKED, FORCES, code, NUMBA_CACHE_DIR=str(tmp_path)) == ""


@pytest.mark.slow
def test_a_first_run_compiles_few_functions_and_keeps_what_python_calls(tmp_path):
    """Parts of the time loop are translated once each, for each of their types."""
    code = """
        from pathlib import Path
        from stepping_systems import of_stepper
        from skfem_joint.ground.compiling import COMPILING
        from skfem_joint.runs.integrate import integrate
        for kind, most in (("chain", 80), ("dense", 135)):  # 70 and 124 today
            integrate(of_stepper(kind), step=1e-5, n_steps=20)
            assert COMPILING.count <= most, (kind, COMPILING.count)
        files = Path(os.environ["NUMBA_CACHE_DIR"]).rglob("*.nbi")
        kept = {file.name.partition("-")[0] for file in files}
        assert kept == {"law._forces", "law.graph_parameters", "time_loop.time_loop"}, kept
    """
    assert errors_of("import os", code, NUMBA_CACHE_DIR=str(tmp_path)) == ""


def test_without_a_folder_for_compiled_code_all_runs_and_it_is_said_once():
    before = "from numba.core.caching import CacheImpl; CacheImpl._locator_classes = []"
    after = "from skfem_joint.minimise import front_elimination, contact_newton; forces(False)"
    errors = errors_of(before, FORCES, after)
    assert errors.count("RuntimeWarning: compiled code cannot be kept") == 1
    assert "NUMBA_CACHE_DIR" in errors


def test_on_a_full_disk_all_runs_and_it_is_said_once(tmp_path):
    code = """
        import resource, signal
        def full():
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.RLIM_INFINITY))
            forces(False)
        forked(full)
        forked(forces, False)  # what is left there does no harm when there is room again
        forked(forces, True)
    """
    errors = errors_of(FORKED, FORCES, code, NUMBA_CACHE_DIR=str(tmp_path))
    assert errors.count("RuntimeWarning: compiled code cannot be kept") == 1


@pytest.mark.slow
def test_compilation_and_preparation_are_timed_apart(tmp_path):
    """A first run compiles; a run from the cache, or of another system, does not."""
    code = """
        from stepping_systems import of_stepper
        from skfem_joint.runs.integrate import integrate
        from skfem_joint.stepping.stopwatch import Stopwatch
        watch = Stopwatch()
        first, second = (integrate(of_stepper("dense"), step=1e-5, n_steps=2) for _ in range(2))
        assert bool(first.compilation_s) == COLD
        assert second.compilation_s == 0.0
        assert first.preparation_s > 0.0
        own, compiled = watch.read()
        assert compiled == first.compilation_s
        assert own > first.preparation_s
    """
    for cold in (True, False):
        errors_of(f"COLD = {cold}", code, NUMBA_CACHE_DIR=str(tmp_path))
