"""What each joint and each bolt has of loss, slip and normal force.

A place is a joint or a bolt. A joint's part in a contact point is its share of the friction limit
there. Bolts divide the points of the joints that they press among themselves: bolts on rings in
proportion to the forces with which they press a point, and points without any by distance; clamps,
which press by way of the bodies, by the distance from their axes. So bolts of one joint are told
apart without a joint for each.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.body.body import Body
from skfem_joint.ground.arrays import BoolArray, FloatArray, as_dense
from skfem_joint.ground.plain_values import Tabular
from skfem_joint.joint.clamps import clamp_line
from skfem_joint.joint.manifold import manifold_of
from skfem_joint.joint.patch import Patch
from skfem_joint.joint.pressure import Bolts, nodal_pressure
from skfem_joint.results.loss import known, over
from skfem_joint.runs.last_cycle import energies
from skfem_joint.stepping.recording import Run
from skfem_joint.structure.model import AnyStructure
from skfem_joint.structure.structure import Structure
from skfem_joint.system.system import System


@dataclass(frozen=True)
class JointPlaces:
    """Joints of a structure and their bolts, with their parts of the m contact points.

    Attributes
    ----------
    names : tuple of str
        Of the joints; of their bolts on rings ``JOINT_bolt_1`` and so on; of clamps, which may
        press several joints, ``bolt_1`` and so on.
    joints : int
        How many are joints; the others are bolts.
    owner : tuple of int
        Number of the joint of each place; -1 of clamps.
    share : sparse array, shape (places, m)
        Part of each place in each contact point. Those of the joints add up to 1.
    normal_force : ndarray, shape (places,)
        Of the points of each place at rest, N.
    system : System
        The full model, in which these points are.
    """

    names: tuple[str, ...]
    joints: int
    owner: tuple[int, ...]
    share: sparse.csr_array
    normal_force: FloatArray
    system: System

    def of_run(self, run: Run, slipped: FloatArray, period: float) -> PlaceResults:
        """Results of all places in the last cycle of a run, or in all of it without cycles.

        Parameters
        ----------
        run : Run
            Of the full model, or of a smaller one, whose points stand for those of the full one.
        slipped : ndarray, shape (m,)
            Largest slip of the slider of each contact point of the full model, m; taken where there
            are no cycles.
        period : float
            Time that a point has to creep in, s.
        """
        cycles = run.cycles.friction.size > 0
        work = of_all(run.system, run.cycles.by_point if cycles else run.friction_work)
        if not energies(run)[0]:
            work = np.zeros_like(work)
        slip = slips_of_all(run.system, run.slip_peak)
        slid = self._slid(work, slip) if cycles else slipped
        return self.of(work, slip, self.system.slipping(slid, period))

    def of_curve(
        self, work: FloatArray, slip: FloatArray, period: FloatArray | float = 0.0
    ) -> PlaceResults:
        """Results of all places in many cycles.

        Parameters
        ----------
        work, slip : ndarray, shape (cycles, m)
            Energy that friction takes in a cycle at each contact point of the full model, J, and
            largest slip, m.
        period : ndarray, shape (cycles,), or float
            Time that a point has to creep in, s; 0 for slow cycles.
        """
        slid, periods = self._slid(work, slip), np.broadcast_to(period, len(work))
        both = zip(slid, periods.tolist(), strict=True)
        return self.of(work, slip, np.array([self.system.slipping(*one) for one in both]))

    def _slid(self, work: FloatArray, slip: FloatArray) -> FloatArray:
        """Slip of each point in a cycle, (..., m), m, from its work, J, and its largest slip, m.

        The work is on the limit at rest; where there is none, as in open gaps, the largest slip
        stands for it.
        """
        contact = self.system.contact
        return np.where(contact.w > 0.0, contact.slid(work), np.where(work > 0.0, slip, 0.0))

    def of(self, work: FloatArray, slip: FloatArray, slips: BoolArray) -> PlaceResults:
        """Results of all places.

        Parameters
        ----------
        work : ndarray, shape (..., m)
            Energy that friction takes at each contact point, J; nan where it is not known.
        slip : ndarray, shape (..., m)
            Largest slip of each contact point, m.
        slips : ndarray of bool, shape (..., m)
            Whether each contact point slips, see `System.slipping`.
        """
        share, w = self.share, self.system.contact.point_weights
        whole = np.asarray(share @ w)
        mostly = as_dense(share) >= 0.5
        largest = [np.where(own, slip, 0.0).max(axis=-1, initial=0.0) for own in mostly]
        by_place = np.asarray((share @ work.T).T)
        slipping = np.where(np.isnan(work), np.nan, slips * w)
        total = by_place[..., : self.joints].sum(axis=-1, keepdims=True)
        return PlaceResults(
            names=self.names,
            joints=self.joints,
            loss_share=over(by_place, total),
            slipping_share=over(np.asarray((share @ slipping.T).T), whole),
            largest_slip=np.stack(largest, axis=-1) if largest else by_place,
            normal_force=self.normal_force,
            limit=whole,
        )


def of_all(model: System, work: FloatArray) -> FloatArray:
    """Works of all contact points, (..., m), J, from those of a model's own points.

    Points that a model's point stands for have its work in proportion to their shares in it.
    """
    shares = model.contact.shares
    return work if shares is None else np.asarray((shares.T @ work.T).T)


def slips_of_all(model: System, slip: FloatArray) -> FloatArray:
    """Slips of all contact points, (..., m), m: each has that of the one that stands for it."""
    shares = model.contact.shares
    return slip if shares is None else np.asarray(slip @ (shares > 0.0))


@dataclass(frozen=True)
class PlaceResults(Tabular):
    """Results of joints and bolts; shapes begin with that of the cycles that they are of.

    Attributes
    ----------
    names, joints
        As of `JointPlaces`.
    loss_share : ndarray, shape (..., places)
        Of what friction takes in all joints; nan where it takes nothing.
    slipping_share : ndarray, shape (..., places)
        Share of the friction limit of each place whose points slip, 1 where it slips as a whole.
    largest_slip : ndarray, shape (..., places)
        Of the points that belong to a place by half at least, m: of a run over all of it.
    normal_force, limit : ndarray, shape (places,)
        Normal force at rest and friction limit, N.
    """

    names: tuple[str, ...]
    joints: int
    loss_share: FloatArray
    slipping_share: FloatArray
    largest_slip: FloatArray
    normal_force: FloatArray
    limit: FloatArray

    @property
    def slipping_share_of_all(self) -> FloatArray:
        """Share of the friction limits of all joints whose points slip, (...); 0 without any."""
        limit, share = self.limit[: self.joints], self.slipping_share[..., : self.joints]
        slips = np.asarray(np.where(limit > 0.0, share, 0.0) @ limit)
        return slips / limit.sum() if limit.any() else 0.0 * slips

    @property
    def normal_share(self) -> FloatArray:
        """Share of each place in the normal force of all joints at rest, (places,)."""
        return over(self.normal_force, self.normal_force[: self.joints].sum())

    @property
    def table(self) -> dict[str, Any]:
        """Columns with a row for each place, of each cycle in turn."""
        count, places = int(np.prod(self.loss_share.shape[:-1])), len(self.names)
        return {
            "cycle": np.repeat(np.arange(count), places),
            "place": [*self.names] * count,
            **{name: np.ravel(values) for name, values in self._values.items()},
        }

    @property
    def _values(self) -> dict[str, FloatArray]:
        """Values by the names of their columns, (..., places) each."""
        shape = self.loss_share.shape
        return {
            "loss_share": self.loss_share,
            "slipping_share": self.slipping_share,
            "largest_slip_m": self.largest_slip,
            "normal_force_N": np.broadcast_to(self.normal_force, shape),
            "normal_force_share": np.broadcast_to(self.normal_share, shape),
        }

    @property
    def columns(self) -> dict[str, FloatArray]:
        """Columns of tables by name, {} for the place, with an array (..., places) each."""
        return {
            "loss_share_{}": self.loss_share,
            "slipping_share_{}": self.slipping_share,
            "largest_slip_{}_m": self.largest_slip,
        }

    def entries(self, *cycle: int) -> Iterator[tuple[str, bool, dict[str, float | None]]]:
        """Name of each place, whether it is a bolt, and its content of a summary, of one cycle."""
        for k, name in enumerate(self.names):
            row = {of: float(values[(*cycle, k)]) for of, values in self._values.items()}
            yield name, k >= self.joints, known(row)


def places_of(structure: AnyStructure, system: System) -> JointPlaces:
    """Joints and bolts of a structure, with their parts of its contact points.

    Parameters
    ----------
    structure : Structure or MatrixModel
    system : System
        Its full model, under any loads.

    Returns
    -------
    JointPlaces
    """
    J, joints = as_dense(system.contact.J), system.contact.joints
    force = np.zeros(system.contact.w.size)
    for patch in structure.patches:
        np.add.at(force, patch.points, patch.normal_force)
    bolts = [*_bolts(structure, J)] if isinstance(structure, Structure) else []
    names = *joints, *(name for name, _, _ in bolts)
    owner = *range(len(joints)), *(joint for _, joint, _ in bolts)
    share = sparse.csr_array(np.vstack([J, *(row for _, _, row in bolts)]))
    return JointPlaces(names, len(joints), owner, share, share @ force, system)


def _bolts(structure: Structure, J: FloatArray) -> Iterator[tuple[str, int, FloatArray]]:
    """Name, joint and parts of all contact points, (m,), of each bolt of a structure."""
    for k, patch in enumerate(structure.patches):
        if isinstance(patch.joint.pressure, Bolts):
            parts = _ring_parts(structure.body, patch, patch.joint.pressure)
            for number, part in enumerate(parts, 1):
                row = np.zeros(J.shape[1])
                row[patch.points] = J[k, patch.points] * part
                yield f"{patch.joint.name}_bolt_{number}", k, row
    pressed = [(k, p) for k, p in enumerate(structure.patches) if p.joint.pressed_by_bolts]
    if not structure.bolts:
        return
    lines = [clamp_line(structure.body, bolt) for bolt in structure.bolts]
    rows = np.zeros((len(lines), J.shape[1]))
    for k, patch in pressed:
        away = structure.body.nodes[patch.nodes] - np.array([[line.middle] for line in lines])
        along = np.array([line.along for line in lines])
        way = np.einsum("bkd,bd->bk", away, along)
        distance = np.linalg.norm(away - way[..., None] * along[:, None], axis=2)
        rows[distance.argmin(axis=0), patch.points] += J[k, patch.points]
    for number, row in enumerate(rows, 1):
        yield f"bolt_{number}", -1, row


def _ring_parts(body: Body, patch: Patch, pressure: Bolts) -> FloatArray:
    """Part of each bolt of a joint in its contact points, (bolts, k)."""
    manifold = manifold_of(body, patch.joint)
    at = [np.asarray(bolt.at[: body.dim]) for bolt in pressure.bolts]
    nodes = body.nodes[patch.nodes]
    distance = np.array([np.linalg.norm(nodes - place, axis=1) for place in at])
    nearest = np.eye(len(at))[:, distance.argmin(axis=0)]
    cells = body.nodes, manifold.cells, manifold.depth
    alone = (replace(pressure, bolts=(bolt,)) for bolt in pressure.bolts)
    force = np.array(
        [nodal_pressure(*cells, one, patch.joint.label)[0][patch.nodes] for one in alone]
    )
    return np.where(force.sum(axis=0) > 0.0, over(force, force.sum(axis=0)), nearest)
