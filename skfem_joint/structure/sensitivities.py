"""Derivatives of a structure's system by its friction, forces, stiffness and damping.

All are exact as long as the same nodes touch:

- Friction limits w = sum mu N are linear in the coefficients of friction mu and the normal forces N
  of a pressure or of bolts around their holes.
- Normal forces of clamping bolts are those of the static problem of the preload. With its closed
  gaps kept closed, K u' + N^T F' = f' - K' u and N u' = g' there, with the derivative g' of the
  gap given by its scale: a linear problem with one factor
  for all parameters, :func:`skfem_joint.joint.preload.preload_rates`.
- K is linear in each Young's modulus, springs in the stiffness of the surfaces.
- C = a M + b K. With a damping ratio a and b follow two frequencies, of which those that are
  natural have the derivative phi K' phi / (2 omega) with their mode phi of unit mass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, Matrix
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.values import several
from skfem_joint.joint.contact import friction_gain
from skfem_joint.joint.manifold import manifold_of
from skfem_joint.joint.opening import NodalForces
from skfem_joint.joint.patch import Patch
from skfem_joint.joint.preload import preload_rates
from skfem_joint.joint.pressure import Bolts, nodal_pressure
from skfem_joint.structure.parameters import Parameter, check_derivable, parameter, value_of
from skfem_joint.structure.structure import Structure
from skfem_joint.system.modes import RayleighFit
from skfem_joint.system.sensitivity import SystemSensitivity, of_closed_system
from skfem_joint.system.system import System
from skfem_joint.system.unknowns import congruent

#: Derivatives of a joint's nodal forces, (N,), and of the gaps of its pressure points, (q,).
Rates = tuple[FloatArray, FloatArray]


def sensitivities(
    structure: Structure, keys: Sequence[str], system: System
) -> list[SystemSensitivity]:
    """Exact derivatives of a structure's system by the values of some keys.

    `backbone_sensitivity` makes derivatives of a curve of them; runs and responses have none: take
    differences.

    Parameters
    ----------
    structure : Structure
    keys : sequence of str
        As of a sweep, such as "joint[0].friction" or "bolt[*].force"; with ``[*]`` all entries of
        a list have the same value, and change together.
    system : System
        What ``structure.system(loads)`` returned.

    Returns
    -------
    list of SystemSensitivity
        For each key, in the unknowns of the system.

    Raises
    ------
    InputError
        For keys that cannot be varied, a value from which nothing can be derived (an infinite
        stiffness, no pressure), entries under ``[*]`` that differ, and another system.
    """
    keys = several("keys", keys)
    wanted = [parameter(structure, key) for key in keys]
    check_derivable(structure, wanted)
    for key in keys:
        value_of(structure, key)
    own = structure.unloaded.with_beta(np.inf)
    if not system.with_beta(np.inf).has_matrices_of(own, "M", "K", "contact"):
        raise InputError(
            "sensitivities: the system does not belong to the structure: found another mass, "
            "stiffness or contact, must be the structure's own system, which "
            "structure.system(loads) returns"
        )
    model = _Model(structure, system)
    by_modulus = [model.stiffness(one) for one in wanted]
    by_preload = model.preload(wanted, by_modulus)
    return [
        model.sensitivity(one, K, rates)
        for one, K, rates in zip(wanted, by_modulus, by_preload, strict=True)
    ]


@dataclass(frozen=True)
class _Model:
    """A structure and its system, of which the derivatives are.

    Attributes
    ----------
    structure : Structure
    system : System
    """

    structure: Structure
    system: System

    def sensitivity(
        self, one: Parameter, all_nodes: Matrix | None, rates: Mapping[int, Rates]
    ) -> SystemSensitivity:
        """Derivatives by a parameter.

        Parameters
        ----------
        one : Parameter
        all_nodes : sparse array, shape (dim N, dim N), or None
            Derivative of the stiffness of all nodes.
        rates : mapping
            Derivatives of the preload, by the number of the joint.
        """
        K = None if all_nodes is None else self._in_unknowns(one, all_nodes)
        of_contact = self._contact(one, rates)
        changes = {name: rate for name, rate in of_contact.items() if abs(rate).sum() > 0.0}
        C = self._damping(one, K, changes)
        return SystemSensitivity(one.name, K=K, C=C, **changes)

    def stiffness(self, one: Parameter) -> Matrix | None:
        """Derivative of the stiffness of all nodes, (dim N, dim N); None where it is zero."""
        regions = [place[2:3] for place in one.places if place[0] == "material"]
        parts = [self.structure.body.stiffness_by_modulus(*map(str, of)) for of in regions]
        return sum(parts[1:], parts[0]) if parts else None

    def _in_unknowns(self, one: Parameter, all_nodes: Matrix) -> Matrix:
        """Derivative of the stiffness in the unknowns of the system, from that of all nodes."""
        body = self.structure.body
        regions = [str(place[2]) for place in one.places if place[:2] == ("material", "regions")]
        if body.elements_of_modulus(*regions[:1]).all():  # K is proportional to the modulus
            return sparse.csr_array(self.system.K / body.properties["E"][0])
        return congruent(all_nodes, self.structure.T)

    def preload(
        self, wanted: Sequence[Parameter], by_modulus: Sequence[Matrix | None]
    ) -> list[dict[int, Rates]]:
        """Derivatives of the preload by each parameter, by the number of the joint.

        The dictionaries are empty where there are none. All parameters share a factor.
        """
        found, spaces = self.structure.preload, self.structure.spaces
        if found is None:
            return [{} for _ in wanted]
        scaled = [[("joint", i, "gap_scale") in one.places for one in wanted] for i in spaces]
        gaps = map(np.outer, [face.given for face in spaces.values()], scaled)
        gap, force = np.concatenate([*gaps]), np.zeros((found.force.size, len(wanted)))
        for column, one, K in zip(force.T, wanted, by_modulus, strict=True):
            bolts = [int(place[1]) for place in one.places if place[0] == "bolt"]
            column += np.asarray(found.faces.clamps[:, bolts].sum(axis=1)).ravel()
            if K is not None:
                column -= K @ found.displacement.ravel()
        if not (force.any() or gap.any()):
            return [{} for _ in wanted]
        rates = preload_rates(self.structure.body, found, force, gap)
        pressed = [(i, one, *rates[i]) for i, one in enumerate(found.joints) if one is not None]
        return [
            {i: self._at_joint(i, one, F[:, k], g[:, k]) for i, one, F, g in pressed}
            for k in range(len(wanted))
        ]

    def _at_joint(
        self, number: int, pressed: NodalForces, force: FloatArray, gap: FloatArray
    ) -> Rates:
        """Derivatives at a joint from those, (k,), at the nodes of its `PressureSpace`."""
        patch, nodal = self.structure.patches[number], np.zeros(self.structure.n_nodes)
        changes = np.where(pressed.contact_force > 0.0, force, 0.0)
        at = np.flatnonzero(pressed.area)
        # Constant limits are made of means, those that follow normal forces of these themselves.
        nodal[at] = changes if patch.joint.opens else pressed.means @ changes
        return nodal, gap[: patch.opening.gap.size]

    def _contact(self, one: Parameter, rates: Mapping[int, Rates]) -> dict[str, Any]:
        """Derivatives of friction limits at rest, springs, and contact that opens, by names."""
        patches, m = self.structure.patches, self.system.contact.w.size
        own = [{p[2] for p in one.places if p[:2] == ("joint", i)} for i in range(len(patches))]
        w, springs = np.zeros((2, m))
        gap, force, stiffness = ([np.zeros(0)] for _ in range(3))
        for i, (patch, keys) in enumerate(zip(patches, own, strict=True)):
            face = patch.opening
            own_gap = np.zeros(face.gap.size)
            if "gap_scale" in keys and patch.joint.opens:
                own_gap = self.structure.spaces[i].given
            nodal, gaps = rates.get(i, (self._pressed(one, i), own_gap))
            w[patch.points] += patch.joint.friction * _on_points(patch, nodal)
            w[patch.points] += ("friction" in keys) * patch.normal_force
            springs[patch.points] += ("tangential_stiffness" in keys) * patch.area
            gap.append(np.where(face.gap > 0.0, gaps, 0.0)[face.moves])
            force.append(nodal[face.nodes][face.moves])
            stiffness.append(("normal_stiffness" in keys) * face.area[face.moves])
        gain = friction_gain(patches, [float("friction" in keys) for keys in own], m)
        gain.eliminate_zeros()
        return {
            "w": w,
            "stiffness": springs,
            "gap": np.concatenate(gap),
            "force": np.concatenate(force),
            "gain": gain,
            "normal_stiffness": np.concatenate(stiffness),
        }

    def _pressed(self, one: Parameter, number: int) -> FloatArray:
        """Derivative of the nodal forces, (N,), of a joint by its own pressure."""
        joint, body = self.structure.joints[number], self.structure.body
        own = [place for place in one.places if place[:3] == ("joint", number, "pressure")]
        if not own:
            return np.zeros(body.n_nodes)
        pressure: float | Bolts = 1.0
        if isinstance(joint.pressure, Bolts):
            bolts = tuple(replace(joint.pressure.bolts[int(place[4])], force=1.0) for place in own)
            pressure = replace(joint.pressure, bolts=bolts)
        manifold = manifold_of(body, joint)
        at = manifold.cells, manifold.depth, pressure, joint.label
        return nodal_pressure(body.nodes, *at)[0]

    def _damping(
        self, one: Parameter, K: Matrix | None, contact: Mapping[str, Any]
    ) -> Matrix | None:
        """Derivative of the damping matrix, (n, n), with those of what it depends on."""
        structure, system = self.structure, self.system
        ratio = structure.damping_ratio
        match one.places[0]:
            case ("damping", "ratio") if ratio is not None:
                return sparse.csr_array(system.C / ratio)
            case ("damping", "stiffness"):
                return sparse.csr_array(system.K)
            case ("damping", "mass"):
                return sparse.csr_array(system.M)
        if ratio is None:
            factor = structure.stiffness_damping
            return sparse.csr_array(factor * K) if K is not None and factor > 0.0 else None
        closed, fit = self._rayleigh
        (of_closed,) = of_closed_system([SystemSensitivity(one.name, K=K, **contact)], system)
        rate = of_closed.of_stuck_stiffness(closed.contact)
        if rate is None:
            return None
        mass, stiffness = fit.factor_rates(ratio, lambda mode: float(mode @ (rate @ mode)))
        C = mass * system.M + stiffness * system.K
        return sparse.csr_array(C if K is None else C + fit.factors(ratio)[1] * K)

    @cached_property
    def _rayleigh(self) -> tuple[System, RayleighFit]:
        """System with closed contact, and the frequencies of its damping by a ratio."""
        closed = self.system.closed()
        return closed, self.structure.fitted(*closed.stuck_problem)


def _on_points(patch: Patch, nodal: FloatArray) -> FloatArray:
    """Normal forces of the contact points of a joint, (k,), from those of all nodes, (N,)."""
    if patch.joint.normal_force == "equal":
        return np.full(patch.nodes.size, nodal.sum() / max(patch.nodes.size, 1))
    return np.asarray(nodal[patch.nodes])
