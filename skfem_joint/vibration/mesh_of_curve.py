"""Error of frequency and damping over amplitude by the mesh: what halved elements change.

As for runs (:mod:`skfem_joint.accuracy.halved_mesh`), but level by level. Where a front of slip
goes from one contact point to the next the damping of a coarse mesh crosses that of a fine one, so
that one level may agree by chance: the error of a level is the root mean square of its neighbours'.
"""

from __future__ import annotations

import numpy as np

from skfem_joint.accuracy.halved_mesh import BEYOND
from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.system.system import System
from skfem_joint.vibration.backbone import Backbone, backbone

#: Levels whose ratio is less than this are neighbours.
NEAR = 1.22


def mesh_of_curve(
    curve: Backbone, finer: System, progress: Progress = silent
) -> dict[str, FloatArray]:
    """Relative errors of a full model's curve by its mesh, (levels,), at equal levels.

    They are those of "frequency" and "damping_ratio"; not a number where nothing is known.

    Parameters
    ----------
    curve : Backbone
    finer : System
        The full system on a mesh whose elements are halved.
    progress : callable, optional
        As `backbone` takes it.

    Raises
    ------
    InputError, ConvergenceError
        As `backbone`.
    """
    (other,) = backbone(finer, (curve.mode,), curve.level, progress=progress)
    return {
        name: _errors(curve.level, getattr(curve, name), getattr(other, name))
        for name in ("frequency", "damping_ratio")
    }


def _errors(level: FloatArray, coarse: FloatArray, fine: FloatArray) -> FloatArray:
    """Errors at each level, of which the finer curve may have fewer."""
    known = np.zeros(level.size, dtype=bool)
    known[: fine.size] = fine > 0.0
    square = np.zeros(level.size)
    square[known] = (coarse[known] / fine[known[: fine.size]] - 1.0) ** 2
    near = np.abs(np.log(level[:, np.newaxis] / level)) < np.log(NEAR)
    count = near @ known.astype(float)
    mean = np.divide(near @ square, count, out=np.full(level.size, np.nan), where=known)
    return np.asarray(BEYOND * np.sqrt(mean))
