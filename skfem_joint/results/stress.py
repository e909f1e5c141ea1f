"""Stress of a run over its stored times, and its peak."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError, listed
from skfem_joint.results.contact_history import check_fields, displacements
from skfem_joint.stepping.recording import Run
from skfem_joint.structure.structure import Structure


@dataclass(frozen=True)
class StressHistory:
    """Elastic stress in elements of a structure over the stored times of a run.

    Attributes
    ----------
    times : ndarray, shape (frames,)
        Stored times, s.
    elements : ndarray of int, shape (k,)
        Numbers of the elements in the mesh.
    stress : ndarray, shape (frames, k, 6)
        Mean of each element, Pa: XX, YY, ZZ, XY, YZ and XZ in space.
    """

    times: FloatArray
    elements: IntArray
    stress: FloatArray

    @property
    def von_mises(self) -> FloatArray:
        """Von Mises stress, Pa, shape (frames, k)."""
        return von_mises(self.stress)

    @property
    def peak(self) -> float:
        """Largest von Mises stress at a stored time, Pa."""
        return float(self.von_mises.max())

    @property
    def peak_time(self) -> float:
        """Stored time at which `peak` occurs first, s."""
        return float(self.times[self.von_mises.max(axis=1).argmax()])

    @property
    def peak_element(self) -> int:
        """Number of the element in which `peak` occurs."""
        return int(self.elements[self.von_mises.max(axis=0).argmax()])


def stress_history(structure: Structure, run: Run, region: str | None = None) -> StressHistory:
    """Elastic stress of a run over its stored times, in all elements or in those of a region.

    It is the stress of the run's displacement; that of the clamping before the run is not added.

    Parameters
    ----------
    structure : Structure
        From which the run's system, full or reduced, was made.
    run : Run
        With stored fields, ``save=Save(fields=True)``.
    region : str, optional
        Named region of the mesh; all elements if not given.

    Returns
    -------
    StressHistory
        Its ``peak`` is the largest von Mises stress in Pa.

    Raises
    ------
    InputError
        If the run stored no fields, was not made from this structure, or the mesh has no such
        region.
    """
    check_fields(run)
    regions = structure.mesh.regions
    if region is not None and region not in regions:
        raise InputError(f"region: found {region!r}, must be one of {listed(regions)}")
    elements = np.arange(structure.mesh.n_elements) if region is None else np.sort(regions[region])
    stress = [structure.stress(u)[elements] for u in displacements(structure, run)[0]]
    return StressHistory(run.field_times, elements.astype(np.intp), np.array(stress))


def von_mises(stress: FloatArray) -> FloatArray:
    """Von Mises stress, (...), from XX, YY, ZZ, XY, YZ and XZ, (..., 6), Pa."""
    xx, yy, zz = np.moveaxis(stress[..., :3], -1, 0)
    distortion = 0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2)
    return np.asarray(np.sqrt(distortion + 3.0 * np.sum(stress[..., 3:] ** 2, axis=-1)))
