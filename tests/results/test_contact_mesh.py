"""How many contact points share the work of friction."""

import numpy as np
import pytest
from joint_scenes import plate_scene

from skfem_joint.results.contact_mesh import sharing_points


@pytest.mark.parametrize("slipping", [0, 1, 5])
def test_points_that_do_the_same_work_share_it(slipping):
    """Points at rest do none, and one with a hundredth of the work hardly counts."""
    scene = plate_scene()
    system = scene.system()
    contact, B = system.contact, system.contact.B.toarray()
    points = np.flatnonzero(contact.w > 0.0)
    by_point = np.zeros(contact.w.size)
    by_point[points[:slipping]] = 1e-6 / contact.w[points[:slipping]]
    u = np.asarray(np.linalg.lstsq(B, contact.on_rows(by_point))[0])
    assert sharing_points(system, points, u) == pytest.approx(slipping)
    if slipping:
        by_point[points[slipping]] = 1e-8 / contact.w[points[slipping]]
        u = np.asarray(np.linalg.lstsq(B, contact.on_rows(by_point))[0])
        assert slipping < sharing_points(system, points, u) < slipping + 0.03
