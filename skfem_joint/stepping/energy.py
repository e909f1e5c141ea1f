"""The bookkeeping of a step: works, dissipation and peaks.

Works of a step use the trapezoidal means of the forces at its ends times the change of
displacement. With the equation of motion holding at both ends this closes the energy balance to
round-off for any one-step scheme:

    change of stored energy = input - viscous - friction - scheme,
    scheme = (du - h vm) M am + vm M (h am - dv),

with vm and am the mean velocity and acceleration: what the scheme's own kinematics dissipates,
zero for the trapezoidal rule. Where contact opens, what its points store and what impacts take is
added (`skfem_joint.stepping.normal_forces`, in the compiled loop
`skfem_joint.stepping.loop_contact`), and stored energy has that of springs in series.

Each function runs as it is, on NumPy arrays, for steps that are done in Python, and is compiled
into the loop over steps (:mod:`skfem_joint.stepping.time_loop`). Arrays of slip rows have the first
rows of all points before the second rows of those that have one, which come first among the points
(:func:`skfem_joint.minimise.problem.row_order`).
"""

from __future__ import annotations

from skfem_joint.ground.arrays import FloatArray, IntArray, Matrix
from skfem_joint.linalg.vectors import (
    add_mean_products,
    combine,
    dot,
    largest_at,
    largest_product,
    product,
    weighted_beyond,
)
from skfem_joint.system.slips import SLIPPING_SHARE

#: Share of its limit from which on friction counts as having reached it. The regularised law never
#: reaches it.
AT_LIMIT = 0.99


def add_dissipation(
    M: Matrix,
    C: Matrix,
    h: float,
    trapezoidal: bool,
    change: FloatArray,
    v_mean: FloatArray,
    a_mean: FloatArray,
    v_change: FloatArray,
    image: FloatArray,
    slack: FloatArray,
    dissipated: FloatArray,
) -> None:
    """Add the works of damping and of the scheme, J, to ``dissipated``, (2,).

    Parameters
    ----------
    M, C : matrix
        Mass, kg, and damping, N s/m.
    h : float
        Step, s.
    trapezoidal : bool
        The trapezoidal rule dissipates nothing: then ``a_mean`` and ``v_change`` are not read.
    change, v_mean, a_mean, v_change : ndarray, shape (n,)
        Change of displacement (m), mean velocity (m/s) and acceleration (m/s2) of the ends, change
        of velocity; the last one is overwritten.
    image, slack : ndarray, shape (n,)
        Worked in.
    """
    product(C, v_mean, image)
    dissipated[0] += dot(image, change)
    if not trapezoidal:
        combine(slack, 1.0, change, -h, v_mean)
        product(M, a_mean, image)
        dissipated[1] += dot(slack, image)
        combine(v_change, h, a_mean, -1.0, v_change)
        product(M, v_change, image)
        dissipated[1] += dot(v_mean, image)


def add_input_work(
    loads: Matrix,
    before: FloatArray,
    after: FloatArray,
    change: FloatArray,
    moved: FloatArray,
    work: FloatArray,
) -> None:
    """Add the work of each load, J, to ``work``, (loads,).

    ``loads`` has a load vector in each row, ``before`` and ``after`` are the amplitudes at the ends
    of the step, N; ``moved``, (loads,), is worked in.
    """
    product(loads, change, moved)
    for k in range(work.size):
        work[k] += 0.5 * (before[k] + after[k]) * moved[k]


def add_friction_work(
    w: FloatArray, before: FloatArray, after: FloatArray, slip_change: FloatArray, work: FloatArray
) -> None:
    """Add the work of each point's friction, J, to ``work``, (m,).

    ``w``, ``before`` and ``after`` are friction limits (N) and normalised forces at the ends of the
    step, (rows,); ``slip_change``, (rows,), is in m.
    """
    m, pairs = work.size, work[: w.size - work.size]
    add_mean_products(work, w[:m], before[:m], after[:m], slip_change[:m])
    add_mean_products(pairs, w[m:], before[m:], after[m:], slip_change[m:])


def joint_slips(
    start: IntArray,
    point: IntArray,
    share: FloatArray,
    sliding: FloatArray,
    creep: FloatArray,
    time: float,
    work: FloatArray,
    slip_size: FloatArray,
    force_size: FloatArray,
    largest: FloatArray,
    slipping: FloatArray,
) -> None:
    """Largest slip of each joint, m, and the share of its friction limit whose points slip now.

    Friction has reached its limit there, and the points slip in the sense of `System.slipping`:
    they have slid by more than a thousandth of the largest way, and than they creep at half of
    their limit. Under a law of finite steepness points that creep back after a reversal reach their
    limit, too, and do not slip.

    Parameters
    ----------
    start, point : ndarray of int
        Joint k has the points ``point[start[k]:start[k + 1]]``.
    share, sliding, creep : ndarray, shape of ``point``
        Of these points: share of their joint's limit, quarter of the way they slide by the work of
        their friction (1/N), and slip velocity at half of their limit (m/s).
    time : float
        Time since the start, s.
    work, slip_size, force_size : ndarray, shape (m,)
        Work of friction since the start (J), slip (m) and friction over its limit, by point.
    largest, slipping : ndarray, shape (joints,)
        Results.
    """
    least = SLIPPING_SHARE * largest_product(point, work, sliding)
    for k in range(start.size - 1):
        own = slice(start[k], start[k + 1])
        largest[k] = largest_at(point[own], slip_size)
        slipping[k] = weighted_beyond(
            share[own],
            point[own],
            force_size,
            AT_LIMIT,
            work,
            sliding[own],
            least,
            creep[own],
            time,
        )
