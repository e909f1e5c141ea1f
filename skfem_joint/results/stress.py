"""Stress of a run over its stored times: of vibration, of the preload, and of both together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError, listed
from skfem_joint.ground.plain_values import Tabular, spread
from skfem_joint.results.contact_history import check_fields, displacements
from skfem_joint.stepping.recording import Run
from skfem_joint.structure.structure import Structure

#: Components of stress in their order.
COMPONENTS = ("XX", "YY", "ZZ", "XY", "YZ", "XZ")
#: Fewest times of a cycle, whose largest value is at most 0.5 % below the amplitude of a sine.
FEWEST_TIMES = 33


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
        The same at rest, by the clamp forces of bolts alone; zero without joints, and nan where it
        is not known: see `notes`.
    middles : ndarray, shape (k, 3)
        Middle of each element in space, m.
    notes : tuple of str
        What is not known of these stresses, in whole sentences.
    """

    times: FloatArray
    elements: IntArray
    stress: FloatArray
    preload: FloatArray
    middles: FloatArray
    notes: tuple[str, ...] = ()

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

    def cycle(self, period: float | None = None) -> StressCycle:
        """Mean and range of each component in the last ``period`` (s) of the run, for fatigue.

        Over all stored times, if no period is given.

        Raises
        ------
        InputError
            If less than a period is stored, or fewer than 33 times of it, between which a peak may
            lie.
        """
        late = within(self.times, period)
        stored = float(self.times[-1] - self.times[0])
        if late is None:
            count = np.count_nonzero(self.times >= self.times[-1] - (period or stored))
            raise InputError(
                f"period: found {period or stored:g} s, in which {count} times are stored, "
                f"must be at most the {stored:g} s that are stored, with at least {FEWEST_TIMES} "
                "times in it, since peaks lie between them; "
                "store more fields by save=Save(fields=True, every=...), or integrate longer"
            )
        return StressCycle.of(self.elements, self.middles, self.preload, self.stress[late])


def within(times: FloatArray, period: float | None) -> slice | None:
    """Rows of the last period, or of all times without one; None for too few, or too long."""
    stored = float(times[-1] - times[0]) if times.size else 0.0
    period = stored if period is None else period
    first = int(np.searchsorted(times, times[-1] - period * (1.0 + 1e-9))) if times.size else 0
    if not 0.0 < period <= stored * (1.0 + 1e-9) or times.size - first < FEWEST_TIMES:
        return None
    return slice(first, None)


@dataclass(frozen=True)
class StressCycle(Tabular):
    """Mean and range of the stress of a cycle, component by component, and its largest values.

    Where all components follow the load in phase, as in one mode, `amplitude` is that of the von
    Mises stress of the alternating part; otherwise it is an upper bound of it. What needs the
    preload is nan where that is not known.

    Attributes
    ----------
    elements : ndarray of int, shape (k,)
        Numbers of the elements in the mesh.
    mean : ndarray, shape (k, 6)
        Middle between least and largest value of each component, preload included, Pa.
    range : ndarray, shape (k, 6)
        Largest less least value, Pa.
    preload : ndarray, shape (k, 6)
        At rest, Pa.
    vibration, total : ndarray, shape (k,)
        Largest von Mises stress in the cycle, of the vibration alone and with the preload, Pa.
    middles : ndarray, shape (k, 3)
        Middle of each element in space, m.
    """

    elements: IntArray
    mean: FloatArray
    range: FloatArray
    preload: FloatArray
    vibration: FloatArray
    total: FloatArray
    middles: FloatArray

    @classmethod
    def of(
        cls,
        elements: IntArray,
        middles: FloatArray,
        preload: FloatArray,
        stresses: Iterable[FloatArray],
    ) -> StressCycle:
        """Cycle of these stresses of the vibration, each (k, 6), one after the other."""
        low, high = np.full(preload.shape, np.inf), np.full(preload.shape, -np.inf)
        vibration, total = np.zeros((2, len(preload)))
        for stress in stresses:
            low, high = np.minimum(low, stress), np.maximum(high, stress)
            vibration = np.maximum(vibration, von_mises(stress))
            total = np.maximum(total, von_mises(preload + stress))
        mean = preload + 0.5 * (low + high)
        return cls(elements, mean, high - low, preload, vibration, total, middles)

    @property
    def amplitude(self) -> FloatArray:
        """Von Mises stress of half of the range, Pa, shape (k,)."""
        return von_mises(0.5 * self.range)

    @property
    def signed_mean(self) -> FloatArray:
        """Von Mises stress of the mean with the sign of its trace, below zero in pressure, (k,)."""
        trace = self.mean[:, :3].sum(axis=1)
        return np.where(trace < 0.0, -1.0, 1.0) * von_mises(self.mean)

    @property
    def worst(self) -> int:
        """Number of the element with the largest `amplitude`."""
        return int(self.elements[self.amplitude.argmax()])

    @property
    def table(self) -> dict[str, Any]:
        """Columns with a row for each element, as ``stress.csv``."""
        return {
            "element": self.elements,
            **spread("{}_m", self.middles, "xyz"),
            "preload_von_mises_Pa": von_mises(self.preload),
            "vibration_von_mises_Pa": self.vibration,
            "total_von_mises_Pa": self.total,
            "alternating_von_mises_Pa": self.amplitude,
            "mean_von_mises_signed_Pa": self.signed_mean,
            **spread("mean_{}_Pa", self.mean, COMPONENTS),
            **spread("range_{}_Pa", self.range, COMPONENTS),
        }

    def largest(self) -> Iterator[tuple[str, dict[str, float]]]:
        """Where each von Mises stress is largest, and all stresses there, by names with units.

        The stresses are that of the ``preload``, of the ``vibration`` alone in the cycle, ``total``
        of both, and ``alternating``, half of the range. Those that are not known are left out.
        """
        table = self.table
        for name in ("preload", "vibration", "total", "alternating"):
            values = table[f"{name}_von_mises_Pa"]
            if not np.isnan(values).any():
                k = int(values.argmax())
                yield name, {column: cells[k].item() for column, cells in table.items()}


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
        middles(structure)[elements],
        stress_notes(structure),
    )


def cycle_period(run: Run) -> float | None:
    """Time that a cycle of a run takes, s; None without complete cycles."""
    plan, complete = run.plan, run.cycles.friction.size > 0
    return plan.cycle_steps * plan.step if plan and plan.cycle_steps and complete else None


def middles(structure: Structure) -> FloatArray:
    """Mean of the corners of each element in space, (elements, 3), m."""
    return np.asarray(structure.mesh.coordinates[structure.mesh.mesh.t].mean(axis=0))


def preload_stress(structure: Structure) -> FloatArray:
    """Stress of each element at rest, by the clamp forces of bolts alone, shape (elements, 6), Pa.

    nan where it is not known, see `stress_notes`.
    """
    unknown = bool(stress_notes(structure))
    if structure.preload is None or unknown:
        return np.full((structure.mesh.n_elements, 6), np.nan if unknown else 0.0)
    return structure.stress(structure.preload.displacement)


def stress_notes(structure: Structure) -> tuple[str, ...]:
    """Sentence about stress at rest that is not known: that of pressures that are given.

    Their counterpart, what presses from outside, is no part of the model.
    """
    given = [joint.name for joint in structure.joints if not joint.pressed_by_bolts]
    if not given:
        return ()
    return (
        f"Stress at rest is not known: the pressure of {listed(given)} is given, so that "
        "what presses its faces together is no part of the model. Stresses are those of the "
        "vibration alone; preload, total and mean are left open. Give the bolts as [[bolt]], "
        "sj.Clamp, with pressure = 'preload', to have them.",
    )


def von_mises(stress: FloatArray) -> FloatArray:
    """Von Mises stress, (...), from XX, YY, ZZ, XY, YZ and XZ, (..., 6), Pa."""
    xx, yy, zz = np.moveaxis(stress[..., :3], -1, 0)
    distortion = 0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2)
    return np.asarray(np.sqrt(distortion + 3.0 * np.sum(stress[..., 3:] ** 2, axis=-1)))
