"""Competitors solve the same equations; benchmarks run; two plates do what their page says."""

import csv
import re
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks import brake_reuss, ready_made, steady
from benchmarks.first_order import LOWER, UPPER, FirstOrder, lumped
from benchmarks.integrators import FORMS, QUICK_FORMS, Form, Solution, Task, solve
from joint_scenes import lap_joint

import skfem_joint as sj
from skfem_joint.results.history import difference, results
from skfem_joint.study import error_time as et
from skfem_joint.study.certificate import make_reference

EXAMPLES = Path(__file__).parents[2] / "examples"
#: What the example of two plates printed when the pages were made.
MEASURED = EXAMPLES.parent / "docs" / "verification" / "measured" / "two-plates.md"


def small(beta=1e3):
    """The reference system of the paper with ten elements and a gentle law."""
    bar = sj.build_bar([("joint", 0.25, 10)], {"fixed": 0.0, "free_end": 0.25})
    return lap_joint(bar=bar, beta=beta, time={"cycles": 2, "steps_per_cycle": 50})


@pytest.fixture(scope="module")
def truth():
    return make_reference(small(), quick=True)


def test_samples_give_the_energies_that_steps_add_up(truth):
    run = truth.grid.integrate(truth.system, truth.parts, fields=ready_made.SAMPLES)
    found = difference(truth.results, ready_made.sampled(truth, run.u, run.v))
    assert found["displacement_rms"] < 1e-6
    assert found["friction_energy"] < 2e-4
    assert found["loop_energy"] < 5e-4


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_ready_made_integrators_solve_the_same_equations(form, truth):
    tolerance = {"Radau": 1e-2, "BDF": 1e-4}.get(form.name, 1e-5)
    model = FirstOrder(lumped(truth.system) if form.is_lumped else truth.system)
    times = ready_made.sample_times(truth)
    absolute = ready_made.ABSOLUTE * tolerance * np.tile([1e-4, 0.5], truth.system.n)
    found = solve(Task(form, model, times, tolerance, absolute, 30.0, np.zeros_like(absolute)))
    assert isinstance(found, Solution), found
    ours = truth.grid.integrate(model.system, 256).point_u
    theirs = found.y[:: ready_made.SAMPLES, ::2] @ model.system.P.T
    assert np.linalg.norm(theirs - ours) < 2e-5 * np.linalg.norm(ours)


def test_jacobians_are_derivatives(truth):
    n, c = 2 * truth.system.n, 3e4
    generator = np.random.default_rng(1)
    y = generator.normal(size=n) * np.where(np.arange(n) % 2, 1e-3, 1e-6)
    rate = generator.normal(size=n)
    steps = np.where(np.arange(n) % 2, 1e-7, 1e-9)

    def difference_of(function, shift):
        columns = []
        for e in np.diag(steps):
            ends = np.zeros((2, n))
            for sign, out in zip((1.0, -1.0), ends, strict=True):
                function(1e-4, y + sign * e, rate + sign * shift * e, out)
            columns.append((ends[0] - ends[1]) / (2.0 * e.max()))
        return np.array(columns).T

    model, light = FirstOrder(truth.system), FirstOrder(lumped(truth.system))
    rates = light.rates()
    square, bands = np.zeros((n, n)), np.zeros((LOWER + UPPER + 1, n))
    model.residual_jacobian()(y, c, square)
    wanted = difference_of(model.residual(), c)
    np.testing.assert_allclose(wanted, square, atol=1e-6 * np.abs(square).max())
    light.rate_jacobian(square=True)(y, square)
    wanted = difference_of(lambda t, a, b, out: rates(t, a, out), 0.0)
    np.testing.assert_allclose(wanted, square, atol=1e-6 * np.abs(square).max())
    light.rate_jacobian(square=False)(y, bands)
    for k in range(-LOWER, UPPER + 1):
        row = bands[UPPER - k, max(k, 0) : n + min(k, 0)]
        np.testing.assert_array_equal(np.diagonal(square, k), row)
    # The rates make the residual vanish.
    found, left = np.zeros((2, n))
    rates(2e-4, y, found)
    light.residual()(2e-4, y, found, left)
    assert np.abs(left).max() < 1e-12 * np.abs(light.system.M @ found[1::2]).max()


def test_competitor_beyond_the_bound_is_listed_as_such(truth):
    jobs = ready_made.ready_made_jobs(truth, 1e-3, [Form("BDF", (1e-4, 1e-6, 1e-8))])
    found = et.measure(jobs, truth, repeats=1)
    assert found[0].outcome.status == "did not finish in 0.001 s"
    assert all(p.outcome.status.startswith("not tried") for p in found[1:])
    assert not any(p.counts for p in found)


def test_sundials_may_be_missing_and_no_integrator_takes_a_set_valued_law(truth):
    (job,) = ready_made.ready_made_jobs(truth, 1.0, [Form("IDA", (1e-4,))], installed=False)
    assert "skfem-joint[bench]" in job.run().status
    coulomb = replace(truth, system=truth.system.with_beta(np.inf))
    assert list(ready_made.ready_made_jobs(coulomb, 1.0)) == []
    assert list(ready_made.explicit_jobs(coulomb)) == []
    with pytest.raises(sj.InputError, match="set-valued"):
        FirstOrder(coulomb.system)


@pytest.mark.slow
def test_explicit_runs_are_whole_if_short_and_else_extrapolated(truth):
    gentle = replace(truth, system=truth.system.with_beta(20.0))
    own = results(truth.grid.integrate(gentle.system, 256))
    for longest, status in ((np.inf, et.FINISHED), (0.0, "extrapolated")):
        (job,) = ready_made.explicit_jobs(gentle, longest)
        found = job.run()
        assert found.status == status
        if found.results is not None:
            assert difference(own, found.results)["displacement_rms"] < 1e-6


@pytest.mark.slow
def test_the_report_joins_competitors_to_our_models(tmp_path, capsys):
    scene = str(EXAMPLES / "lap_joint_reference.toml")
    assert ready_made.main([scene, "--out", str(tmp_path), "--quick"]) == 0
    assert "full, arctan / ready-made, error 1e-03" in capsys.readouterr().out
    with (tmp_path / "error-time.csv").open(newline="") as stream:
        families = {row["family"] for row in csv.DictReader(stream)}
    made = {f"ready-made {form.name}" for form in QUICK_FORMS}
    assert families >= {et.FULL, et.COULOMB, ready_made.MESH, ready_made.EXPLICIT, *made}
    assert "interleaved unknowns" in (tmp_path / "error-time.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_benchmark_of_substructures_is_equal_to_the_whole(capsys):
    pytest.importorskip("gmsh")
    from benchmarks import substructures

    substructures.main(["--quick"])
    printed = capsys.readouterr().out
    differences = re.findall(r"\d\.\de-\d\d", printed)
    assert len(differences) == 4
    assert max(map(float, differences)) < 1e-7


# The two plates of Fig. 18


@pytest.fixture(scope="module")
def example():
    return runpy.run_path(str(EXAMPLES / "two_plates.py"))


@pytest.fixture(scope="module")
def struts(example):
    models = [example[name]() for name in ("strut_b", "strut_a", "strut_in_series")]
    return [example["run_all"](model) for model in models]


def row(name):
    """Resonance, displacement, friction energy, active length; friction energy of the impulse."""
    lines = MEASURED.read_text(encoding="utf-8").partition(" Hz, last period")[2].splitlines()
    (line,) = (line for line in lines if line[:27].strip() == name)
    numbers = [float(number) for number in re.findall(r"\d[\d.]*", line[27:])]
    return *numbers[2:5], numbers[6], numbers[-2]


def test_the_page_has_the_numbers_of_the_struts(example, struts):
    for result in struts:
        model = result.model
        resonance, end, friction, active, pulse = row(model.name)
        slipping = example["active_lengths"](model, result.coulomb)[0]
        assert example["resonance"](model, result.coulomb) == pytest.approx(resonance, abs=1)
        assert 1e6 * np.abs(result.ends[0]).max() == pytest.approx(end, abs=0.1)
        assert model.lost(result.harmonic) == pytest.approx(friction, abs=2e-3)
        assert 1e3 * slipping == pytest.approx(active, abs=0.1)
        assert model.lost(result.pulse) == pytest.approx(pulse, abs=2e-3)


def test_half_of_the_joint_in_series_is_the_whole_and_the_simple_one_four_times_as_lossy(struts):
    simple, whole, half = struts
    for one, other in zip(half.ends, whole.ends, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-8 * np.abs(other).max())
    lost = [result.model.lost(result.pulse) for result in (half, whole)]
    assert lost[0] == pytest.approx(lost[1], rel=1e-6)
    ratio = np.abs(simple.ends[0]).max() / np.abs(whole.ends[0]).max()
    assert ratio == pytest.approx(0.945, abs=0.003)
    losses = simple.model.lost(simple.harmonic) / whole.model.lost(whole.harmonic)
    assert losses == pytest.approx(4.0, abs=0.05)


def test_a_slow_load_meets_the_closed_form(example, capsys):
    models = [example[name](100, 10) for name in ("strut_b", "strut_a")]
    example["print_slow"]({model.name: (model, example["slow"](model)) for model in models})
    lines = capsys.readouterr().out.splitlines()[2:]
    assert len(lines) == 2
    for line in lines:
        numbers = [float(number) for number in re.findall(r"\d+\.\d+", line)]
        np.testing.assert_allclose(numbers[0:6:2], numbers[1:6:2], rtol=0.01)
        assert numbers[6] == pytest.approx(numbers[7], abs=1.5)


def test_the_published_beam_has_its_peak_where_it_is_published():
    force, peak, omega = steady.BEAM[2]
    around = (omega + np.array([-4.0, -1.5, 1.0])) / (2.0 * np.pi)
    (curve,) = sj.response(steady.beam(), around, (force,), refined=False, estimated=False)
    at, size = curve.peak
    assert 2.0 * np.pi * at == pytest.approx(omega, abs=3.0)
    assert 1e3 * size == pytest.approx(peak, rel=0.015)


def test_the_benchmark_of_steady_vibration_counts_periods():
    cases = ((2225.0, 0.03), (2000.0, 0.03), (2025.0, 0.1), (1790.0, 0.3))
    systems = [steady.bar(*case, elements=50) for case in cases]
    assert 5 * steady.periods(systems, 8) < steady.periods(systems, 0)


def test_sundials_marches_steady_vibration_to_what_it_was():
    where, elements = (2270.0, 0.03), 20
    run = sj.integrate(steady.bar(*where, elements=elements), until="steady", steps_per_cycle=800)
    steep = steady.bar(*where, steady.STEEP, elements)
    size, energy = steady.marched(steep, run.final, 2)[:, -1]
    assert np.ptp(run.point("free_end")) == pytest.approx(2.0 * size, rel=1e-3)
    assert run.cycles.friction[-1] == pytest.approx(energy, rel=1e-3)


def test_harmonic_balance_converges_to_our_steady_vibration():
    balanced = pytest.importorskip("benchmarks.balance").balanced
    bar = steady.bar(2050.0, 0.1, 1.0, 10)
    ours = steady.first_harmonic(sj.integrate(bar, until="steady", steps_per_cycle=400))
    errors = [abs(balanced(bar, most) / ours - 1.0) for most in ([1], [1, 3], [1, 3, 5])]
    assert errors[2] < 5e-5
    assert errors[0] > 5.0 * errors[1] > 25.0 * errors[2]


@pytest.mark.slow
def test_the_beam_with_contact_that_opens_lies_near_the_published_curves():
    """Damping within 5 % of that of flat faces, frequency within 6 % of both."""
    system = brake_reuss.beam("unilateral").system(points=["upper_end"])
    (curve,) = sj.backbone(system, modes=[7], levels=12)
    reach = np.abs(curve.displacement).max(axis=1)
    ends = [end for _, end in brake_reuss.PUBLISHED.values()]
    frequency, damping = (
        np.interp(ends[0][0], reach, y) for y in (curve.frequency, 100.0 * curve.damping_ratio)
    )
    assert damping == pytest.approx(ends[0][2], rel=0.05)
    assert all(abs(frequency / end[1] - 1.0) < 0.06 for end in ends)
    assert max(curve.estimated.values()) < 0.01
