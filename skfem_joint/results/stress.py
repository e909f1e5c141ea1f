"""Stress of a run over its stored times: of vibration, of the preload, and of both together."""

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
        Mean of each element, Pa: XX, YY, ZZ, XY, YZ and XZ in space. It is that of the vibration
        alone, without the preload.
    preload : ndarray, shape (k, 6)
        The same at rest, by the clamp forces of bolts alone; zero without them.
    """

    times: FloatArray
    elements: IntArray
    stress: FloatArray
    preload: FloatArray

    @property
    def von_mises(self) -> FloatArray:
        """Von Mises stress of the vibration alone, Pa, shape (frames, k)."""
        return von_mises(self.stress)

    @property
    def peak(self) -> float:
        """Largest von Mises stress of the vibration alone at a stored time, Pa."""
        return float(self.von_mises.max())

    @property
    def peak_time(self) -> float:
        """Stored time at which `peak` occurs first, s."""
        return float(self.times[self.von_mises.max(axis=1).argmax()])

    @property
    def peak_element(self) -> int:
        """Number of the element in which `peak` occurs."""
        return int(self.elements[self.von_mises.max(axis=0).argmax()])

    @property
    def total(self) -> FloatArray:
        """Stress of preload and vibration together, Pa, shape (frames, k, 6)."""
        return self.preload + self.stress

    def cycle(self, period: float) -> StressCycle:
        """Mean and range of each component in the last ``period`` (s) of the run, for fatigue.

        Raises
        ------
        InputError
            If less than a period is stored, or fewer than 8 times of it.
        """
        late = self.times >= self.times[-1] - period * (1.0 + 1e-9)
        stored = float(self.times[-1] - self.times[0])
        if not 0.0 < period <= stored * (1.0 + 1e-9) or np.count_nonzero(late) < 9:
            raise InputError(
                f"period: found {period:g} s, in which {np.count_nonzero(late)} times are stored, "
                f"must be at most the {stored:g} s that are stored, with at least 9 times in it; "
                "store more fields by save=Save(fields=True, every=...), or integrate longer"
            )
        low, high = self.stress[late].min(axis=0), self.stress[late].max(axis=0)
        return StressCycle(self.elements, self.preload + 0.5 * (low + high), high - low)


@dataclass(frozen=True)
class StressCycle:
    """Mean and range of the stress of a cycle, component by component.

    Where all components follow the load in phase, as in one mode, `amplitude` is that of the von
    Mises stress of the alternating part; otherwise it is an upper bound of it.

    Attributes
    ----------
    elements : ndarray of int, shape (k,)
        Numbers of the elements in the mesh.
    mean : ndarray, shape (k, 6)
        Middle between least and largest value of each component, preload included, Pa.
    range : ndarray, shape (k, 6)
        Largest less least value, Pa.
    """

    elements: IntArray
    mean: FloatArray
    range: FloatArray

    @property
    def amplitude(self) -> FloatArray:
        """Von Mises stress of half of the range, Pa, shape (k,)."""
        return von_mises(0.5 * self.range)

    @property
    def worst(self) -> int:
        """Number of the element with the largest `amplitude`."""
        return int(self.elements[self.amplitude.argmax()])


def stress_history(structure: Structure, run: Run, region: str | None = None) -> StressHistory:
    """Elastic stress of a run over its stored times, in all elements or in those of a region.

    ``stress`` is that of the run's displacement, ``preload`` that of the clamping before it.

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
    return StressHistory(
        run.field_times,
        elements.astype(np.intp),
        np.array(stress),
        preload_stress(structure)[elements],
    )


def preload_stress(structure: Structure) -> FloatArray:
    """Stress of each element at rest, by the clamp forces of bolts alone, shape (elements, 6), Pa.

    Zero without bolts: pressures that are given are no stress of the bodies.
    """
    if structure.preload is None:
        return np.zeros((structure.mesh.n_elements, 6))
    return structure.stress(structure.preload.displacement)


def von_mises(stress: FloatArray) -> FloatArray:
    """Von Mises stress, (...), from XX, YY, ZZ, XY, YZ and XZ, (..., 6), Pa."""
    xx, yy, zz = np.moveaxis(stress[..., :3], -1, 0)
    distortion = 0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2)
    return np.asarray(np.sqrt(distortion + 3.0 * np.sum(stress[..., 3:] ** 2, axis=-1)))
