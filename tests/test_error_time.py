"""Error against run time: a reference that is one, competitors that solve the same equations."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skfem_joint import cli
from skfem_joint.error_time import first_order, points, ready_made, reference, report, table
from skfem_joint.error_time.measure import FINISHED, Outcome, Point, What, measure
from skfem_joint.error_time.reference import Distance, Reference, distance
from skfem_joint.errors import InputError
from skfem_joint.meshing import build_bar
from skfem_joint.paper.cases import CASES, scene
from skfem_joint.scene import Scene
from tests.bars import order_of

TINY = points.Range(
    parts=(1, 4),
    factors=(10.0,),
    meshes=(5, 10),
    modes=(2,),
    swept=(2,),
    reduced_parts=(2,),
    counts=(3,),
    longest_explicit=0.0,
)


def small(**options: object) -> Scene:
    values = {"elements": 10, "beta": 1e3, "time": {"cycles": 2, "steps_per_cycle": 50}}
    return scene(CASES["reference"], **(values | options))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def truth() -> Reference:
    return reference.make_reference(small(), quick=True)


@pytest.fixture(scope="module")
def tiny_report() -> report.Report:
    return report.error_time(
        small(beta=200.0),
        bound=5.0,
        repeats=1,
        quick=True,
        wanted=TINY,
        forms=tuple(replace(form, tolerances=(1e-2,)) for form in ready_made.QUICK_FORMS),
    )


def point(wall: float, error: float, status: str = FINISHED) -> Point:
    what = What(points.FULL, "full", "any", 10, None, 10, 1e3, 1e-5)
    return Point(what, status, wall, 0.0, Distance(error, error, error, error, error))


def test_reference_is_known_better_than_any_point(truth: Reference) -> None:
    step, mesh, beta = truth.estimates
    assert [step.source, mesh.source, beta.source] == ["time step", "mesh", "beta"]
    finer = reference.results(truth.grid.integrate(truth.system, 1024, 1.0))
    # The extrapolated reference is closer to the truth than the run it comes from is said to be.
    assert distance(finer, truth.results).rms < 0.2 * step.errors["displacement_rms"]
    assert abs(distance(finer, truth.results).friction_energy) < step.errors["friction_energy"]


def test_samples_give_the_energies_that_steps_add_up(truth: Reference) -> None:
    found = distance(truth.results, truth.sampled)
    assert found.rms < 1e-4
    assert abs(found.friction_energy) < 2e-3
    assert abs(found.loop_energy) < 2e-3


def test_error_of_the_full_model_falls_with_the_step(truth: Reference) -> None:
    parts = (2, 4, 8, 16)
    errors = [
        distance(truth.results, reference.results(truth.grid.integrate(truth.system, n, 1.0))).rms
        for n in parts
    ]
    assert 0.8 < order_of(errors, [1.0 / n for n in parts]) < 2.2


@pytest.mark.parametrize("form", ready_made.FORMS, ids=lambda f: f"{f.name}-{f.jacobian}")
def test_ready_made_integrators_solve_the_same_equations(
    form: ready_made.Form, truth: Reference
) -> None:
    tolerance = {"Radau": 1e-2, "BDF": 1e-4}.get(form.name, 1e-5)
    consistent = first_order.FirstOrder(truth.system)
    lumped = first_order.FirstOrder(first_order.lumped(truth.system))
    model = lumped if form.mass == "lumped" else consistent
    found = ready_made.solve(
        form,
        model,
        truth.grid.samples(),
        tolerance,
        ready_made.absolute_tolerances(truth, tolerance),
        bound=30.0,
    )
    assert isinstance(found, ready_made.Solution), found
    ours = truth.grid.integrate(model.system, 256, 1.0).point_u
    theirs = found.y[:: reference.SAMPLES, ::2] @ model.system.P.T
    assert reference.displacement_rms(ours, theirs) < max(10.0 * tolerance, 5e-5)


def test_jacobians_are_derivatives(truth: Reference) -> None:
    model = first_order.FirstOrder(truth.system)
    lumped = first_order.FirstOrder(first_order.lumped(truth.system))
    n = model.size
    generator = np.random.default_rng(1)
    y = generator.normal(size=n) * np.where(np.arange(n) % 2, 1e-3, 1e-6)
    rate = generator.normal(size=n)
    steps = np.where(np.arange(n) % 2, 1e-7, 1e-9)
    c = 3e4

    def difference(function, shift):  # type: ignore[no-untyped-def]
        columns = []
        for j in range(n):
            ends = []
            for sign in (1.0, -1.0):
                e = np.zeros(n)
                e[j] = sign * steps[j]
                out = np.zeros(n)
                function(1e-4, y + e, rate + shift * e, out)
                ends.append(out)
            columns.append((ends[0] - ends[1]) / (2.0 * steps[j]))
        return np.array(columns).T

    def residual(t, a, b, out):  # type: ignore[no-untyped-def]
        model.residual_function()(t, a, b, out)

    J = np.zeros((n, n))
    model.residual_jacobian()(y, c, J)
    scale = np.abs(J).max()
    np.testing.assert_allclose(difference(residual, c), J, atol=1e-6 * scale)

    for one, fill in (
        (model, model.full_rate_jacobian),
        (lumped, lumped.rate_jacobian(packed=False)),
    ):
        rates = one.rate_function()
        J = np.zeros((n, n))
        fill(y, J)
        wanted = difference(lambda t, a, b, out, f=rates: f(t, a, out), 0.0)
        np.testing.assert_allclose(wanted, J, atol=1e-6 * np.abs(J).max())

    packed = np.zeros((first_order.LOWER + first_order.UPPER + 1, n))
    lumped.rate_jacobian(packed=True)(y, packed)
    for k in range(-first_order.LOWER, first_order.UPPER + 1):
        row = packed[first_order.UPPER - k]
        np.testing.assert_array_equal(np.diagonal(J, k), row[max(k, 0) : n + min(k, 0)])


def test_rates_make_the_residual_vanish(truth: Reference) -> None:
    model = first_order.FirstOrder(truth.system)
    y = np.random.default_rng(2).normal(size=model.size) * 1e-4
    rate, left = np.zeros(model.size), np.zeros(model.size)
    model.rate_function()(2e-4, y, rate)
    model.residual_function()(2e-4, y, rate, left)
    s = truth.system
    scale = np.abs(s.M @ rate[1::2]).max()
    assert np.abs(left).max() < 1e-12 * scale


def test_competitor_beyond_the_bound_is_listed_as_such(truth: Reference) -> None:
    form = ready_made.Form("BDF", "lumped", "sparse", (1e-4, 1e-6, 1e-8))
    jobs = list(ready_made.ready_made_jobs(small(), truth, 1e-3, (form,)))
    found = measure(jobs, truth, repeats=1, longest=1.0)
    assert found[0].status == "did not finish in 0.001 s"
    assert all(p.status.startswith("not tried") for p in found[1:])
    assert not any(p.counts for p in found)
    assert "did not finish in 0.001 s" in table.markdown_table(found)


def test_sundials_is_named_when_it_is_missing(
    truth: Reference, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ready_made.importlib.util, "find_spec", lambda _: None)
    form = ready_made.Form("IDA", "consistent", "banded", (1e-4,))
    (job,) = ready_made.ready_made_jobs(small(), truth, 1.0, (form,))
    assert "skfem-joint[bench]" in job.run().status


def test_no_integrator_is_asked_to_take_a_set_valued_law() -> None:
    coulomb = small(beta=np.inf)
    truth = reference.make_reference(coulomb, quick=True)
    assert list(ready_made.ready_made_jobs(coulomb, truth, 1.0)) == []
    with pytest.raises(InputError, match="set-valued"):
        first_order.FirstOrder(truth.system)


def test_report_has_all_its_columns_and_sections(tiny_report: report.Report) -> None:
    rows = list(csv.DictReader(io.StringIO(table.csv_table(tiny_report.points))))
    assert list(rows[0]) == ["front", *table.COLUMNS]
    assert len(rows) == len(tiny_report.points)
    families = {row["family"] for row in rows}
    assert families >= {
        points.FULL,
        points.STEEPNESS,
        points.COULOMB,
        points.COARSE,
        points.POD,
        points.GAUSS,
        points.EXPLICIT,
        *(f"ready-made {name}" for name in ("IDA", "CVODE", "LSODA", "BDF", "Radau")),
    }
    finished = [row for row in rows if row["status"] == FINISHED]
    filled = ("displacement rms", "displacement max", "friction energy", "loop energy")
    for row in finished:
        assert all(
            row[name] != "" for name in (*filled, "to fine mesh", "wall time (s)", "memory (kB)")
        )
    explicit = [row for row in rows if row["family"] == points.EXPLICIT]
    assert all(row["status"] == "extrapolated" for row in explicit)
    assert all(row["displacement rms"] == "" and row["front"] == "0" for row in explicit)
    text = tiny_report.markdown()
    for heading in ("How well the reference is known", "Which model to use", "Speed ratios"):
        assert heading in text
    assert text.index("How well") < text.index("Which model") < text.index("All points")
    assert "regularisation (against Coulomb)" in text
    assert "BLAS threads" in text


def test_coarse_and_steep_models_carry_more_than_their_time_step_error(
    tiny_report: report.Report,
) -> None:
    finest = [p for p in tiny_report.points if p.steps == 4 * 50 and p.time_error is not None]
    for p in finest:
        assert p.distance is not None
        own = p.time_error or 0.0
        if p.what.family == points.FULL:
            assert p.distance.rms == pytest.approx(own)
        if p.what.family in (points.COARSE, points.STEEPNESS):
            assert p.distance.rms > 2.0 * own


@given(
    st.lists(
        st.tuples(st.floats(1e-4, 1e2), st.floats(1e-8, 1.0), st.booleans()),
        min_size=1,
        max_size=30,
    )
)
def test_front_is_the_lower_left_of_the_finished_points(
    data: list[tuple[float, float, bool]],
) -> None:
    measured = [point(w, e, FINISHED if done else "extrapolated") for w, e, done in data]
    finished = [(p.wall_s, table.rms(p)) for p in measured if p.counts]
    ahead = [(p.wall_s, table.rms(p)) for p in table.front(measured)]
    assert set(ahead) <= set(finished)
    assert ahead == sorted(ahead)
    assert [e for _, e in ahead] == sorted((e for _, e in ahead), reverse=True)  # type: ignore[type-var]
    for w, e in finished:
        dominated = any(a <= w and b <= e for a, b in ahead)  # type: ignore[operator]
        assert dominated
    for w, e in ahead:
        assert not any((a < w and b <= e) or (a <= w and b < e) for a, b in finished)  # type: ignore[operator]


def test_time_at_an_error_follows_the_logarithms() -> None:
    curve = [point(1e-3, 1e-2), point(1e-2, 1e-4), point(5e-2, 1e-3)]
    assert table.time_at(curve, 1e-3) == pytest.approx(10**-2.5)
    assert table.time_at(curve, 1e-1) == 1e-3
    assert table.time_at(curve, 1e-5) is None


@pytest.mark.parametrize(
    ("wall", "error", "words"),
    [
        (1e-3, 5e-3, "A reduction pays 10 times"),
        (1e-1, 5e-3, "does not pay: the fastest reduced"),
        (9e-3, 5e-3, "use full, step 1e-05 s (10 ms, error 1.0e-03). A reduction does not pay"),
        (1e-3, 5e-2, "does not pay: no reduced model reaches it"),
    ],
)
def test_advice_says_whether_a_reduction_pays(wall: float, error: float, words: str) -> None:
    full, reduced = point(1e-2, 1e-3), point(wall, error)
    reduced = replace(
        reduced, what=replace(reduced.what, family=points.POD, modes=5), offline_s=0.09
    )
    assert words in table.advice([full, reduced], 1e-2)
    if "pays" in words:
        assert "after 10 runs" in table.advice([full, reduced], 1e-2)


def test_coarse_mesh_keeps_regions_and_points() -> None:
    bar = build_bar(
        [("joint", 0.1, 40), ("linear", 0.5, 100)],
        {"fixed": 0.0, "junction": 0.1, "free_end": 0.6},
    )
    coarse = reference.coarsened(bar, 12)
    assert coarse.mesh.t.shape[1] == 12
    for name, node in bar.points.items():
        position = coarse.mesh.p[0, coarse.points[name]]
        assert position == pytest.approx(bar.mesh.p[0, node], abs=1e-12)
    np.testing.assert_array_equal(coarse.regions["joint"], [0, 1])
    np.testing.assert_array_equal(coarse.regions["linear"], np.arange(2, 12))
    np.testing.assert_allclose(coarse.coordinates[-1], bar.coordinates[-1])


def test_scene_without_cycles_is_compared_over_its_whole_run() -> None:
    impulse = small(
        load={"kind": "half_sine", "peak": 63e3, "rise_time": 2.5e-4},
        time={"duration": 1e-3, "step": 1e-5},
    )
    found = report.error_time(impulse, repeats=1, quick=True, wanted=TINY, forms=())
    full = [p for p in found.points if p.what.family == points.FULL]
    errors = [p.distance.rms for p in full if p.distance is not None]
    assert [p.steps for p in full] == [100, 400]
    assert errors[1] < 0.3 * errors[0]
    assert "regularisation" in found.markdown()


def test_what_does_not_converge_is_a_point_all_the_same(truth: Reference) -> None:
    from skfem_joint.error_time.measure import Job
    from skfem_joint.errors import ConvergenceError

    def fail() -> Outcome:
        raise ConvergenceError("step 3")

    job = Job(What("full", "full", "any", 10, None, 10, 1e3, 1e-5), fail)
    (found,) = measure([job], truth, repeats=2, longest=1.0)
    assert found.status == "did not converge: step 3"
    assert not found.counts


@pytest.mark.parametrize(("key", "value"), [("bound", 0.0), ("repeats", 0)])
def test_options_must_be_positive(key: str, value: float) -> None:
    with pytest.raises(InputError, match=rf"--{key}: found 0, must be"):
        report.error_time(small(), **{key: value})  # type: ignore[arg-type]


def test_scene_without_friction_is_refused() -> None:
    smooth = reference.variant(small(), joint={"friction": 0.0})
    with pytest.raises(InputError, match="nothing slips"):
        report.error_time(smooth)


def test_command_line_writes_the_report(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    tiny_report: report.Report,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in report.THREADS:
        monkeypatch.setenv(name, "1")
    monkeypatch.setattr("skfem_joint.scene.load_scene", lambda _: small())
    asked = {}

    def fake(_: Scene, **options: object) -> report.Report:
        asked.update(options)
        return tiny_report

    monkeypatch.setattr(report, "error_time", fake)
    status = cli.main(
        ["error-time", "a.toml", "--out", str(tmp_path), "--bound", "7", "--repeats", "2"]
    )
    assert status == 0
    assert (asked["bound"], asked["repeats"], asked["quick"]) == (7.0, 2, False)
    assert {f.name for f in tmp_path.iterdir()} == {f"error-time.{s}" for s in ("md", "csv", "png")}
    assert (tmp_path / "error-time.png").read_bytes().startswith(b"\x89PNG")
    assert "Displacement error 1e-02" in capsys.readouterr().out


def test_command_line_pins_threads_in_another_process(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in report.THREADS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("skfem_joint.scene.load_scene", lambda _: small())
    calls = []

    class Done:
        returncode = 3

    def run(command: list[str], env: dict[str, str], check: bool) -> Done:
        calls.append((command, env))
        return Done()

    monkeypatch.setattr("skfem_joint.cli.subprocess.run", run)
    assert cli.main(["error-time", "a.toml", "--out", "o", "--quick"]) == 3
    ((command, environment),) = calls
    assert command[1:4] == ["-m", "skfem_joint", "error-time"]
    assert "--quick" in command
    assert report.threads_pinned(environment)
