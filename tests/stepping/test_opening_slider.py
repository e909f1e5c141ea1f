"""An elastic slider whose normal load varies in time, and solids of such sliders."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.slider import (
    LIFTS,
    MU,
    PRESSED,
    SPRING,
    X,
    followed,
    loop_energy,
    slider,
)
from opening_blocks import block, loads
from scipy import sparse

import skfem_joint as sj
from skfem_joint.stepping.arrangement import arranged

SCHEME = sj.generalized_alpha(0.5)
#: Unknowns that are neither slips nor approaches.
TURNED = np.array([[0.8, -0.6], [0.6, 0.8]])


def _pressed_by(system, **values):
    """System with other values of its pressure points."""
    normal = replace(system.contact.normal, **values)
    return replace(system, contact=replace(system.contact, normal=normal))


@pytest.mark.parametrize("turned", [False, True])
def test_the_loop_of_a_slider_under_a_load_in_phase_is_that_of_its_closed_form(turned):
    """The error of the energy falls with the square of the increment.

    In unknowns that are neither slips nor approaches contact is elastic: it carries the share of
    the normal load that its stiffness has.
    """
    system, errors = slider(150.0, 0.0), []
    if turned:
        system = _pressed_by(system, stiffness=np.full(1, 4.0 * LIFTS)).project(TURNED)
        assert arranged(system).kind == "dense"
    exact = loop_energy(0.8 * 150.0 if turned else 150.0)
    for steps in (50, 100, 200):
        run = sj.quasi_static(system, cycles=3, steps_per_cycle=steps)
        errors.append(abs(run.cycles.friction[-1] / exact - 1.0))
        assert run.energy_residual < 1e-9
    assert errors[2] < (2e-3 if turned else 1e-3)
    # 16 but for where in an increment the slider turns
    assert (8.0 if turned else 10.0) * errors[2] < errors[0]


@pytest.mark.parametrize(("varies", "phase"), [(150.0, 0.5 * np.pi), (150.0, np.pi), (350.0, 1.0)])
def test_the_force_of_a_slider_is_cut_to_the_limit_and_let_go_where_contact_opens(varies, phase):
    system, steps = slider(varies, phase), 400
    run = sj.quasi_static(system, cycles=2, steps_per_cycle=steps, save=sj.Save(fields=True))
    force = run.sigma[:, 0] * MU * run.normal_force[:, 0]
    known, _ = followed(varies, phase, 2, steps)
    assert np.abs(force - known).max() < 0.02 * MU * (PRESSED + varies)
    opened = run.normal_force[:, 0] == 0.0
    assert opened.any() == (varies > PRESSED)
    assert np.all(force[opened] == 0.0)
    # What is stored in the spring and lost is what the loads put in.
    assert run.energy_residual < 1e-9


def test_steady_vibration_that_is_slow_has_the_loop_of_the_closed_form():
    run = sj.integrate(slider(150.0, 0.0), until="steady", steps_per_cycle=200, scheme=SCHEME)
    assert run.cycles.friction[-1] == pytest.approx(loop_energy(150.0), rel=5e-3)
    assert run.stored_energy[1] == pytest.approx(run.stored_energy[0], rel=1e-6)


def test_sparse_matrices_whose_slip_and_approach_share_unknowns_are_stepped_as_dense_ones():
    system = slider(150.0, 0.0)
    rigid = system.project(TURNED)
    values = {name: sparse.csr_array(getattr(rigid, name)) for name in ("M", "C", "K", "P")}
    of_points = replace(rigid.contact, B=sparse.csr_array(rigid.contact.B))
    rigid = replace(rigid, contact=of_points, **values)
    rigid = _pressed_by(rigid, N=sparse.csr_array(rigid.contact.normal.N))
    with pytest.raises(sj.InputError, match="or contact be elastic"):
        arranged(rigid)
    whole, small = (_pressed_by(s, stiffness=np.full(1, 1e4)) for s in (system, rigid))
    assert arranged(small).kind == "dense"
    for solve in (sj.integrate, sj.quasi_static):
        runs = [solve(s, cycles=2, steps_per_cycle=60) for s in (whole, small)]
        assert runs[1].friction_work == pytest.approx(runs[0].friction_work, rel=1e-7)
        assert runs[1].slider_peak == pytest.approx(runs[0].slider_peak, rel=1e-7)


@pytest.mark.parametrize("varies", [0.0, 150.0, 350.0])
@pytest.mark.parametrize(
    ("solve", "given"), [(sj.quasi_static, {}), (sj.integrate, {"scheme": SCHEME})]
)
def test_a_slider_slips_by_what_its_spring_takes_of_the_limit_of_the_time(solve, given, varies):
    """The limit is least where the way has its other end: it is not that at rest."""
    run = solve(slider(varies, 0.0), cycles=2, steps_per_cycle=200, **given)
    least = MU * max(PRESSED - varies, 0.0)
    assert run.slip_peak == pytest.approx([X], rel=1e-3)
    assert run.slider_peak == pytest.approx([X - least / SPRING], rel=1e-3)


def test_a_slider_that_sticks_on_its_spring_has_no_slip():
    system = slider(0.0, 0.0)
    system = _pressed_by(system, force=np.array([10.0 * PRESSED]))
    for solve in (sj.quasi_static, sj.integrate):
        run = solve(system, cycles=2, steps_per_cycle=100)
        assert run.slip_peak == pytest.approx([X], rel=1e-3)
        assert np.array_equal(run.slider_peak, [0.0])


@pytest.mark.parametrize("model", [lambda s: s, sj.condense], ids=["full", "condensed"])
@pytest.mark.parametrize("contact", ["unilateral", "constant"])
def test_a_run_goes_on_from_the_forces_of_springs_and_their_limits(contact, model):
    """Elastic contact, whose normal forces follow from the displacement."""
    joint = {"tangential_stiffness": 2e13, "contact": contact}
    opens = contact == "unilateral"
    joint |= {"normal_stiffness": 1e14} if opens else {}
    system = replace(model(block(**joint).system(loads())), loads=())
    u = 2e-6 * np.ones(system.n)
    whole = sj.integrate(system, step=1e-7, n_steps=200, initial=(u, 0.0 * u))
    first = sj.integrate(system, step=1e-7, n_steps=120, initial=(u, 0.0 * u))
    state = *first.final, first.final_sigma, first.final_limits
    if opens:
        assert np.abs(first.final_limits / system.contact.w - 1.0).max() > 0.1
    rest = sj.integrate(system, step=1e-7, n_steps=80, initial=state if opens else state[:3])
    assert first.stored_energy[1] == rest.stored_energy[0]
    assert rest.final[0] == pytest.approx(whole.final[0], rel=1e-6, abs=1e-9 * np.abs(u).max())


def test_friction_at_the_start_needs_the_limits_that_it_is_over():
    system, still, one = slider(150.0, 0.0), np.zeros(2), np.ones(1)
    constant = replace(system, contact=system.contact.constant())
    for start, given, problem in (
        (system, (one,), "friction without its limits"),
        (system, (one, -one), r"must be \(1,\) and not negative"),
        (system, (one, still), r"must be \(1,\) and not negative"),
        (constant, (one, one), "beside constant contact"),
        (constant, (one, one, one), "or four with the limits"),
        (constant, (2.0 * one,), "above its limit"),
        (constant, (still,), "of friction"),
    ):
        with pytest.raises(sj.InputError, match=problem):
            sj.integrate(start, step=1e-3, n_steps=1, initial=(still, still, *given))
