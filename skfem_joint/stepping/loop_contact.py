"""What contact has in the compiled loop over steps, beside its step problems.

`skfem_joint.stepping.time_loop` calls the generic functions of this module. numba replaces each
call by the implementation for its first argument (see `skfem_joint.ground.compiling.compiled_for`):
`Constant` where friction limits are, and `Opening` where elastic contact opens and limits follow
its forces. Rigid contact that opens is not stepped in that loop: its forces are impulses, which
`skfem_joint.stepping.normal_forces` describes.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-decorators

from __future__ import annotations

from typing import Any, NamedTuple

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.compiling import compiled_for
from skfem_joint.linalg.kernels import combine_rows
from skfem_joint.linalg.vectors import raise_to_norms


class Constant(NamedTuple):
    """Contact with constant friction limits.

    Attributes
    ----------
    weight : ndarray, shape (rows,)
        Friction limits, N, which normalised friction is over.
    force, new_force, share : ndarray
        Not used.
    """

    weight: FloatArray
    force: FloatArray
    new_force: FloatArray
    share: FloatArray


class Opening(NamedTuple):
    """Elastic contact that opens.

    Attributes
    ----------
    N : ndarray, shape (n, q)
        Transposed operator of approaches.
    rest : ndarray, shape (n,)
        Forces at rest on the unknowns, N.
    apart, stiffness : ndarray, shape (q,)
        Approach at which each point begins to carry, m, and its stiffness, N/m.
    at_rest : float
        Energy that the points store at rest, J.
    bound, pressing : ndarray, shape (q,)
        Of the step problem: velocity at which each point begins to carry, and its force, N.
    w : ndarray, shape (rows,)
        Of the step problem: friction limits, N.
    p, force, limits : ndarray, shape (q,), (rows,) and (m,)
        Normal forces, friction and friction limits now, N.
    new_force, weight : ndarray, shape (rows,)
        Friction at the end of a step, N; the number one, which it is over.
    approach : ndarray, shape (q,)
        Worked in.
    share : ndarray
        Worked in: shares of the points with friction in the limit of their joints.
    slider_peak : ndarray, shape (m,)
        Largest slips of sliders, m; empty without springs.
    peak, least : ndarray, shape (q,)
        Largest and smallest normal forces, N.
    stored_p, stored_limits : ndarray, shape (rows, q) and (rows, m)
        Rows of stored fields, the limits in the order of the system.
    """

    N: Any
    rest: Any
    apart: Any
    stiffness: Any
    at_rest: Any
    bound: Any
    pressing: Any
    w: Any
    p: Any
    force: Any
    limits: Any
    new_force: Any
    weight: Any
    approach: Any
    share: Any
    slider_peak: Any
    peak: Any
    least: Any
    stored_p: Any
    stored_limits: Any


def approach(contact, moved, u, right):
    """Prepare the step problem, from the predicted displacements; ``moved`` is c_K, s."""
    raise NotImplementedError


def before(contact, sigma, force):
    """Friction before a step, over ``contact.weight``: the normalised one or ``contact.force``.

    (Compiled functions can return arrays that are arguments alone.)
    """
    raise NotImplementedError


def at_end(contact, sigma, new_force):
    """The same at its end, of which ``contact.new_force`` takes note."""
    raise NotImplementedError


def add_normal_work(contact, change, dissipated):
    """Add what the scheme takes of the work of normal forces, J, and see to their peaks."""
    raise NotImplementedError


def potential(contact, u):
    """Energy of normal forces at the displacements u, J, as `NormalPart.potential` has it."""
    raise NotImplementedError


def raise_slider_peaks(contact, stretch, slip, out):
    """Raise the largest slips of sliders; ``out``, (rows,), is worked in."""
    raise NotImplementedError


def follow(contact):
    """Take over the forces at the end of a step."""
    raise NotImplementedError


def shares(contact, start, point, value, at_rest, share):
    """Shares of points in the friction limit of their joints: ``at_rest``, or ``share`` of now."""
    raise NotImplementedError


def store_forces(contact, row, point_place):
    """Store a row of fields."""
    raise NotImplementedError


@compiled_for(approach, Constant, inlined=True)
def _nothing_approaches(contact, moved, u, right):
    pass


@compiled_for(before, Constant, inlined=True)
def _normalised_before(contact, sigma, force):
    return sigma


@compiled_for(at_end, Constant, inlined=True)
def _normalised_at_end(contact, sigma, new_force):
    return sigma


@compiled_for(add_normal_work, Constant, inlined=True)
def _add_no_normal_work(contact, change, dissipated):
    pass


@compiled_for(potential, Constant, inlined=True)
def _no_potential(contact, u):
    return 0.0


@compiled_for(raise_slider_peaks, Constant, inlined=True)
def _sliders_follow_points(contact, stretch, slip, out):
    pass


@compiled_for(follow, Constant, inlined=True)
def _follow_nothing(contact):
    pass


@compiled_for(shares, Constant, inlined=True)
def _shares_at_rest(contact, start, point, value, at_rest, share):
    return at_rest


@compiled_for(store_forces, Constant, inlined=True)
def _store_nothing(contact, row, point_place):
    pass


@compiled_for(approach, Opening, inlined=True)
def _approach(contact, moved, u, right):
    combine_rows(contact.N, u, contact.approach)
    for i in range(right.size):
        right[i] += contact.rest[i]
    for c in range(contact.bound.size):
        contact.bound[c] = (contact.apart[c] - contact.approach[c]) / moved


@compiled_for(before, Opening, inlined=True)
def _force_before(contact, sigma, force):
    return force


@compiled_for(at_end, Opening, inlined=True)
def _force_at_end(contact, sigma, new_force):
    for i in range(sigma.size):
        new_force[i] = contact.w[i] * sigma[i]
    return new_force


@compiled_for(add_normal_work, Opening, inlined=True)
def _add_normal_work(contact, change, dissipated):
    """As `NormalPart.work_left` has it."""
    combine_rows(contact.N, change, contact.approach)
    for c in range(contact.p.size):
        new, old = contact.pressing[c], contact.p[c]
        dissipated[1] += (
            0.5 * (old + new) * (contact.approach[c] - (new - old) / contact.stiffness[c])
        )
        contact.peak[c] = max(contact.peak[c], new)
        contact.least[c] = min(contact.least[c], new)


@compiled_for(potential, Opening, inlined=True)
def _potential(contact, u):
    energy = -contact.at_rest
    for i in range(u.size):
        energy -= contact.rest[i] * u[i]
    for c in range(contact.pressing.size):
        energy += contact.pressing[c] ** 2 / (2.0 * contact.stiffness[c])
    return energy


@compiled_for(raise_slider_peaks, Opening, inlined=True)
def _raise_slider_peaks(contact, stretch, slip, out):
    if contact.slider_peak.size > 0:
        for i in range(out.size):
            out[i] = slip[i] - stretch[i] * contact.new_force[i]
        raise_to_norms(contact.slider_peak, out)


@compiled_for(follow, Opening, inlined=True)
def _follow(contact):
    for c in range(contact.p.size):
        contact.p[c] = contact.pressing[c]
    for i in range(contact.force.size):
        contact.force[i] = contact.new_force[i]
    for k in range(contact.limits.size):
        contact.limits[k] = contact.w[k]


@compiled_for(shares, Opening, inlined=True)
def _shares_now(contact, start, point, value, at_rest, share):
    for k in range(start.size - 1):
        whole = 0.0
        for e in range(start[k], start[k + 1]):
            whole += value[e] * contact.limits[point[e]]
        for e in range(start[k], start[k + 1]):
            own = value[e] * contact.limits[point[e]]
            share[e] = own / whole if whole > 0.0 else 0.0
    return share


@compiled_for(store_forces, Opening, inlined=True)
def _store_forces(contact, row, point_place):
    for c in range(contact.p.size):
        contact.stored_p[row, c] = contact.p[c]
    for j in range(point_place.size):
        contact.stored_limits[row, j] = contact.limits[point_place[j]]
