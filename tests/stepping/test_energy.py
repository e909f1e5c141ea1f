"""One bookkeeping: steps in Python and in the compiled loop add up the same works and peaks."""

import numpy as np
import pytest
from stepping_systems import LapJoint, dense_system, not_a_chain, run_of

import skfem_joint as sj
from skfem_joint.stepping.recording import Recorder, Run
from skfem_joint.stepping.schemes import State, generalized_alpha

SCHEMES = [generalized_alpha(1.0), generalized_alpha(0.6)]


def booked_again(run: Run, step: float, trapezoidal: bool) -> Recorder:
    """What the functions add up in Python from the stored states of a run."""
    s = run.system
    recorder = Recorder(s, sj.Save(), len(run.field_times) - 1, step)
    states = [
        State(u, v, *2 * (0.0 * u,), sigma)
        for u, v, sigma in zip(run.u, run.v, run.sigma, strict=True)
    ]
    recorder.observe(states[0])
    for k in range(1, len(run.u)):
        ends = run.amplitudes[k - 1], run.amplitudes[k]
        recorder.add_step(step, ends, states[k - 1], states[k], trapezoidal)
    return recorder


@pytest.mark.parametrize("system", [LapJoint(elements=40).system, dense_system(5, 6)])
def test_the_compiled_loop_adds_up_what_python_does_from_the_same_states(system):
    run = run_of(system, 200, save=sj.Save(fields=True, slips=True))
    again = booked_again(run, 1e-5, True)
    energy = np.abs(run.input_work).sum()
    np.testing.assert_allclose(again.input_work, run.input_work, atol=1e-12 * energy)
    np.testing.assert_allclose(again.friction_work, run.friction_work, atol=1e-12 * energy)
    np.testing.assert_allclose(again.slip_peak, run.slip_peak, rtol=1e-12)
    np.testing.assert_allclose(again.peak, run.peak, rtol=1e-12)
    assert again.dissipated[0] == pytest.approx(run.viscous_work, abs=1e-12 * energy)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_steps_in_python_and_in_the_compiled_loop_dissipate_the_same(scheme):
    """The same chain, and with a coupling too weak to matter that makes it none."""
    system = LapJoint(elements=12).system
    systems = system, not_a_chain(system)
    one, two = (run_of(s, 200, scheme=scheme, tolerance=1e-13) for s in systems)
    assert one.counters.linear_solves == 0 < two.counters.linear_solves
    for name in ("viscous_work", "scheme_work", "friction_work", "input_work", "slip_peak"):
        a, b = np.atleast_1d(getattr(one, name)), np.atleast_1d(getattr(two, name))
        np.testing.assert_allclose(b, a, rtol=1e-8, atol=1e-9 * np.abs(one.input_work).sum())
    assert max(one.energy_residual, two.energy_residual) < 1e-11
