"""An elastic slider whose normal load varies in time, and solids of such sliders."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.slider import (
    HOLDS,
    LIFTS,
    MASS,
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
from skfem_joint.system.normal import NormalPart

SCHEME = sj.generalized_alpha(0.5)
#: Unknowns that are neither slips nor approaches.
TURNED = np.array([[0.8, -0.6], [0.6, 0.8]])


def _pressed_by(system, **values):
    """System with other values of its pressure points."""
    normal = replace(system.contact.normal, **values)
    return replace(system, contact=replace(system.contact, normal=normal))


def test_the_loop_of_a_slider_under_a_load_in_phase_is_that_of_its_closed_form():
    """The error of the energy falls with the square of the increment."""
    system, errors = slider(150.0, 0.0), []
    for steps in (50, 100, 200):
        run = sj.quasi_static(system, cycles=3, steps_per_cycle=steps)
        errors.append(abs(run.cycles.friction[-1] / loop_energy(150.0) - 1.0))
        assert run.energy_residual < 1e-9
    assert errors[2] < 1e-3
    assert 10.0 * errors[2] < errors[0]  # 16 but for where in an increment the slider turns


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


def test_vibration_that_is_slow_has_the_loop_of_the_closed_form():
    run = sj.integrate(slider(150.0, 0.0), cycles=2, steps_per_cycle=400, scheme=SCHEME)
    assert run.cycles.friction[-1] == pytest.approx(loop_energy(150.0), rel=5e-3)
    assert run.energy_residual < 1e-9
    stiff = sj.integrate(slider(150.0, 0.0, 1e9), cycles=2, steps_per_cycle=400, scheme=SCHEME)
    rigid = sj.integrate(slider(150.0, 0.0, np.inf), cycles=2, steps_per_cycle=400, scheme=SCHEME)
    assert stiff.cycles.friction[-1] == pytest.approx(rigid.cycles.friction[-1], rel=1e-3)


@pytest.mark.parametrize(
    ("solve", "options"), [(sj.quasi_static, {}), (sj.integrate, {"scheme": SCHEME})]
)
def test_a_slider_in_unknowns_that_are_no_slips_has_the_loop_of_its_closed_form(solve, options):
    """Elastic contact carries the share of the normal load that its stiffness has."""
    system, stiffness, turned = slider(150.0, 0.0), 4.0 * LIFTS, np.array([[0.8, -0.6], [0.6, 0.8]])
    contact = replace(system.contact.normal, stiffness=np.full(1, stiffness))
    small, errors = system.with_contact(normal=contact).project(turned), []
    assert arranged(small).kind == "dense"
    for steps in (50, 100, 200):
        run = solve(small, cycles=2, steps_per_cycle=steps, **options)
        errors.append(abs(run.cycles.friction[-1] / loop_energy(0.8 * 150.0) - 1.0))
        assert run.energy_residual < 1e-9
    assert errors[2] < 2e-3
    assert 8.0 * errors[2] < errors[0]


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


def test_a_constant_normal_force_gives_the_slider_of_constant_contact():
    opens = slider(0.0, 0.0)
    B, one = sparse.csr_array([[1.0]]), sparse.csr_array([[1.0]])
    load = sj.AppliedLoad(np.ones(1), sj.Harmonic(HOLDS * X, 1.0), "along")
    rubs = sj.Contact(B, opens.contact.w, np.inf, stiffness=opens.contact.stiffness)
    matrices = MASS * one, 1e-3 * MASS * one, HOLDS * one
    constant = sj.System(*matrices, rubs, loads=[load], P=one, points=("along",))
    for solve in (sj.integrate, sj.quasi_static):
        run, other = (solve(s, cycles=2, steps_per_cycle=100) for s in (opens, constant))
        assert run.cycles.friction == pytest.approx(other.cycles.friction, rel=1e-9)
        assert run.stored_energy[1] == pytest.approx(other.stored_energy[1], rel=1e-9)
        assert run.final_sigma == pytest.approx(other.final_sigma, abs=1e-9)


def test_the_backbone_of_a_slider_is_that_of_its_loop():
    """Unit mass on a slider of constant normal load: 4 w (x - w / k) lost in a cycle."""
    contact = NormalPart(
        sparse.csr_array([[0.0, 1.0]]), np.zeros(1), np.array([PRESSED]), np.full(1, np.inf),
        np.ones(1),
    )  # fmt: skip
    K, M = sparse.diags_array([1e6, 1e6]).tocsr(), sparse.eye_array(2, format="csr")
    B, w, gain = sparse.csr_array([[1.0, 0.0]]), MU * PRESSED, sparse.csr_array([[MU]])
    spring = np.full(1, SPRING)
    rubs = sj.Contact(B, [0.0], np.inf, stiffness=spring, normal=contact, gain=gain)
    system = sj.System(M, None, K, rubs)
    (curve,) = sj.backbone(system, levels=4, slips_at=600.0, up_to=2.0)
    x = (curve.level - np.minimum(curve.level * SPRING / (1e6 + SPRING), w)) / 1e6
    assert curve.amplitude == pytest.approx(x, rel=1e-6)
    lost = 4.0 * w * np.maximum(x - w / SPRING, 0.0)
    damping = lost / (2.0 * np.pi * curve.level * x)
    assert curve.friction_damping == pytest.approx(damping, rel=5e-3, abs=1e-9)
    assert curve.state[0] == "stick"
    assert system.contact.constant().sprung.all()


def test_steady_vibration_of_a_slider_has_the_loop_of_its_closed_form():
    run = sj.integrate(slider(150.0, 0.0), steps_per_cycle=400, until="steady", scheme=SCHEME)
    assert run.cycles.friction[-1] == pytest.approx(loop_energy(150.0), rel=5e-3)
    assert run.energy_residual < 1e-9
    assert run.stored_energy[1] == pytest.approx(run.stored_energy[0], rel=1e-6)


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
    strong = replace(system.contact.normal, force=np.array([10.0 * PRESSED]))
    system = system.with_contact(normal=strong)
    for solve in (sj.quasi_static, sj.integrate):
        run = solve(system, cycles=2, steps_per_cycle=100)
        assert run.slip_peak == pytest.approx([X], rel=1e-3)
        assert np.array_equal(run.slider_peak, [0.0])


@pytest.mark.parametrize("model", [lambda s: s, sj.condense], ids=["full", "condensed"])
def test_a_run_goes_on_from_the_forces_of_springs_and_their_limits(model):
    """Elastic contact, whose normal forces follow from the displacement."""
    joint = {"tangential_stiffness": 2e13, "normal_stiffness": 1e14}
    system = replace(model(block(**joint).system(loads())), loads=())
    u = 2e-6 * np.ones(system.n)
    whole = sj.integrate(system, step=1e-7, n_steps=200, initial=(u, 0.0 * u))
    first = sj.integrate(system, step=1e-7, n_steps=120, initial=(u, 0.0 * u))
    assert np.abs(first.final_limits / system.contact.w - 1.0).max() > 0.1
    state = *first.final, first.final_sigma, first.final_limits
    rest = sj.integrate(system, step=1e-7, n_steps=80, initial=state)
    assert first.stored_energy[1] == rest.stored_energy[0]
    assert rest.final[0] == pytest.approx(whole.final[0], rel=1e-6, abs=1e-9 * np.abs(u).max())


def test_friction_at_the_start_needs_the_limits_that_it_is_over():
    system = slider(150.0, 0.0)
    still, one = np.zeros(2), np.ones(1)
    plan = {"step": 1e-3, "n_steps": 1}
    with pytest.raises(sj.InputError, match="friction without its limits"):
        sj.integrate(system, **plan, initial=(still, still, one))
    for wrong in (-one, still):
        with pytest.raises(sj.InputError, match=r"must be \(1,\) and not negative"):
            sj.integrate(system, **plan, initial=(still, still, one, wrong))
    constant = replace(system, contact=system.contact.constant())
    with pytest.raises(sj.InputError, match="beside constant contact"):
        sj.integrate(constant, **plan, initial=(still, still, one, one))
    with pytest.raises(sj.InputError, match="or four with the limits"):
        sj.integrate(constant, **plan, initial=(still, still, one, one, one))
