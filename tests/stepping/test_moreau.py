"""Moreau's time stepping of the tests' helper against closed forms."""

from itertools import pairwise

import numpy as np
import pytest
from moreau import Equations, march

INF, PI = np.inf, np.pi


def _equations(M, *, N=(), B=(), directions=None, load=None, **values):
    """Equations with no damping, stiffness, load and springs but those given."""
    M = np.array(M, dtype=float)
    n = len(M)
    N, B = np.reshape(N, (-1, n)).astype(float), np.reshape(B, (-1, n)).astype(float)
    directions = np.ones(len(B), dtype=np.int64) if directions is None else np.array(directions)
    q, m = len(N), directions.size
    given = {
        "C": np.zeros((n, n)), "K": np.zeros((n, n)), "gap": np.zeros(q), "force": np.zeros(q),
        "stiffness": np.full(q, INF), "given": np.zeros(m), "gain": np.zeros((m, q)),
        "beta": np.full(m, INF), "spring": np.full(m, INF),
    }  # fmt: skip
    given |= {name: np.array(value, dtype=float) for name, value in values.items()}
    load = load or (lambda t: np.zeros((t.size, n)))
    return Equations(M=M, N=N, B=B, directions=directions, load=load, **given)


def _thrown(mu, across, **values):
    """Mass of 1 kg thrown on a wall with 1 m/s, and along it."""
    n = len(across) + 1
    rows, directions = np.eye(n), [len(across)]
    e = _equations(
        np.eye(n), N=rows[-1:], gap=[1e-4], B=rows[:-1], directions=directions, gain=[[mu]],
        **values,
    )  # fmt: skip
    return march(e, 3.7e-6, 150, [np.zeros(n), np.array([*across, 1.0])])


@pytest.mark.parametrize("across", [(1.0,), (0.6, -0.8)])
def test_mass_thrown_obliquely_on_a_wall_loses_the_impulse_of_coulomb(across):
    run = _thrown(0.3, across)
    assert run.v[-1] == pytest.approx([*(0.7 * np.array(across)), 0.0], abs=1e-12)
    assert run.friction[-1] == pytest.approx(0.255, rel=1e-12)
    assert run.impacts[-1] == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize("across", [(0.1,), (0.06, 0.08)])
def test_mass_thrown_steeply_on_a_wall_sticks(across):
    run = _thrown(0.3, across)
    assert run.v[-1] == pytest.approx(np.zeros(len(across) + 1), abs=1e-12)
    assert run.friction[-1] == pytest.approx(0.005, rel=1e-12)


def test_mass_thrown_obliquely_with_the_arctangent_obeys_the_law_of_the_impulse():
    run, beta = _thrown(0.3, (1.0,), beta=[10.0]), 10.0
    v = run.v[-1, 0]
    assert 1.0 - v == pytest.approx(0.3 * 2.0 / PI * np.arctan(beta * v), rel=1e-12)


def test_spring_in_series_with_friction_takes_no_impulse():
    assert _thrown(0.3, (1.0,), spring=[1e6]).v[-1, 0] == pytest.approx(1.0, abs=1e-4)


def test_mass_bounces_off_a_spring_and_slips_on_it_by_coulomb():
    # Impulse of the spring 2 m v; it slips through: v_t loses 2 mu v.
    run = _thrown(0.3, (1.0,), stiffness=[1e8])
    assert run.v[-1] == pytest.approx([0.4, -1.0], rel=5e-3)
    assert run.friction[-1] == pytest.approx(0.5 * (1.0 - 0.4**2), rel=5e-3)


def test_block_on_a_plane_slides_until_friction_has_stopped_it():
    # v0 / (mu g) = 1/3 s, v0^2 / (2 mu g) = 1/6 m; the normal force is of its weight.
    e = _equations(
        np.diag([2.0, 2.0]), N=[[0.0, 1.0]], B=[[1.0, 0.0]], gain=[[0.3]],
        load=lambda t: np.tile([0.0, 20.0], (t.size, 1)),
    )  # fmt: skip
    run = march(e, 1e-4, 6000, [np.zeros(2), np.array([1.0, 0.0])])
    t = np.minimum(run.times, 1.0 / 3.0)
    assert np.abs(run.u[:, 0] - (t - 1.5 * t**2)).max() < 1e-4
    assert np.all(run.v[-1] == 0.0)
    assert run.friction[-1] == pytest.approx(1.0, rel=1e-9)
    assert np.abs(run.u[:, 1]).max() == 0.0


def test_slider_with_a_spring_has_the_loop_of_a_jenkins_element():
    # A heavy mass is driven as x = X sin t: 4 w (X - w / k) lost in a cycle.
    w, k, X, mass = 2.0, 100.0, 0.05, 1e6
    e = _equations(
        [[mass]], B=[[1.0]], given=[w], spring=[k],
        load=lambda t: -mass * X * np.sin(t)[:, None],
    )  # fmt: skip
    run = march(e, PI / 2e4, 80000, [np.zeros(1), np.array([X])], every=40000)
    assert np.diff(run.friction)[-1] == pytest.approx(4.0 * w * (X - w / k), rel=1e-3)


def test_mass_on_a_spring_is_damped_by_friction_in_equal_losses():
    # Amplitude falls by 4 w / k in a period, in two directions of slip as in one.
    w, k, x = 1.0, 100.0, 0.3
    for B, start in (([[1.0]], [x]), (np.eye(2), [0.6 * x, 0.8 * x])):
        n = len(start)
        e = _equations(np.eye(n), K=k * np.eye(n), B=B, directions=[n], given=[w])
        period = 2.0 * PI / 10.0
        run = march(e, period / 20000, 60000, [np.array(start), np.zeros(n)], every=20000)
        size = np.linalg.norm(run.u, axis=1)
        assert np.diff(size) == pytest.approx(-4.0 * w / k * np.ones(3), rel=1e-3)


def test_bar_bounces_off_a_wall_as_waves_say():
    # A uniform bar leaves after the wave has gone forth and back, 2 L / c, with its speed reversed.
    elements, speed = 100, 1.0  # L = c = rho A = 1
    size = 1.0 / elements
    K = elements * (
        2.0 * np.eye(elements + 1) - np.eye(elements + 1, k=1) - np.eye(elements + 1, k=-1)
    )
    K[0, 0] = K[-1, -1] = elements
    M = size * np.diag([0.5, *np.ones(elements - 1), 0.5])
    e = _equations(M, K=K, N=np.eye(elements + 1)[-1:], gap=[0.1])
    run = march(e, 1e-3, 2500, [np.zeros(elements + 1), np.full(elements + 1, speed)])
    momentum = run.v @ np.diag(M)
    touched = run.times[np.flatnonzero(np.abs(np.diff(momentum)) > 0.1 * 1e-3)]
    assert touched[-1] - touched[0] == pytest.approx(2.0, abs=0.03)
    assert speed - momentum[-1] == pytest.approx(2.0 * speed, rel=0.01)
    # The last mass stops at once: half of its kinetic energy, a share of 0.5 / elements.
    assert run.impacts[-1] == pytest.approx(0.5 * 0.5 * size * speed**2, rel=0.05)
    energy = [0.5 * v @ M @ v + 0.5 * u @ K @ u for u, v in zip(run.u, run.v, strict=True)]
    assert max(b - a for a, b in pairwise(energy)) < 1e-12
