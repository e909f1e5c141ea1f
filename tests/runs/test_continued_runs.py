"""A run that goes on from another one is the run that had no end between them."""

from dataclasses import replace

import numpy as np
import pytest
from opening_blocks import block

import skfem_joint as sj

FREQUENCY, STEPS = 2000.0, 100
STEP = 1.0 / FREQUENCY / STEPS
HALF = 3 * STEPS // 2  # after which the loads have turned round
CONSTANT = {"contact": "constant"}
KINDS = {
    "rigid": CONSTANT,
    "springs": CONSTANT | {"tangential_stiffness": 1e13},
    "opens": {},
    "opens, elastic": {"normal_stiffness": 1e14},
    "opens, springs": {"tangential_stiffness": 1e13},
    "opens, both": {"tangential_stiffness": 1e13, "normal_stiffness": 1e14},
}
MODELS = {
    "full": lambda system: system,
    "condensed": lambda system: sj.condense(system, 6),
    "reduced": lambda system: sj.reduce(system, 8),
}


def system_of(joint, phase=0.0, model="full"):
    """Block that its loads slide on its base and lift off it in part."""
    load = sj.Load("left", sj.Harmonic(40e3, FREQUENCY), direction=(1.0, 0.5))
    system = MODELS[model](block(pressure=20e6, **joint).system([load]))
    return with_loads(system, sj.Harmonic(40e3, FREQUENCY, phase))


def with_loads(system, amplitude):
    return replace(system, loads=tuple(replace(x, amplitude=amplitude) for x in system.loads))


def same(rest, whole, share=1e-11):
    """The second half of a run, and all that was summed up or counted in it."""
    peak = np.abs(whole.point_u).max()
    np.testing.assert_allclose(rest.point_u, whole.point_u[HALF:], atol=share * peak)
    for name in ("final_sigma", "final_limits"):
        found, right = getattr(rest, name), getattr(whole, name)
        np.testing.assert_allclose(found, right, atol=1e3 * share * np.abs(right).max())


#: Springs beside contact that opens have no reduced model.
CASES = [
    (model, kind, 1.0)
    for model in MODELS
    for kind in KINDS
    if model != "reduced" or kind not in ("opens, springs", "opens, both")
]
CASES += [("full", "springs", 0.7), ("condensed", "opens, both", 0.7), ("reduced", "opens", 0.7)]


@pytest.mark.parametrize(("model", "kind", "rho"), CASES)
def test_a_continued_run_is_the_uninterrupted_one(model, kind, rho):
    joint = KINDS[kind]
    system, scheme = system_of(joint, model=model), sj.generalized_alpha(rho)
    plan = {"step": STEP, "scheme": scheme}
    whole = sj.integrate(system, n_steps=2 * HALF, **plan)
    first = sj.integrate(system, n_steps=HALF, **plan)
    rest = sj.integrate(with_loads(system, sj.Harmonic(40e3, FREQUENCY, np.pi)), n_steps=HALF,
                        initial=first, **plan)  # fmt: skip
    same(rest, whole)
    work = whole.friction_work.sum() - first.friction_work.sum()
    assert rest.friction_work.sum() == pytest.approx(work, rel=1e-9)
    assert rest.stored_energy == pytest.approx(
        (first.stored_energy[1], whole.stored_energy[1]), rel=1e-9
    )
    assert rest.energy_residual < 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_whose_loads_end_goes_on_as_after_their_jump(kind):
    """As a run whose load jumps to zero in its middle, with a shorter step from there."""
    system, end = system_of(KINDS[kind]), HALF * STEP
    force = 20e3
    pulse = with_loads(system, sj.Rectangle(force, end))
    step, n = STEP / 4, 4 * HALF
    whole = sj.integrate(pulse, step=step, n_steps=2 * n)
    first = sj.integrate(pulse, step=step, n_steps=n)
    rest = sj.integrate(replace(system, loads=()), step=step, n_steps=n, initial=first)
    peak = np.abs(whole.point_u).max()
    after = whole.point_u[n:]
    np.testing.assert_allclose(rest.point_u, after, atol=1e-9 * peak)
    assert rest.energy_residual < 1e-9


def test_a_run_of_elastic_contact_in_few_unknowns_keeps_its_energy_after_a_jump():
    """Where it starts anew points have the friction of their law once."""
    system = system_of({}, model="reduced")
    first = sj.integrate(system, step=STEP, n_steps=HALF)
    assert sj.integrate(system, step=STEP, n_steps=5, initial=first.end).energy_residual < 1e-9


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "rigid"])
def test_a_state_that_lacks_forces_is_refused(kind):
    system = system_of(KINDS[kind])
    run = sj.integrate(system, step=STEP, n_steps=3)
    with pytest.raises(sj.InputError, match=r"run\.final.*give the run itself, initial=run"):
        sj.integrate(system, step=STEP, n_steps=1, initial=run.final)
    plain = sj.integrate(system, step=STEP, n_steps=1, initial=(0.0 * run.final[0], run.final[1]))
    assert plain.start is not None  # displacement and velocity, with springs without force
    other = system_of(KINDS[kind], model="condensed")
    with pytest.raises(sj.InputError, match="initial: shapes must be"):
        sj.integrate(other, step=STEP, n_steps=1, initial=run)


def test_a_ring_down_starts_from_a_run():
    system = system_of(KINDS["springs"])
    first = sj.integrate(system, step=STEP, n_steps=HALF)
    (curve,) = sj.backbone(system, levels=2)
    a, b = (sj.ring_down(system, curve, 8, 50, start=start) for start in (first, first.end))
    np.testing.assert_array_equal(a.amplitude, b.amplitude)


def test_a_run_of_another_reduced_model_is_refused():
    """Coordinates of modes mean other displacements in another model of as many unknowns."""
    structure, load = block(pressure=20e6, **CONSTANT), sj.Harmonic(40e3, FREQUENCY)
    one, two = (
        sj.reduce(structure.system([sj.Load("left", load, along)]), 4, interface_modes=4)
        for along in ((1.0, 0.5), (1.0, -0.5))
    )
    assert one.n == two.n
    run = sj.integrate(one, step=STEP, n_steps=20)
    with pytest.raises(sj.InputError, match="unknowns stand for other displacements"):
        sj.integrate(two, step=STEP, n_steps=20, initial=run)
    sj.integrate(replace(one, notes=()), step=STEP, n_steps=20, initial=run)
