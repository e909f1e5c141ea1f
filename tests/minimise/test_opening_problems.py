"""Step problems with contact that opens: what a solution must fulfil, on random small problems."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy import sparse

from skfem_joint.minimise import law
from skfem_joint.minimise.contact_loops import coupled_tangent, tangent_blocks
from skfem_joint.minimise.contact_newton import ContactNewton, _Forces
from skfem_joint.minimise.limits import Hinges
from skfem_joint.minimise.problem import ContactPoints, Minimum, Pressed, PressurePoints
from skfem_joint.stepping.arrangement import step_problem

#: Largest entry of the loads; errors are relative to it.
LOAD = 30.0


class Contact(NamedTuple):
    """A random problem, see `ContactPoints`, `PressurePoints` and `Pressed`."""

    H: np.ndarray
    points: ContactPoints
    N: np.ndarray
    gain: np.ndarray
    stiffness: np.ndarray
    g: np.ndarray
    bound: np.ndarray
    given: np.ndarray
    offset: np.ndarray | None = None

    def minimum(self, start: np.ndarray | None = None, factors: float = 1.0) -> Minimum:
        """Solution for the friction limits ``factors`` times those of the gain."""
        normal = PressurePoints(self.N, self.gain, self.stiffness)
        problem = step_problem(self.H, replace(self.points, normal=normal), "contact")
        pressed = Pressed(self.bound, self.given, factors)
        return problem.minimise(self.g, start, 1e-13, offset=self.offset, pressed=pressed)

    def friction(self, found: Minimum) -> np.ndarray:
        """Friction force of each point, (m, directions)."""
        return found.sigma.reshape(found.w.size, -1) * found.w[:, np.newaxis]

    def slider(self, found: Minimum) -> np.ndarray:
        """Slip of each point, (m, directions), less what a spring in series takes of it."""
        slip = np.asarray(self.points.B @ found.v)
        if self.offset is not None:
            forces = self.friction(found).ravel()
            slip = slip - self.offset - self.points.on_rows(self.points.flexible) * forces
        return slip.reshape(found.w.size, -1)


def _contact(rng, friction, directions, beta, soft, averaging, q=6):
    """Random contact of ``q`` pressure points with as many friction points."""
    count = 2 * q - 1 if averaging else q
    n = directions * q + count + 4
    R = rng.normal(size=(n, n))
    order = rng.permutation(n)
    B = np.eye(n)[order[: directions * q]]
    N = np.eye(n)[order[directions * q : directions * q + q]]
    gain = friction * np.eye(q)
    if averaging:
        W = np.zeros((q, count))
        for c in range(q):
            W[c, max(2 * c - 1, 0) : 2 * c + 2] = 0.5
            W[c, 2 * c] = 1.0
        N = (W / W.sum(axis=1, keepdims=True)) @ np.eye(n)[order[directions * q :][:count]]
        gain = friction * (0.6 * np.eye(q) + 0.2 * np.eye(q, k=1) + 0.2 * np.eye(q, k=-1))
    elastic = {"rigid": 0.0, "elastic": 1.0}.get(soft, 0.5) > rng.random(q)
    c = Contact(
        R @ R.T + 0.1 * n * np.eye(n),
        ContactPoints(sparse.csr_array(B), np.full(q, directions), np.ones(q), np.full(q, beta)),
        N,
        sparse.csr_array(gain),
        np.where(elastic, 10.0 ** rng.uniform(0.0, 3.0, q), np.inf),
        rng.uniform(-LOAD, LOAD, n),
        rng.choice([0.0, 0.05, 1.0, -0.02], q),
        rng.choice([0.0, 0.0, 1.0, -0.3], q),
    )
    if "springs" not in soft:
        return c
    flexible = rng.choice([0.0, 0.02, 0.3], q)
    if soft == "springs that share":  # two points have the same unknowns, as in an Iwan joint
        B[directions : 2 * directions] = B[:directions]
        flexible = rng.uniform(0.01, 0.3, q)
    offset = rng.normal(size=q * directions) * np.repeat(flexible > 0.0, directions)
    points = replace(c.points, B=sparse.csr_array(B), flexible=flexible)
    return c._replace(points=points, offset=offset)


def _errors(c, found):
    """Largest error of each condition: forces relative to the loads, gaps as they are."""
    slip, friction = c.slider(found), c.friction(found)
    balance = c.g - c.H @ found.v - c.points.B.T @ friction.ravel() - c.N.T @ found.p
    gap, rigid = c.bound - c.N @ found.v, np.isinf(c.stiffness)
    elastic = np.where(rigid, 1.0, c.stiffness) * np.maximum(-gap, 0.0)
    limits = np.maximum(c.given + c.gain @ found.p, 0.0)
    speed = np.linalg.norm(slip, axis=1)
    moves = speed > 1e-10
    share = law.force(speed, c.points.beta)
    along = slip[moves] / speed[moves, np.newaxis] * (limits * share)[moves, np.newaxis]
    return {
        "balance of forces": np.abs(balance).max() / LOAD,
        "penetration": np.max(-gap[rigid], initial=0.0),
        "pulling force": np.max(-found.p),
        "force at a gap": np.abs(found.p * gap)[rigid].max(initial=0.0) / LOAD,
        "elastic force": np.abs(found.p - elastic)[~rigid].max(initial=0.0) / LOAD,
        "limits": np.abs(limits - found.w).max() / LOAD,
        "cone": np.max(np.linalg.norm(friction, axis=1) - limits) / LOAD,
        "direction": np.abs(friction[moves] - along).max(initial=0.0) / LOAD,
    }


def _check(c, found):
    assert found.converged
    errors = _errors(c, found)
    assert max(errors.values()) < 1e-9, errors


@pytest.mark.parametrize("averaging", [False, True], ids=["picking", "averaging"])
@pytest.mark.parametrize("soft", ["rigid", "elastic", "both", "springs", "springs that share"])
@pytest.mark.parametrize("beta", [np.inf, 30.0], ids=["coulomb", "arctan"])
@pytest.mark.parametrize("directions", [1, 2])
def test_all_conditions_of_contact_hold_from_any_start(directions, beta, soft, averaging):
    opened = closed = slips = sticks = 0
    for seed, friction in enumerate((0.0, 0.3, 0.7, 1.0, 1.5)):
        rng = np.random.default_rng([seed, 7])
        c = _contact(rng, friction, directions, beta, soft, averaging)
        found = c.minimum()
        _check(c, found)
        for _ in range(3):
            again = c.minimum(rng.normal(size=c.g.size))
            _check(c, again)
            np.testing.assert_allclose(again.v, found.v, atol=1e-9)
        moves = np.abs(c.slider(found)) > 1e-10
        opened, closed = opened + np.sum(found.p == 0.0), closed + np.sum(found.p > 0.0)
        slips, sticks = slips + np.sum(moves), sticks + np.sum(~moves)
    # all states occur, so that no condition holds for want of a case
    assert opened
    assert closed
    assert slips
    assert sticks or np.isfinite(beta)


def _strongly_coupled(rng, friction):
    """Contact whose stiffness varies over four decades in random directions of all unknowns."""
    directions, q = int(rng.integers(1, 3)), int(rng.choice([1, 2, 5, 15]))
    n = directions * q + q
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    H = Q @ np.diag(10.0 ** rng.uniform(-3.0, 1.0, n)) @ Q.T
    beta = np.full(q, rng.choice([np.inf, 100.0]))
    stiffness = np.where(rng.random() < 0.5, np.inf, 10.0 ** rng.uniform(-2.0, 3.0, q))
    one = np.eye(n)
    rows = sparse.csr_array(one[: directions * q])
    points = ContactPoints(rows, np.full(q, directions), np.ones(q), beta)
    gain = sparse.csr_array(friction * np.eye(q))
    N, g, bound = one[directions * q :], rng.normal(size=n), rng.choice([0.0, 0.1], q)
    return Contact(0.5 * (H + H.T), points, N, gain, stiffness, LOAD * g, bound, np.zeros(q))


@pytest.mark.parametrize("friction", [0.3, 1.0, 2.0, 4.0])
def test_what_is_returned_as_converged_is_right_at_strong_coupling(friction):
    failed = 0
    for seed in range(15):
        c = _strongly_coupled(np.random.default_rng([seed, 3]), friction)
        found = c.minimum()
        if not found.converged:
            failed += 1
            assert not found.residual <= 1e-13 * LOAD
            continue
        errors = _errors(c, found)
        stiffest = np.where(np.isinf(c.stiffness), 0.0, c.stiffness).max()
        v = np.abs(found.v).max()
        # round-off of the forces of all unknowns, which reach 1e4 times the loads
        assert max(errors.values()) < 1e-9 + 1e-13 * (10.0 + stiffest) * v, (seed, errors)
    # Uniqueness ends at a friction that depends on the coupling; solutions exist at any friction.
    assert failed == 0 if friction <= 1.0 else failed <= 3


def test_point_that_slides_and_presses_is_exact():
    # Row by row: a t + c s = g_t - F, c t + b s = g_s - p with s = 0, p = g_s - c t,
    # F = friction p where the point slides forwards.
    a, b, c, friction = 2.0, 3.0, 0.5, 0.4
    H = np.array([[a, c], [c, b]])
    one, rows = np.eye(2), sparse.csr_array(np.eye(1, 2))
    points = ContactPoints(rows, np.array([1]), np.ones(1), np.array([np.inf]))
    for g_t, g_s in ((5.0, 3.0), (0.1, 1.0), (-5.0, 1.0), (1.0, -2.0)):
        problem = Contact(
            H, points, one[1:], sparse.csr_array([[friction]]), np.array([np.inf]),
            np.array([g_t, g_s]), np.zeros(1), np.zeros(1),
        )  # fmt: skip
        found = problem.minimum()
        if g_s < 0.0:  # open: a linear problem
            np.testing.assert_allclose(found.v, np.linalg.solve(H, problem.g), rtol=1e-12)
            assert found.p[0] == 0.0
            continue
        way = np.sign(g_t)
        t = max((abs(g_t) - friction * g_s) / (a - way * friction * c), 0.0) * way
        np.testing.assert_allclose(found.v, [t, 0.0], atol=1e-13)
        np.testing.assert_allclose(found.p, g_s - c * t, rtol=1e-12)


def test_without_friction_it_is_a_linear_complementarity_problem():
    rng = np.random.default_rng(4)
    c = _contact(rng, 0.0, 1, np.inf, "rigid", False)
    c = c._replace(given=np.zeros(6))
    found = c.minimum()
    # all 2^6 sets of closed points: exactly one fulfils the conditions
    fits = []
    for number in range(2**6):
        closed = np.array([bool(number >> k & 1) for k in range(6)])
        N = c.N[closed]
        whole = np.block([[c.H, N.T], [N, np.zeros((len(N), len(N)))]])
        solved = np.linalg.solve(whole, np.concatenate([c.g, c.bound[closed]]))
        v, p = solved[: c.g.size], solved[c.g.size :]
        if np.all(p >= 0.0) and np.all(c.N @ v <= c.bound + 1e-12):
            fits.append(v)
    assert len(fits) == 1
    np.testing.assert_allclose(found.v, fits[0], atol=1e-11)


def test_limits_given_and_factors_of_normal_forces_count():
    rng = np.random.default_rng(8)
    c = _contact(rng, 0.5, 1, np.inf, "rigid", False)
    halved = c.minimum(factors=0.5)
    as_gain = c._replace(gain=0.5 * c.gain).minimum()
    np.testing.assert_allclose(halved.v, as_gain.v, atol=1e-11)
    np.testing.assert_allclose(halved.w, np.maximum(c.given + 0.25 * halved.p, 0.0), atol=1e-11)


def test_stiff_contact_tends_to_rigid_contact():
    rng = np.random.default_rng(5)
    c = _contact(rng, 0.6, 2, np.inf, "rigid", True)
    rigid, errors = c.minimum(), []
    for stiffness in (1e3, 1e4, 1e5):
        v = c._replace(stiffness=np.full(6, stiffness)).minimum().v
        errors.append(np.abs(v - rigid.v).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    np.testing.assert_allclose(ratios, 10.0, rtol=0.1)


def test_loads_that_are_not_finite_do_not_converge():
    c = _contact(np.random.default_rng(6), 0.3, 1, np.inf, "rigid", False)
    g = c.g.copy()
    g[3] = np.nan
    assert not c._replace(g=g).minimum().converged


def test_tangent_is_the_derivative_of_all_forces():
    rng, q, h = np.random.default_rng(3), 6, 1e-6
    for directions, beta in ((1, np.inf), (2, np.inf), (2, 3.0)):
        c = _contact(rng, 0.7, directions, beta, "both", False)
        n, slips = (directions + 1) * q, directions * q
        H, one = c.H[:n, :n], sparse.eye_array(n, format="csr")
        gain = 0.5 * (np.eye(q) + np.eye(q, k=1))
        normal = PressurePoints(one[slips:], gain, c.stiffness)
        points = ContactPoints(
            one[:slips], c.points.directions, np.ones(q), c.points.beta,
            rng.choice([0.0, 0.2], q), normal,
        )  # fmt: skip
        hinges = Hinges(
            np.full(q, 0.5), np.full(q, 1.0), np.full(q, 3.0), np.full(q, -0.4),
            rng.choice([3.0, np.inf], q), rng.normal(size=slips),
        )  # fmt: skip
        method = ContactNewton(H, points)
        bound = rng.uniform(0.0, 0.5, q)
        contact = method.contact_of(
            None, rng.normal(size=slips), Pressed(bound, np.full(q, 0.3), 0.8, hinges)
        )
        v, g = 0.3 * rng.normal(size=n), np.full(n, 20.0)
        rigid = np.isinf(c.stiffness)
        v[slips:] = np.where(rigid, bound, bound + 0.2)

        def left(v, g=g, method=method, contact=contact):
            forces, r = _Forces(contact, v.size), g - method.H @ v
            forces.renew(v, r)
            forces.balance(v, r)
            return forces

        at = left(v)
        free = np.flatnonzero(~at.held)
        assert np.sum(at.p > 0.0) > q // 2
        blocks, J = np.zeros((method.first.size, 3)), np.zeros((free.size, free.size))
        place = np.full(n, -1)
        place[free] = np.arange(free.size)
        tangent_blocks(contact, method.stiff, v, blocks)
        coupled_tangent(H, contact, blocks, v, at.friction, at.p, at.slopes, free, place, J)
        for k, unknown in enumerate(free):
            step = h * np.eye(n)[unknown]
            known = (left(v - step).r - left(v + step).r)[free] / (2.0 * h)
            np.testing.assert_allclose(J[:, k], known, atol=1e-6 * np.abs(J).max())
