"""Response over frequency: linear limits, peaks, refusals, scenes; SI units."""

from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from bodies import structure
from opening_blocks import oscillator
from stepping_systems import arm

import skfem_joint as sj
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.study.scene_response import RESPONSE_ROWS
from skfem_joint.vibration.linear_response import linear_response
from skfem_joint.vibration.response import at_frequency, steady_plan, steady_point


def bar() -> sj.System:
    """Bar with a joint of 350 kN and 0.2 % damping at 2.5 kHz."""
    return arm(sj.Harmonic(1.0, 1000.0), stiffness_damping=4e-3 / 2500.0 / 2.0 / np.pi)


def test_where_no_steady_vibration_is_found_harmonic_balance_is_named():
    """A light one-sided spring of a hundred times the other's stiffness keeps no period."""
    with pytest.raises(sj.ConvergenceError, match=r"no steady vibration .* sj\.harmonic_response"):
        sj.response(oscillator(0.7, 0.01, 100.0), np.array([0.7]), steps_per_cycle=20)


def test_small_and_large_loads_go_to_the_linear_limits():
    system = bar()
    limit = float(system.contact.w.sum())
    f = np.array([1500.0, 1700.0])
    (small, large) = sj.response(system, f, (1e-6 * limit, 3e3 * limit), refined=False)
    for curve, stuck in ((small, True), (large, False)):
        linear = linear_response(system, f, stuck)
        assert curve.column("amplitude") / curve.level == pytest.approx(linear, rel=2e-3)


def test_a_linear_response_adds_the_harmonics_of_all_loads_through_sharp_resonances():
    system = arm(sj.Harmonic(1.0, 1000.0), damping_ratio=1e-4)
    two = sj.MultiHarmonic((sj.Harmonic(2.0, 1000.0, 0.3), sj.Harmonic(0.7, 3000.0, -1.0)))
    (tip,) = system.loads
    middle = replace(tip, vector=np.eye(system.n)[system.n // 2], amplitude=two)
    system = replace(system, loads=(tip, middle))
    K, C, M = (A.toarray() for A in (system.K, system.C, system.M))
    # Around the first resonance of the third harmonic, and up to beyond the third of the first.
    f = np.concatenate([np.linspace(400.0, 900.0, 150), np.linspace(1000.0, 9000.0, 250)])
    turn = 2.0 * np.pi * np.arange(256) / 256
    exact = []
    for frequency in f:
        motion = np.zeros((len(system.points), turn.size))
        for load in system.loads:
            for part in load.amplitude.harmonics:
                multiple = part.frequency / 1000.0
                omega = 2.0 * np.pi * multiple * frequency
                u = np.linalg.solve(K + 1j * omega * C - omega**2 * M, load.vector)
                wave = part.amplitude * np.sin(multiple * turn + part.phase)
                turned = part.amplitude * np.cos(multiple * turn + part.phase)
                motion += np.outer(system.P @ u.real, wave) + np.outer(system.P @ u.imag, turned)
        exact.append(0.5 * np.ptp(motion, axis=1))
    np.testing.assert_allclose(linear_response(system, f, stuck=False), exact, rtol=1e-6)


def test_a_linear_response_at_a_natural_frequency_that_nothing_damps_is_refused():
    square = (2.0 * np.pi) ** 2
    system = sj.System.from_matrices(
        np.eye(2), np.diag([square, 4.0 * square]), contact=sj.point_friction([0.0, 1.0], 1.0),
        loads={"load": (0, sj.Harmonic(1.0, 1.0))}, points={"a": 0, "b": 1},
    )  # fmt: skip
    near = linear_response(system, np.array([1.25]), stuck=False)[0, -2:]
    assert near == pytest.approx([1.0 / square / (1.25**2 - 1.0), 0.0], rel=1e-4)
    with pytest.raises(sj.InputError, match=r"found 1 Hz, .* nothing damps: give damping"):
        linear_response(system, np.array([1.0]), stuck=False)


def test_peaks_are_found_and_fall_with_the_level():
    system = bar()
    levels = np.array([0.03, 0.1]) * system.contact.w.sum()
    asked = np.linspace(1600.0, 2600.0, 6)
    with ThreadPoolExecutor(1) as executor:
        curves = sj.response(system, asked, levels.tolist(), executor=executor)
    peaks = np.array([curve.peak for curve in curves])
    assert np.all(np.diff(peaks[:, 0]) < 0.0)
    fine = np.linspace(0.995, 1.005, 3) * peaks[1, 0]
    (near,) = sj.response(system, fine, levels[1:2].tolist(), refined=False)
    assert peaks[1, 1] == pytest.approx(near.column("amplitude").max(), rel=3e-3)
    middle = curves[1]
    # The force leads the motion, ever more through the resonance.
    phase = middle.column("phase")[:, 0]
    assert np.all(np.diff(phase) < 0.0)
    assert phase[0] > -0.5
    assert phase[-1] < -1.6


def test_a_search_is_given_up_where_a_joint_slips_as_a_whole_for_so_many_periods(caplog):
    """At resonance with 0.2 % damping: 1.5 times the joint's limit moves all of it."""
    system = at_frequency(bar(), 1900.0, 1.5 * float(bar().contact.w.sum()))
    plan = steady_plan(system, 100)
    assert plan.gross_periods is not None
    run = integrate_plan(system, plan)  # its Newton's method needs fewer periods
    assert run.vibration.periods > 5
    assert system.slips_as_a_whole(system.contact.slid(run.friction_work), plan.duration)
    notes = []
    with pytest.raises(sj.ConvergenceError, match="slips as a whole for 5 periods in turn"):
        integrate_plan(
            system,
            replace(plan, gross_periods=1),
            progress=lambda *what: notes.append(what[-1]),
        )
    assert "a joint slips as a whole" in notes[-1]
    levels = 0.1 * float(system.contact.w.sum()), 1.5 * float(system.contact.w.sum())
    low, high = sj.response(bar(), np.array([1900.0]), levels, refined=False, estimated=False)
    assert low.gross.size == 0
    assert high.gross == pytest.approx([1900.0])
    assert "a joint slips as a whole at 1900 Hz" in caplog.text
    assert low.notes == ()
    assert high.notes[0].startswith(f"Level {levels[1]:g}: a joint slips as a whole at 1900 Hz")


def test_a_curve_says_where_its_peak_may_be_missing_and_where_its_step_is_coarse():
    rising, level = np.array([300.0, 600.0, 900.0]), 0.1 * float(bar().contact.w.sum())
    (curve,) = sj.response(bar(), rising, [level], refined=False, estimated=False)
    (note,) = curve.notes
    end = curve.known[0][int(curve.known[1].argmax())]
    assert end in (300.0, 900.0)
    assert f"the largest amplitude is at {end:g} Hz, the" in note
    errors = [0.0, 0.09, np.nan]
    points = [replace(p, step_error=e) for p, e in zip(curve.points, errors, strict=True)]
    _, unknown, coarse = replace(curve, points=tuple(points)).notes
    assert "the error of the step is not known" in unknown
    assert "errs by up to 9 % of the amplitude, and by more than 5 % at 1 freq" in coarse
    assert "3.0 times as many steps_per_cycle" in coarse  # sqrt(9)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"frequencies": [2.0, 1.0]}, r"frequencies\[1\]: found 1, must be > 2"),
        ({"levels": ()}, "levels"),
        ({"system": at_frequency(bar(), 1.0, 0.0)}, "no load acts"),
    ],
)
def test_what_has_no_response_is_refused(changes, says):
    with pytest.raises(sj.InputError, match=says):
        sj.response(**({"system": bar(), "frequencies": [1.0], "levels": (1.0,)} | changes))


def test_loads_at_another_frequency_keep_their_shape_and_pulses_have_none():
    system = bar()
    moved = at_frequency(system, 500.0, 3.0).loads[0].amplitude
    times = np.linspace(0.0, 2e-3, 9)
    assert moved(times) == pytest.approx(3.0 * np.sin(2.0 * np.pi * 500.0 * times))
    pulse = replace(system.loads[0], amplitude=sj.HalfSine(1.0, 1e-3))
    with pytest.raises(sj.InputError, match="harmonic"):
        at_frequency(replace(system, loads=(*system.loads, pulse)), 500.0)


def test_each_point_knows_the_error_of_its_step():
    """Near a resonance whose third harmonic meets another."""
    system, f = bar(), np.array([1750.0, 1780.0, 1790.0, 1800.0])
    levels = (0.3 * system.contact.w.sum(),)
    (rough,), (fine,) = (
        sj.response(system, f, levels, steps_per_cycle=steps, refined=False) for steps in (200, 800)
    )
    true = np.abs(rough.column("amplitude") / fine.column("amplitude") - 1.0)[:, 0]
    assert true.min() > 0.005
    assert rough.column("step_error") == pytest.approx(true, rel=0.5)


def test_a_bar_in_contact_throughout_does_not_move_while_it_sticks():
    """Friction alone holds it; it is pulled at its end."""
    joint = sj.Joint("joint", pressure=8e6, friction=0.7, beta=np.inf)
    mesh = sj.build_bar([("joint", 0.2, 10)], {"end": 0.2})
    made = structure(mesh, [joint], (), stiffness_damping=1e-6)
    system = made.system([sj.Load("end", sj.Harmonic(1e4, 1000.0))])
    f = np.array([500.0, 1000.0])
    assert not linear_response(system, f, stuck=True).any()
    assert linear_response(system, f, stuck=False).all()
    (curve,) = sj.response(system, f, (1e-3,), refined=False)
    assert not curve.column("amplitude").any()


def test_a_reduced_model_is_refused_where_loads_differ_from_its_own():
    """Made at 500 Hz and 20 kN it has 13 % of the damping at the highest level of the curve."""
    system = arm(sj.Harmonic(2e4, 500.0), stiffness_damping=2.5e-7)
    small, condensed = sj.reduce(system, modes=4), sj.condense(system)
    (curve,) = sj.backbone(condensed, levels=2)
    calls = {
        "response": lambda one: sj.response(one, [200.0], refined=False, estimated=False),
        "backbone": lambda one: sj.backbone(one, levels=2),
        "ring_down": lambda one: sj.ring_down(one, curve, 8),
    }
    for what, call in calls.items():
        for same in (small, replace(small, notes=())):
            with pytest.raises(sj.InputError, match=f"{what}: .* \\(500 Hz\\).*sj.condense"):
                call(same)
        assert call(condensed)
    assert sj.integrate(small, cycles=1, steps_per_cycle=50).friction_energy["joint"] > 0.0


@pytest.mark.parametrize("steps", [8, 9, 10, 12])
def test_harmonics_that_so_few_steps_do_not_determine_are_nan(steps):
    point = steady_point(bar(), 500.0, steps_per_cycle=steps)
    known = np.arange(1, 6) < steps / 2
    np.testing.assert_array_equal(np.isfinite(point.harmonics), known[np.newaxis])


def test_what_finished_beside_a_worker_that_fails_is_kept(tmp_path):
    class Workers(Executor):
        """Workers that end at the same moment; the first one fails."""

        given = 0

        def submit(self, function, /, *arguments, **keywords):
            self.given, future = self.given + 1, Future()
            if self.given == 1:
                future.set_exception(sj.InputError("the first cannot"))
            else:
                future.set_result(function(*arguments, **keywords))
            return future

    kept, levels = sj.Rows(tmp_path / "rows.jsonl", RESPONSE_ROWS), (1.0, 2.0, 3.0, 4.0, 5.0)
    with pytest.raises(sj.InputError, match="the first cannot"):
        sj.response(bar(), [500.0], levels, executor=Workers(), rows=kept, refined=False)
    assert sj.Rows(kept.path, RESPONSE_ROWS).known == len(levels) - 1


def test_a_linear_response_is_exact_at_few_steps_whatever_the_damping():
    """The trapezoidal rule is warped: unwarped it loses 71 % of the peak at a ratio of 1e-4."""
    for ratio in (1e-4, 1e-5):
        loose = sj.Joint("joint", pressure=50e6, friction=0.0)
        system = arm(sj.Harmonic(1.0, 1000.0), loose, (10, 10), damping_ratio=ratio)
        K, C, M = (A.toarray() for A in (system.K, system.C, system.M))
        omega = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real.min())
        for near in (1.0 - ratio, 1.0, 1.01):
            frequency = near * omega / (2.0 * np.pi)
            w = 2.0 * np.pi * frequency
            u = system.P @ np.linalg.solve(K + 1j * w * C - w**2 * M, system.loads[0].vector)
            point = steady_point(system, frequency, 1.0, 100)
            assert point.harmonics[:, 0] == pytest.approx(u / 1j, rel=2e-5)
            # Of a hundred samples in a period the highest may miss the crest by half a step.
            assert point.amplitude == pytest.approx(np.abs(u), rel=6e-4)
            # Works are of forces that are linear within a step: their sine is sin(x) / x of itself.
            work = np.pi * np.abs(u.imag[0]) * np.sinc(2.0 / 100)
            assert point.input_energy == pytest.approx(work, rel=1e-4)


@pytest.mark.parametrize("share", [1e-9, 1e-6, 1e-4])
def test_light_damping_has_a_steady_vibration_below_and_above_the_first_slip(share):
    joint = sj.Joint("joint", pressure=50e6, friction=0.7, beta=np.inf)
    system = arm(sj.Harmonic(1.0, 1000.0), joint, (10, 10), damping_ratio=1e-5)
    still = np.setdiff1d(np.arange(system.n), system.contact.B.indices)
    K, M = (A.toarray()[np.ix_(still, still)] for A in (system.K, system.M))
    frequency = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real.min()) / (2.0 * np.pi)
    level = share * float(system.contact.w.sum())
    point = steady_point(system, frequency, level, 100)
    assert point.failure is None
    exact = linear_response(system, np.array([frequency]), stuck=True)[0] * level
    if share == 1e-9:
        assert point.friction_energy == 0.0
        assert point.amplitude == pytest.approx(exact, rel=5e-3)
    else:
        assert 0.0 < point.friction_energy < point.input_energy
        assert (point.amplitude < exact).all()


def test_errors_of_the_step_are_those_of_friction_alone():
    """A stuck bar with light damping has none; friction's harmonics that meet a mode have."""

    def said(system: sj.System, level: float, frequencies: list[float], steps: int) -> str:
        levels = [level * float(system.contact.w.sum())]
        (curve,) = sj.response(system, frequencies, levels, steps_per_cycle=steps)
        return "\n".join(curve.notes)

    light = said(arm(sj.Harmonic(1.0, 1e3), damping_ratio=1.2e-3), 1e-7, [2495.0, 2498.0], 100)
    assert "step alone" not in light
    strong = said(bar(), 0.3, [1785.0, 1795.0], 60)
    assert "harmonics of friction" in strong
