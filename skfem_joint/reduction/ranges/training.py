"""Static slip paths at points spread over a range, and the pool of their snapshots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.linalg import null_space
from scipy.stats import qmc

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.reduction.basis import MERGED_IF_OPEN
from skfem_joint.reduction.elastic_contact import strain_norm
from skfem_joint.reduction.friction_points import few_points
from skfem_joint.reduction.pod import ProperModes, orthonormal, proper_decomposition, thinned
from skfem_joint.reduction.ranges.points import placed
from skfem_joint.reduction.ranges.stuck import StuckVibration
from skfem_joint.reduction.static_path import StaticPath, slip_path
from skfem_joint.runs.resolution import longest_step
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.stepping.plan import Plan
from skfem_joint.system.served import Point, Range
from skfem_joint.system.system import System

# Proper orthogonal modes that stand for a path's snapshots in the pool.
_KEPT = 40


def spread(joints: Sequence[str], range_: Range, count: int) -> list[Point]:
    """Points spread over a range by Sobol's sequence, the same ones at each call.

    Frequencies are even, shares of slip and factors even in their logarithms: few points slip at
    low shares, and paths to high shares say little of them. Their levels are not known yet.
    """
    free = [(name, pair) for name, pair in range_.limits.items() if pair[1] > pair[0]]
    fixed = {name: pair[0] for name, pair in range_.limits.items()}
    free.sort(key=lambda item: joints.index(item[0]))
    engine = qmc.Sobol(2 + len(free), rng=0)
    numbers = engine.random(1 << max(count - 1, 1).bit_length())[:count]
    places = []
    (low, high), (slow, fast) = range_.slip, range_.frequency
    high = 1.1 * high  # trained a little beyond the range
    for x in numbers.tolist():
        shares = zip(free, x[2:], strict=True)
        limits = {name: pair[0] * (pair[1] / pair[0]) ** share for (name, pair), share in shares}
        slip = low * (high / low) ** x[1]
        places.append(Point(slow + (fast - slow) * x[0], limits=fixed | limits, slip=slip))
    return places


@dataclass
class Pool:
    """Static slip paths of one system at many points.

    Attributes
    ----------
    system : System
        The full system; contact that opens is elastic.
    path : QuasiStatic
        Its quasi-static path, whose factors all points use.
    stuck : StuckVibration
    energy : matrix, shape (n, n)
        Inner product of the proper orthogonal modes.
    paths : list of StaticPath
        Their snapshots are compressed: proper orthogonal modes times their singular values.
    places : list of Point
    """

    system: System
    path: QuasiStatic
    stuck: StuckVibration
    energy: Any
    paths: list[StaticPath] = field(default_factory=list)
    places: list[Point] = field(default_factory=list)

    @staticmethod
    def of(system: System, range_: Range) -> Pool:
        """Pool without paths."""
        stuck = StuckVibration.of(system.closed(), range_.frequency[1])
        return Pool(system, QuasiStatic(system, 3e-5), stuck, strain_norm(system))

    def follow(self, place: Point) -> StaticPath:
        """Static slip path of a point; it is added to the pool."""
        there = placed(self.system, place)
        period, cycles = 1.0 / place.frequency, 3
        step = min(period / 200, longest_step(there, cycles * period))
        plan = Plan(step, round(cycles * period / step))
        # More modes than its levels tell apart, so that it follows the path through time too.
        found = slip_path(there, plan, 30, self.path.with_limits(there.contact))
        own = proper_decomposition(found.snapshots, self.energy)
        kept = own.modes[:, :_KEPT] * own.singular_values[:_KEPT]
        self.paths.append(replace(found, snapshots=kept.T))
        self.places.append(place)
        return found

    def proper(self) -> ProperModes:
        """Proper orthogonal modes of all snapshots, in the norm of strain energy."""
        return proper_decomposition(np.vstack([path.snapshots for path in self.paths]), self.energy)

    def basis(self, proper: ProperModes, modes: int) -> FloatArray:
        """Basis (n, j): the first proper modes, static responses, rigid and interface motions."""
        rigid = [path.rigid for path in self.paths if path.rigid.size][:1]
        M, stuck = self.system.M, self.stuck.modes
        W = [proper.modes[:, :modes], self.paths[0].response, *rigid, stuck]
        V = orthonormal(np.hstack(W), M)
        # What nearly depends on other vectors is left out, of stuck modes too, which then slip by
        # 1e-7 of their motion and are no modes without slip any more: they are put back whole.
        beside = V @ null_space(stuck.T @ (M @ V))
        return orthonormal(np.hstack([stuck, beside]), M)

    def merged(self, V: FloatArray) -> System:
        """Reduced system on a basis with merged contact points."""
        rates, states, MV = [], [], self.system.M @ V
        for path in self.paths:
            u, v = (thinned(x, 60) @ (path.V.T @ MV) for x in (path.run.u, path.run.v))
            states.append(u)
            rates.append(v / max(float(np.abs(v).max()), 1e-300))
        contact = self.system.contact
        # With constant limits three merged friction points for each vector of a basis; with contact
        # that opens they are as many as a model for one load would have.
        each = MERGED_IF_OPEN if contact.opens else (3,)
        numbers = [number * V.shape[1] for number in each]
        points = np.flatnonzero(contact.rubs)
        known = np.vstack(rates), np.vstack(states)
        return few_points(self.system.project(V), points, numbers, *known)

    def law(self) -> float:
        """Steepness that resolves slip velocities, s/m, with the limits of the system."""
        velocities = []
        for path, place in zip(self.paths, self.places, strict=True):
            contact = path.run.system.contact
            slips = path.run.v @ np.asarray(contact.B).T
            velocity = float(contact.slip_norm(slips).max(initial=0.0))
            velocities.append(velocity / place.mean_factor(self.system.contact.joints))
        # The median: preliminary models of some paths may slip as a whole.
        # The law resolves velocities down to this share of the largest slip velocity.
        return 1.0 / (2e-7 * max(float(np.median(velocities)), 1e-12))
