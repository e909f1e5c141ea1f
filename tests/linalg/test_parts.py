"""Matrices that are factorised part by part: the sum of the parts is the whole."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from grid_matrices import grid
from scipy import sparse

from skfem_joint.ground.errors import InputError
from skfem_joint.linalg import parts
from skfem_joint.linalg.partition import partition
from skfem_joint.linalg.parts import BLOCK, Parts, PartwiseComplement
from skfem_joint.linalg.schur import SchurComplement

SHAPES = {
    "beam": [(6, 5, 40)],
    "two beams": [(6, 5, 20), (5, 5, 25)],
    "a beam and specks": [(6, 5, 30), (2,), (3,), (1,)],
    "cube": [(11, 11, 11)],
    "line": [(300,)],
}


def matrix_of(shape: str) -> tuple[Any, np.ndarray]:
    """Matrix of bodies that are apart, its unknowns in any order, and thirty kept ones."""
    A = sparse.csr_array(sparse.block_diag([grid(one) for one in SHAPES[shape]]))
    order = np.random.default_rng(3).permutation(A.shape[0])
    A = sparse.csr_array(A[order][:, order])
    return A, np.sort(np.random.default_rng(7).permutation(A.shape[0])[:30])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("count", [1, 2, 5])
def test_parts_meet_in_the_skeleton_alone(shape, count):
    A, kept = matrix_of(shape)
    split = partition(A, kept, count)
    every = np.concatenate([split.skeleton, *split.inner])
    np.testing.assert_array_equal(np.sort(every), np.arange(A.shape[0]))
    assert np.isin(kept, split.skeleton).all()
    for inner, border in zip(split.inner, split.border, strict=True):
        others = np.setdiff1d(np.arange(A.shape[0]), np.concatenate([inner, border]))
        assert A[inner][:, others].nnz == 0
        assert np.isin(border, split.skeleton).all()


def test_the_skeleton_of_a_beam_is_one_section_for_each_cut():
    A = grid((6, 5, 60))
    split = partition(A, np.zeros(0, dtype=np.intp), 4)
    assert len(split.inner) == 4
    assert split.skeleton.size <= 3 * 6 * 5
    sizes = [inner.size for inner in split.inner]
    assert min(sizes) > 0.8 * max(sizes)


def test_bodies_that_are_apart_are_cut_only_where_they_are_large():
    A = sparse.csr_array(sparse.block_diag([grid((4, 4, 30)), grid((4, 4, 31))]))
    assert partition(A, np.zeros(0, dtype=np.intp), 2).skeleton.size == 0
    split = partition(A, np.zeros(0, dtype=np.intp), 4)
    assert len(split.inner) == 4
    assert split.skeleton.size <= 2 * 16


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("count", [1, 3])
def test_the_sum_of_the_parts_is_the_whole(shape, count):
    A, kept = matrix_of(shape)
    whole, made = SchurComplement(A, kept), PartwiseComplement(A, kept, Parts(count))
    np.testing.assert_allclose(made.complement, whole.complement, rtol=1e-10, atol=1e-12)
    forces = np.random.default_rng(1).normal(size=(A.shape[0], 70))
    right, interior = made.restrict(forces)
    np.testing.assert_allclose(right, whole.restrict(forces)[0], rtol=1e-10, atol=1e-11)
    u = made.extend(np.linalg.solve(made.complement, right), interior)
    np.testing.assert_allclose(A @ u, forces, atol=1e-10)
    held = made.solve_held(forces[:, 0])
    assert not held[kept].any()
    np.testing.assert_allclose(np.delete(A @ held - forces[:, 0], kept), 0.0, atol=1e-10)


def test_a_pass_has_one_factor_of_each_part_and_few_right_sides(monkeypatch):
    """No factor is of the whole, and no constraint modes are made: right sides come in blocks."""
    sizes, columns = [], []
    A, kept = matrix_of("beam")
    made = PartwiseComplement(A, kept, Parts(4))

    def counted(matrix):
        solve = factorised(matrix)
        sizes.append(matrix.shape[0])

        def counting(right):
            columns.append(right.shape[1])
            return solve(right)

        return counting

    factorised = parts.factorised
    monkeypatch.setattr(parts, "factorised", counted)
    right, interior = made.restrict(np.ones((A.shape[0], 150)))
    assert sizes == [inner.size for inner in made.split.inner]
    made.extend(right, interior)
    assert sizes == 2 * [inner.size for inner in made.split.inner]
    assert max(sizes) < A.shape[0] / 3
    assert max(columns) <= BLOCK


def test_an_executor_gives_the_same_bits():
    A, kept = matrix_of("two beams")
    here = PartwiseComplement(A, kept, Parts(4))
    with ThreadPoolExecutor(2) as pool:
        there = PartwiseComplement(A, kept, Parts(4, pool))
        forces = np.random.default_rng(1).normal(size=(A.shape[0], 3))
        np.testing.assert_array_equal(here.complement, there.complement)
        np.testing.assert_array_equal(here.solve_held(forces), there.solve_held(forces))


def test_few_parts_are_under_way_at_a_time():
    """A pool of two never has more than two tasks, whose matrices may be large."""
    made = []

    def arguments():
        for k in range(6):
            made.append(k)
            yield (k,)

    with ThreadPoolExecutor(2) as pool:
        for done, result in enumerate(Parts(6, pool).each(lambda k: k, arguments())):
            assert result == done
            assert len(made) <= done + 3


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((0,), "parts: count: found 0"),
        ((2.5,), "parts: count: found 2.5"),
        ((2, "two"), "parts: executor: found str, must have a method submit"),
    ],
)
def test_parts_that_there_cannot_be(given, message):
    with pytest.raises(InputError, match=message):
        Parts(*given)


def test_nothing_is_left_inside_a_part():
    with pytest.raises(InputError, match="found 2 for 20 unknowns, of which 20 are kept"):
        PartwiseComplement(grid((20,)), np.arange(20), Parts(2))
