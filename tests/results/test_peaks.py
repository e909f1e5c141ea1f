"""Vertices of parabolas."""

import numpy as np

from skfem_joint.results.peaks import parabola_vertex


def test_the_vertex_of_a_parabola_is_exact_for_any_three_of_its_points():
    rng = np.random.default_rng(0)
    x = np.sort(rng.normal(size=(3, 50)), axis=0)
    position, value, curvature = rng.normal(size=(3, 50))
    found = parabola_vertex(x, value + curvature * (x - position) ** 2)
    np.testing.assert_allclose(found, (position, value), rtol=1e-6, atol=1e-6)


def test_points_on_a_line_have_their_middle_one_for_a_vertex():
    x = np.array([0.0, 1.0, 3.0])
    assert parabola_vertex(x, 2.0 * x) == (1.0, 2.0)
