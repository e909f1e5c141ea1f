"""The paper's reference system: proper values of Table 1, and modes that other joints share."""

from __future__ import annotations

import numpy as np
import pytest

from skfem_joint.reduction import ReferenceModes
from skfem_joint.reference import lap_joint, modes_of_lap_joint, paper_reference, run_lap_joint

TABLE_1 = (86.55, 10.24, 1.70, 0.73, 0.29)  # percent


@pytest.fixture(scope="module")
def reference() -> ReferenceModes:
    return paper_reference(snapshots="displacement")


def test_proper_values_are_those_of_table_1(reference: ReferenceModes) -> None:
    assert reference.proper.proper_values[:5] == pytest.approx(TABLE_1, abs=0.01)


def test_two_more_percent_rules_choose_the_paper_s_number_of_modes(
    reference: ReferenceModes,
) -> None:
    # Four modes hold 99 %, and one is added (section 5): five.
    assert reference.proper.cumulative[3] > 99.0 > reference.proper.cumulative[2]
    assert reference.proper.count_for(99.0) == 5


def test_modes_are_orthonormal_on_the_nodes(reference: ReferenceModes) -> None:
    modes = reference.proper.modes
    assert np.allclose(modes.T @ modes, np.eye(100), atol=1e-12)


def test_mass_inner_product_makes_modes_mass_orthonormal() -> None:
    structure = lap_joint()
    run = run_lap_joint(structure)
    modes = modes_of_lap_joint(structure, run, inner_product="mass").proper.modes[:, :10]
    M = run.system.M
    assert np.allclose(modes.T @ (M @ modes), np.eye(10), atol=1e-10)


def test_most_of_the_joint_is_active(reference: ReferenceModes) -> None:
    # 63 kN are 90 % of the limit: 0.225 m of slip if slow, more with inertia.
    assert 0.225 < reference.active_length < 0.25
    assert reference.xi[0] < 0.0 < reference.xi[-1]


def assurance(one: ReferenceModes, other: ReferenceModes, count: int) -> np.ndarray:
    """Modal assurance criterion of modes on the unit active length."""
    xi = np.linspace(0.0, 1.0, 400)
    a, b = one.at(xi, count), other.at(xi, count)
    alike = np.einsum("ij,ij->j", a, b) ** 2
    return np.asarray(
        alike / np.einsum("ij,ij->j", a, a) / np.einsum("ij,ij->j", b, b), dtype=float
    )


def test_modes_of_another_load_and_frequency_resemble_the_reference_s(
    reference: ReferenceModes,
) -> None:
    # 28 kN at 100 Hz: half the active length, hardly any inertia (sections 4 and 5).
    structure = lap_joint()
    other = modes_of_lap_joint(
        structure, run_lap_joint(structure, 28e3, 100.0), snapshots="displacement"
    )
    assert other.active_length < 0.5 * reference.active_length
    alike = assurance(reference, other, 5)
    assert np.all(alike[:3] > [0.99, 0.97, 0.90])
    assert np.all(alike[3:] > 0.75)
    # On the bar itself, without scaling to the active length, the first already differs more.
    unscaled = (reference.proper.modes[:, 0] @ other.proper.modes[:, 0]) ** 2
    assert unscaled < alike[0]


def test_snapshots_with_velocities_span_nearly_the_same_first_mode(
    reference: ReferenceModes,
) -> None:
    both = paper_reference()
    assert both.active_length == reference.active_length
    assert assurance(reference, both, 1)[0] > 0.99
    assert both.proper.proper_values[0] < reference.proper.proper_values[0]
