"""Warnings about response curves whose amplitudes depend on the time step."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from skfem_joint.analysis.response import Curve

#: Relative error of an amplitude by its time step that is doubtful.
DOUBTFUL = 0.05


def step_error_notes(name: str, curve: Curve, steps_per_cycle: int) -> Iterator[str]:
    """Sentences about where the time step makes a curve doubtful, and the cure.

    A sentence also says where the error is not estimated. The steps are exact at the driven
    frequency: what errs are the harmonics of friction, where they meet higher modes.

    Parameters
    ----------
    name : str
        Of the model, for the sentences.
    curve : Curve
        With its estimated errors of the step.
    steps_per_cycle : int
    """
    error = curve.column("step_error")
    failed = np.array([point.failure is not None for point in curve.points])
    if not (np.isfinite(error) | failed).all():
        yield (
            f"The {name} model at level {curve.level:g} has no steady vibration with half the "
            "step at every frequency: where step_error is empty in response.csv the error of the "
            "step is not known."
        )
    error = np.nan_to_num(error)
    doubtful = error > DOUBTFUL
    if doubtful.any():
        frequency = curve.column("frequency")[doubtful]
        # Errors fall with the square of the step: so many steps leave one percent, in whole
        # fifties.
        enough = 50 * np.ceil(steps_per_cycle * np.sqrt(error.max() / 0.01) / 50)
        yield (
            f"The {name} model at level {curve.level:g}: the time step alone errs by up to "
            f"{100 * error.max():.2g} % of the amplitude, and by more than {100 * DOUBTFUL:g} % at "
            f"{frequency.size} frequencies from {frequency[0]:.6g} to {frequency[-1]:.6g} Hz, "
            "where harmonics of friction meet higher modes; see column step_error of "
            f"response.csv. Set time.steps_per_cycle = {enough:.0f}."
        )
