"""Decay envelope of an impulse response: which law it follows, and why (section 7.4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import curve_fit
from scipy.signal import find_peaks

from skfem_joint.paper import figures
from skfem_joint.paper.items import FloatArray, Item, Row, published
from skfem_joint.paper.workspace import Workspace
from skfem_joint.recording import Run

#: Two-parameter envelopes over dimensionless time, from a first amplitude of about one.
LAWS: dict[str, Callable[[FloatArray, float, float], FloatArray]] = {
    "linear": lambda t, a, r: a * (1.0 - r * t),
    "exponential": lambda t, a, r: a * np.exp(-r * t),
    "hyperbolic": lambda t, a, r: a / (1.0 + r * t),
}


@dataclass(frozen=True)
class Envelope:
    """Half swings of a history.

    Attributes
    ----------
    time : ndarray
        Middle of each swing, s.
    amplitude, mean : ndarray
        Half the swing and its middle, m.
    """

    time: FloatArray
    amplitude: FloatArray
    mean: FloatArray

    @property
    def decrement(self) -> FloatArray:
        """Logarithmic decrement per cycle at each swing but the last."""
        return np.asarray(-2.0 * np.diff(np.log(self.amplitude)))

    def frequency(self) -> float:
        """Of the last swings, Hz."""
        return float(0.5 / np.diff(self.time[-6:]).mean())

    def fits(self) -> dict[str, tuple[FloatArray, float]]:
        """Least-squares fit of each law and its rms misfit, percent of the first amplitude."""
        t, a = (self.time - self.time[0]) / np.ptp(self.time), self.amplitude / self.amplitude[0]
        found = {}
        for name, law in LAWS.items():
            values, _ = curve_fit(law, t, a, p0=(1.0, 1.0))
            fit = law(t, *values)
            found[name] = (
                fit * self.amplitude[0],
                float(100.0 * np.sqrt(np.mean((fit - a) ** 2))),
            )
        return found


def envelope(run: Run, point: str, period: float) -> Envelope:
    """Swings of a point's history from one extreme to the next.

    Taking half swings instead of peaks leaves out the displacement that friction locks in.
    Extremes are found on a history smoothed over a quarter of the period, so that ripples on a
    flat crest do not count, and read from the history itself.
    """
    u = run.point(point)
    steps = period / (run.times[1] - run.times[0])
    smooth = uniform_filter1d(u, int(steps / 4))
    found = [(row, sign) for sign in (1, -1) for row in find_peaks(sign * smooth)[0]]
    kept: list[tuple[int, int]] = []
    for row, sign in sorted(found):
        if not kept or sign != kept[-1][1]:
            kept.append((int(row), sign))
    near = int(steps / 8)
    extremes = np.array(
        [sign * (sign * u[max(0, r - near) : r + near + 1]).max() for r, sign in kept]
    )
    t = run.times[[row for row, _ in kept]]
    return Envelope(
        0.5 * (t[1:] + t[:-1]),
        0.5 * np.abs(np.diff(extremes)),
        0.5 * (extremes[1:] + extremes[:-1]),
    )


def friction_share(run: Run) -> float:
    """Friction's part of what is dissipated, percent."""
    friction = float(run.friction_work.sum())
    return 100.0 * friction / (friction + run.viscous_work)


def add_envelope(
    item: Item, workspace: Workspace, runs: dict[str, Run], *, period: float, damping: float
) -> None:
    """Add rows, notes, curves and a picture of the free end's decay to the item.

    Parameters
    ----------
    runs : dict
        By description; the first is the paper's, the last has no viscous damping.
    period : float
        Of the first resonance, s.
    damping : float
        Stiffness damping of the first run, s.
    """
    swings = {label: envelope(run, "free_end", period) for label, run in runs.items()}
    fits = {label: one.fits() for label, one in swings.items()}
    says = published()["section7.4"]["decay"]
    for label, found in fits.items():
        best = min(found, key=lambda name: found[name][1])
        item.rows.append(
            Row(
                f"decay at the free end, {label}: rms misfit of a {'; '.join(found)} envelope, %",
                says,
                full="; ".join(f"{misfit:.2f}" for _, misfit in found.values()),
                difference=f"{best} fits best",
                verdict=("agrees: not linear" if best != "linear" else "differs: linear")
                + f"; friction takes {friction_share(runs[label]):.0f} % of the energy",
            )
        )
    item.notes += _why(runs, swings, fits, damping)
    for number, (label, one) in enumerate(swings.items(), start=1):
        item.curves[f"section7.4_envelope_{number}"] = {
            "time (s)": one.time,
            "amplitude (m)": one.amplitude,
            "mean (m)": one.mean,
            **{f"{name} fit (m)": fit for name, (fit, _) in fits[label].items()},
        }
    if workspace.draws():
        drawing, axes = figures.figure(columns=2, rows=2, width=5.2, height=3.4)
        for axis, (label, one) in zip(axes.flat, swings.items(), strict=True):
            axis.semilogy(
                1e3 * one.time,
                1e6 * one.amplitude,
                "o",
                color="#000000",
                markersize=3.5,
                label="half swings, full model",
            )
            for (name, (fit, misfit)), style in zip(
                fits[label].items(), figures.STYLES[1:], strict=False
            ):
                shown = fit > 0.3 * one.amplitude.min()
                axis.semilogy(
                    1e3 * one.time[shown],
                    1e6 * fit[shown],
                    label=f"{name}, misfit {misfit:.1f} %",
                    **style,
                )
            figures.finish(axis, "time (ms)", "amplitude (µm)", label)
        workspace.save(item, "fig21_envelope", drawing)


def _why(
    runs: dict[str, Run],
    swings: dict[str, Envelope],
    fits: dict[str, dict[str, tuple[FloatArray, float]]],
    damping: float,
) -> list[str]:
    labels = list(runs)
    paper, held, bare = swings[labels[0]], swings[labels[1]], swings[labels[-1]]
    viscous = 2.0 * np.pi**2 * damping * paper.frequency()
    misfit = {name: value for name, (_, value) in fits[labels[-1]].items()}
    return [
        "Which decay to expect: a friction force that stays the same while everything slips makes "
        "the envelope linear, viscous damping makes it exponential. In micro-slip the slipping "
        "length shrinks with the amplitude a: the loss per cycle goes with a³, the stored energy "
        "with a², so that the logarithmic decrement falls with a and 1/a grows evenly in time, a "
        "hyperbola, fast at first and slow later. Without viscous damping (a check, not the "
        f"paper's system) the decrement per cycle falls from {bare.decrement[0]:.2f} to "
        f"{bare.decrement[-1]:.2f}, and the rms misfits are {misfit['hyperbolic']:.1f} % for the "
        f"hyperbola, {misfit['exponential']:.1f} % for an exponential and {misfit['linear']:.1f} % "
        "for a line. This is the mechanism that the paper names: friction forces comparable to the "
        "elastic ones (the pulse is half the friction limit).",
        f"With the paper's C = {damping:g} s · K, however, viscous damping covers most of this "
        f"under the assumed triangle: friction takes {friction_share(runs[labels[0]]):.0f} % of "
        f"the energy. The decrement falls from {paper.decrement[0]:.3f} to "
        f"{paper.decrement[-1]:.3f} per cycle; viscous damping alone makes it {viscous:.3f} at the "
        f"final {paper.frequency():.0f} Hz with the joint stuck, so that the envelope is not "
        "linear, as published, but within "
        f"{fits[labels[0]]['exponential'][1]:.1f} % of an exponential. Under ramp and hold, where "
        f"friction takes {friction_share(runs[labels[1]]):.0f} %, it falls from "
        f"{held.decrement[0]:.3f} to {held.decrement[-1]:.3f}. "
        "What the eye sees is another trace of friction: the joint locks in a displacement, "
        f"{1e6 * paper.mean[-1]:.2f} µm at the end against a last amplitude of "
        f"{1e6 * paper.amplitude[-1]:.2f} µm, so that peaks level off while swings still decay. "
        "Amplitudes here are half swings from one extreme to the next, free of that offset.",
    ]
