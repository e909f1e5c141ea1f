"""Pairs of matrices of one's own: a rigid motion of the whole must not make them slip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import sparse
from test_matrices import pairs_of

from skfem_joint.mesh import build_box, build_plate, merged
from skfem_joint.structure import Joint, Material, MatrixModel, Structure

NAMES = ("upper", "lower")
Change = Callable[[np.ndarray], None]


def matrices(dim: int, change: Change = lambda _: None) -> MatrixModel:
    """Two equal bodies on each other without supports, and the pairs of their nodes, changed."""
    how: dict[str, Any] = {"free": True, "joints": [Joint("upper", 1e6, 0.3, "lower")]}
    if dim == 2:
        made = [build_plate([(name, 0.1, 4)], 0.05, 2, prefix=f"{name} ") for name in NAMES]
        how["thickness"] = 0.01
    else:
        made = [
            build_box([(f"{name} body", 0.1, 4)], (0.05, 0.01), (2, 1), origin=(0.0, 0.0, z),
                      boundaries={name: side}, prefix=f"{name} ")
            for name, z, side in (("upper", 0.01, "front"), ("lower", 0.0, "back"))
        ]  # fmt: skip
    structure = Structure(merged(made), Material(2e11, 8e3, 0.3), **how)
    M, K = structure.matrices()
    contacts = pairs_of(structure)
    change(contacts["upper"])
    return MatrixModel(M, K, contacts=contacts, joints=[Joint("upper", 1e6, 0.3)])


def on_a_rigid_base(rows: np.ndarray) -> None:
    rows[:, 3:6] = np.nan


def swapped(rows: np.ndarray) -> None:
    rows[4, [3, 4]] = rows[4, [4, 3]]


def elsewhere(rows: np.ndarray) -> None:
    rows[[4, 5], 3:6] = rows[[5, 4], 3:6]


@pytest.mark.parametrize("dim", [2, 3])
def test_pairs_that_lie_on_each_other_raise_no_doubt(dim):
    """Nor do those on a rigid base, and of bodies that are held already: nothing tells there."""
    some = matrices(dim)
    spring = sparse.coo_array(([some.K.diagonal().max()], ([0], [0])), shape=some.K.shape)
    for one in (some, matrices(dim, on_a_rigid_base), replace(some, K=some.K + spring)):
        assert one.unusual(one.system()) == []


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("change", [swapped, elsewhere])
def test_a_pair_that_slips_as_all_moves_rigidly_is_told(dim, change):
    some = matrices(dim, change)
    (found,) = some.unusual(some.system())
    assert "pair 5 of contact.upper slips" in found or "pair 6 of contact.upper slips" in found
