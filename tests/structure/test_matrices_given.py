"""Matrices of one's own: what no structure has is refused in a sentence, nothing is made real."""

from typing import Any

import numpy as np
import pytest
from scipy import sparse

import skfem_joint as sj

N = 5
K = 2.0 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
END = np.eye(N)[-1]
ROW = np.eye(N)[0] - np.eye(N)[1]
PAIR = np.array([[0, np.nan, np.nan, 1, np.nan, np.nan, 0, 0, 1, 1]])
FORCE = sj.Harmonic(1.0, 0.1)
LOSS = 1.0 + 0.1j
FORMS = [np.array, sparse.csr_array, sparse.coo_array]


def system_of(M: Any = None, K: Any = K, C: Any = None, **others: Any) -> sj.System:
    given = {"contact": sj.point_friction(ROW, 1.0), "loads": {"end": (END, FORCE)}} | others
    return sj.System.from_matrices(np.eye(N) if M is None else M, K, C, **given)


@pytest.mark.parametrize("name", ["M", "K", "C"])
@pytest.mark.parametrize("form", FORMS)
def test_complex_matrices_are_refused_and_never_made_real(name, form):
    with pytest.raises(sj.InputError, match=rf"^{name}: found complex128 values, must be real"):
        system_of(**{name: form(K * LOSS)})
    with pytest.raises(sj.InputError, match=rf"^{name}: found complex128 values, must be real"):
        sj.MatrixModel(**({"M": np.eye(N), "K": K} | {name: form(K * LOSS)}))


LAP = sj.Joint("lap", pressure=1.0, friction=0.3)
SEEN = sj.MatrixModel(np.eye(N), K, points={"end": END * LOSS})


@pytest.mark.parametrize(
    ("make", "where"),
    [
        (lambda: system_of(loads={"end": (END * LOSS, FORCE)}), "load 'end'"),
        (lambda: system_of(points={"seen": END * LOSS}), "point 'seen'"),
        (lambda: sj.point_friction(ROW * LOSS, 1.0), "point_friction: row"),
        (lambda: sj.point_friction(ROW, LOSS), "point_friction: limit"),
        (lambda: sj.Table([0.0, 1.0], [LOSS, 0.0]), "forces"),
        (lambda: sj.integrate(system_of(), step=0.1, n_steps=1, initial=(LOSS * END, END)),
         "initial"),
        (lambda: sj.MatrixModel(np.eye(N), K, contacts={"lap": PAIR * LOSS}, joints=[LAP]),
         "contact.lap"),
        (lambda: SEEN.system([sj.Load("end", FORCE)]), "load on 'end'"),
    ],
)  # fmt: skip
def test_complex_values_are_refused_everywhere(make, where):
    with pytest.raises(sj.InputError, match=rf"^{where}: found .*must be "):
        make()


KINDS = [np.float16, np.float32, np.int8, np.uint16, np.longdouble]


@pytest.mark.parametrize(
    ("form", "kind"),
    [(np.array, kind) for kind in KINDS] + [(sparse.csr_array, kind) for kind in KINDS[1:]],
)
def test_real_numbers_of_any_precision_are_taken_as_doubles(form, kind):
    whole = 4 * np.eye(N, dtype=kind)
    one, other = system_of(K=form(whole)), system_of(K=4.0 * np.eye(N))
    assert one.K.dtype == np.float64
    assert (one.K != other.K).nnz == 0


def rank_one(vector: Any) -> Any:
    return np.outer(vector, vector)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    "C",
    [
        -0.01 * K,
        np.diag([1.0, 1.0, 1.0, 1.0, -1e-3]),
        np.eye(N, k=1) + np.eye(N, k=-1),  # nothing on its diagonal
        K - 0.3 * np.eye(N),  # one eigenvalue below zero, a positive diagonal
    ],
)
def test_damping_that_would_create_energy_is_refused(C, form):
    with pytest.raises(sj.InputError, match=r"^C: is negative somewhere.*create energy"):
        system_of(C=form(C))
    with pytest.raises(sj.InputError, match=r"^C: is negative somewhere.*create energy"):
        sj.MatrixModel(np.eye(N), K, form(C))


@pytest.mark.parametrize("form", FORMS[1:])
def test_rows_may_be_sparse(form):
    row, end = form(ROW[np.newaxis]), form(END[np.newaxis])
    given = {"loads": {"end": (end, FORCE)}, "points": {"seen": row}}
    found = system_of(contact=sj.point_friction(row, 1.0), **given)
    dense = system_of(points={"seen": ROW})
    for A, B in ((found.K, dense.K), (found.P, dense.P), (found.contact.B, dense.contact.B)):
        np.testing.assert_array_equal(A.toarray(), B.toarray())


@pytest.mark.parametrize("seed", range(5))
def test_damping_that_takes_energy_is_taken_though_round_off_makes_it_negative(seed):
    """Single dashpots and dampings of few modes have no full rank, in any units."""
    rng = np.random.default_rng(seed)
    few = rng.normal(size=(N, 2)) * 10.0 ** rng.uniform(-6.0, 6.0, size=(N, 1))
    for C in (rank_one(ROW), rank_one(END), few @ few.T, 0.0 * K, K * 1e-9, np.diag(END)):
        assert system_of(C=C).n == N
        assert np.linalg.eigvalsh(C).max() >= 0.0


@pytest.mark.parametrize("name", ["M", "K", "C"])
def test_matrices_that_say_they_are_huge_take_no_memory(name):
    huge = sparse.coo_array(([1.0], ([0], [0])), shape=(10**12, 10**12))
    with pytest.raises(sj.InputError, match=r"found shape \(\d+, \d+\), must be"):
        system_of(**{name: huge})
    with pytest.raises(sj.InputError, match=r"^M: .*found 1 entries, for 1000000000000 unknowns"):
        sj.MatrixModel(huge, huge)
