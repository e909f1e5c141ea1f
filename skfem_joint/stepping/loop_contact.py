"""What elastic contact that opens has in the compiled loop over steps, beside its step problems.

`skfem_joint.stepping.time_loop` calls these functions where friction limits follow normal forces.
Rigid contact that opens is not stepped in that loop: its forces are impulses, which
`skfem_joint.stepping.normal_forces` describes.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-decorators

from __future__ import annotations

from typing import Any, NamedTuple

from skfem_joint.ground.compiling import inlined
from skfem_joint.linalg.kernels import combine_rows
from skfem_joint.linalg.vectors import raise_to_norms


class Opening(NamedTuple):
    """Elastic contact that opens, beside the normal part of a step problem and its limits w.

    Attributes
    ----------
    rest : ndarray, shape (n,)
        Forces at rest on the unknowns, N.
    apart, stiffness : ndarray, shape (q,)
        Approach at which each point begins to carry, m, and its stiffness, N/m.
    at_rest : float
        Energy that the points store at rest, J.
    p, force, limits : ndarray, shape (q,), (rows,) and (m,)
        Normal forces, friction and friction limits now, N.
    new_force : ndarray, shape (rows,)
        Friction at the end of a step, N.
    approach : ndarray, shape (q,)
        Worked in.
    share : ndarray
        Worked in: shares of the points with friction in the limit of their joints.
    slider_peak : ndarray, shape (m,)
        Largest slips of sliders, m; empty without springs.
    peak, least : ndarray, shape (q,)
        Largest and smallest normal forces, N.
    """

    rest: Any
    apart: Any
    stiffness: Any
    at_rest: Any
    p: Any
    force: Any
    limits: Any
    new_force: Any
    approach: Any
    share: Any
    slider_peak: Any
    peak: Any
    least: Any


@inlined
def approach(contact, normal, moved, u, right):
    """Prepare the step problem, from the predicted displacements; ``moved`` is c_K, s."""
    combine_rows(normal.N, u, contact.approach)
    for i in range(right.size):
        right[i] += contact.rest[i]
    for c in range(normal.bound.size):
        normal.bound[c] = (contact.apart[c] - contact.approach[c]) / moved


@inlined
def at_end(contact, w, sigma):
    """Take note of the friction at the end of a step, from the normalised one."""
    for i in range(sigma.size):
        contact.new_force[i] = w[i] * sigma[i]


@inlined
def add_normal_work(contact, normal, change, dissipated):
    """Add what the scheme takes of the work of normal forces, J, and see to their peaks.

    As `NormalPart.work_left` has it.
    """
    combine_rows(normal.N, change, contact.approach)
    for c in range(contact.p.size):
        new, old = normal.p[c], contact.p[c]
        dissipated[1] += (
            0.5 * (old + new) * (contact.approach[c] - (new - old) / contact.stiffness[c])
        )
        contact.peak[c] = max(contact.peak[c], new)
        contact.least[c] = min(contact.least[c], new)


@inlined
def potential(contact, p, u):
    """Energy of normal forces at the displacements u, J, as `NormalPart.potential` has it."""
    energy = -contact.at_rest
    for i in range(u.size):
        energy -= contact.rest[i] * u[i]
    for c in range(p.size):
        energy += p[c] ** 2 / (2.0 * contact.stiffness[c])
    return energy


@inlined
def raise_slider_peaks(contact, stretch, slip, out):
    """Raise the largest slips of sliders; ``out``, (rows,), is worked in."""
    if contact.slider_peak.size > 0:
        for i in range(out.size):
            out[i] = slip[i] - stretch[i] * contact.new_force[i]
        raise_to_norms(contact.slider_peak, out)


@inlined
def follow(contact, p, w):
    """Take over the forces at the end of a step."""
    for c in range(contact.p.size):
        contact.p[c] = p[c]
    for i in range(contact.force.size):
        contact.force[i] = contact.new_force[i]
    for k in range(contact.limits.size):
        contact.limits[k] = w[k]


@inlined
def share_now(contact, start, point, value):
    """Set the shares of points in the friction limit of their joints."""
    for k in range(start.size - 1):
        whole = 0.0
        for e in range(start[k], start[k + 1]):
            whole += value[e] * contact.limits[point[e]]
        for e in range(start[k], start[k + 1]):
            own = value[e] * contact.limits[point[e]]
            contact.share[e] = own / whole if whole > 0.0 else 0.0


@inlined
def store_forces(contact, point_place, stored_p, stored_limits):
    """Store the normal forces, (q,), and the limits, (m,), in the order of the system."""
    for c in range(contact.p.size):
        stored_p[c] = contact.p[c]
    for j in range(point_place.size):
        stored_limits[j] = contact.limits[point_place[j]]
