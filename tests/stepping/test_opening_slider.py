"""An elastic slider whose normal load varies in time, and solids of such sliders."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

import skfem_joint as sj
from skfem_joint.opening import OpeningContact

SPRING, X, MU, PRESSED = 2e5, 1e-3, 0.4, 250.0  # N/m, m, -, N
SCHEME = sj.generalized_alpha(0.5)
HOLDS, LIFTS, MASS = 1e10, 1e3, 1e-3  # N/m of what prescribes the slip; of what holds apart; kg


def slider(varies: float, phase: float, spring: float = SPRING) -> sj.System:
    """Point driven by X sin(2 pi t) whose normal load is PRESSED + varies sin(2 pi t + phase)."""
    contact = OpeningContact(
        sparse.csr_array([[0.0, 1.0]]), np.zeros(1), np.array([PRESSED]),
        sparse.csr_array([[MU]]), np.full(1, np.inf), np.ones(1),
    )  # fmt: skip
    K, M = sparse.diags_array([HOLDS, LIFTS]).tocsr(), MASS * sparse.eye_array(2, format="csr")
    loads = [
        sj.AppliedLoad(np.array([1.0, 0.0]), sj.Harmonic(HOLDS * X, 1.0), "along"),
        sj.AppliedLoad(np.array([0.0, 1.0]), sj.Harmonic(varies, 1.0, phase), "across"),
    ]
    B, w = sparse.csr_array([[1.0, 0.0]]), np.array([MU * PRESSED])
    return sj.System(
        M, 1e-3 * M, K, B, w, np.inf, stiffness=np.array([spring]), loads=loads,
        P=sparse.csr_array(np.eye(2)), points=("along", "across"), opening=contact,
    )  # fmt: skip


def loop_energy(varies: float) -> float:
    """Of a cycle with slip and normal load in phase, J: the slider turns where its way does.

    With s = sin(2 pi t) the force rises by SPRING X s until it is MU (PRESSED + varies s), and
    falls so until it is the opposite of that.
    """
    k, n, a = SPRING * X, MU * PRESSED, MU * varies
    up, down = (2.0 * n - a - k) / (k - a), (k - 2.0 * n - a) / (k + a)
    low, high = -(n - a), n + a

    def sliding(s: float) -> float:  # integral of the limit
        return n * s + 0.5 * a * s**2

    rising = low * (up + 1.0) + 0.5 * k * (up + 1.0) ** 2 + sliding(1.0) - sliding(up)
    falling = high * (1.0 - down) - 0.5 * k * (1.0 - down) ** 2 - (sliding(down) - sliding(-1.0))
    return X * (rising - falling)


def followed(varies: float, phase: float, cycles: int, steps: int, fine: int = 50) -> np.ndarray:
    """Force of the slider at each step, N: its increments, cut to the limits of the time."""
    turns = 2.0 * np.pi * np.linspace(0.0, cycles, cycles * steps * fine + 1)
    limit = MU * np.maximum(PRESSED + varies * np.sin(turns + phase), 0.0)
    force = np.zeros(turns.size)
    ways = SPRING * np.diff(X * np.sin(turns))
    for j, way in enumerate(ways, 1):
        force[j] = min(max(force[j - 1] + way, -limit[j]), limit[j])
    return force[::fine]


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
    known = followed(varies, phase, 2, steps)
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


def test_a_constant_normal_force_gives_the_slider_of_constant_contact():
    opens = slider(0.0, 0.0)
    B, one = sparse.csr_array([[1.0]]), sparse.csr_array([[1.0]])
    load = sj.AppliedLoad(np.ones(1), sj.Harmonic(HOLDS * X, 1.0), "along")
    constant = sj.System(
        MASS * one, 1e-3 * MASS * one, HOLDS * one, B, opens.w, np.inf,
        stiffness=opens.stiffness, loads=[load], P=one, points=("along",),
    )  # fmt: skip
    for solve in (sj.integrate, sj.quasi_static):
        run, other = (solve(s, cycles=2, steps_per_cycle=100) for s in (opens, constant))
        assert run.cycles.friction == pytest.approx(other.cycles.friction, rel=1e-9)
        assert run.stored_energy[1] == pytest.approx(other.stored_energy[1], rel=1e-9)
        assert run.final_sigma == pytest.approx(other.final_sigma, abs=1e-9)


def test_the_backbone_of_a_slider_is_that_of_its_loop():
    """Unit mass on a slider of constant normal load: 4 w (x - w / k) lost in a cycle."""
    contact = OpeningContact(
        sparse.csr_array([[0.0, 1.0]]), np.zeros(1), np.array([PRESSED]),
        sparse.csr_array([[MU]]), np.full(1, np.inf), np.ones(1),
    )  # fmt: skip
    K, M = sparse.diags_array([1e6, 1e6]).tocsr(), sparse.eye_array(2, format="csr")
    B, w = sparse.csr_array([[1.0, 0.0]]), np.array([MU * PRESSED])
    system = sj.System(M, None, K, B, w, np.inf, stiffness=np.full(1, SPRING), opening=contact)
    (curve,) = sj.backbone(system, levels=4, slips_at=600.0, up_to=2.0)
    x = (curve.level - np.minimum(curve.level * SPRING / (1e6 + SPRING), w)) / 1e6
    assert curve.amplitude == pytest.approx(x, rel=1e-6)
    lost = 4.0 * w * np.maximum(x - w / SPRING, 0.0)
    damping = lost / (2.0 * np.pi * curve.level * x)
    assert curve.friction_damping == pytest.approx(damping, rel=5e-3, abs=1e-9)
    assert curve.state[0] == "stick"
    assert replace(system, opening=None).sprung.all()


def test_steady_vibration_of_a_slider_has_the_loop_of_its_closed_form():
    run = sj.integrate(slider(150.0, 0.0), steps_per_cycle=400, until="steady", scheme=SCHEME)
    assert run.cycles.friction[-1] == pytest.approx(loop_energy(150.0), rel=5e-3)
    assert run.energy_residual < 1e-9
    assert run.stored_energy[1] == pytest.approx(run.stored_energy[0], rel=1e-6)
