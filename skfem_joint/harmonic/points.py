"""Results of a periodic motion that harmonic balance has found, as steady vibration has them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.harmonic.balance import Balance
from skfem_joint.harmonic.contact_forces import Sampled
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.results.loss import Losses
from skfem_joint.system.contacts import Contact
from skfem_joint.vibration.response import HARMONICS, phases_of
from skfem_joint.vibration.response_curve import SteadyPoint

#: Samples of a period in which peaks are looked for: they miss 1e-5 of a first harmonic.
SAMPLES = 720
#: Relative change of friction in a period beyond which a note says that it is not periodic.
RESTLESS = 1e-6


def point_of(balance: Balance, q: FloatArray, omega: float, force: FloatArray) -> SteadyPoint:
    """Results of a motion with coefficients ``q`` (nh, n) under a ``force`` of the same shape."""
    series, system = balance.series, balance.system
    contact = system.contact
    work, slip, strain = contact_of(balance, q, balance.sampled(q, False))
    place, speed, *_ = state_of(balance, q, omega)
    q, way = balance.parted(q)
    u = balance.outer(q)
    every = FourierSeries(max(series.highest, HARMONICS), SAMPLES, False)
    seen = every.of(u @ as_dense(system.P).T, series)
    course = every.basis @ seen
    high, low = course.max(axis=0), course.min(axis=0)
    harmonics = (seen[1::2] - 1j * seen[2::2])[:HARMONICS].T
    rate = series.rate(q)
    viscous = float(omega * series.work(rate @ balance.C, q).sum())
    if way is not None:
        viscous += float(omega * (way @ balance.C @ way)) / (2.0 * np.pi)
    motion, moved = series.basis @ u, contact.slid(work)
    period = 2.0 * np.pi / omega
    return SteadyPoint(
        frequency=1.0 / period,
        amplitude=0.5 * (high - low),
        offset=0.5 * (high + low),
        harmonics=harmonics,
        phase=phases_of(harmonics, system),
        slip=slip,
        friction_energy=float(work.sum()),
        input_energy=float(series.work(force, q).sum()),
        share=float(system.slipping_share(moved, period)),
        gross=system.slips_as_a_whole(moved, period),
        losses=Losses(
            np.asarray(work.sum()),
            np.asarray(viscous),
            np.asarray(strain),
            np.asarray(contact.J @ work),
        ),
        friction_work=work,
        state=(place, speed),
        course=np.vstack([motion, motion[:1]]) if not series.odd else None,
    )


def notes_of_law(contact: Contact) -> Iterator[str]:
    """Note of an arctangent law, in the place of which Coulomb's acts."""
    beta = contact.beta[contact.rubs & np.isfinite(contact.beta)]
    if beta.size:
        yield (
            "the curve is of Coulomb's law. The arctangent law of this model, with beta = "
            f"{beta.min():.3g} s/m, lets points creep where they would stick. A ring-down and "
            "response have it."
        )


def notes_of_restless(restless: float) -> Iterator[str]:
    """Note of friction whose largest relative change in a period, after 100 of them, is given."""
    if restless > RESTLESS:
        yield (
            "friction along two directions is not periodic after 100 periods where it hardly "
            f"slips, and changes by {100.0 * restless:.2g} % from one to the next: results are "
            "those of the last one. Time steps from there show where it ends."
        )


def contact_of(
    balance: Balance, q: FloatArray, sampled: Sampled
) -> tuple[FloatArray, FloatArray, float]:
    """Friction energy (m,), J, slip (m,), m, and largest strain energy, J, of a motion."""
    series, system = balance.series, balance.system
    contact, K = system.contact, as_dense(system.K)
    rows = contact.on_rows(contact.rubs)
    springs = contact.on_rows(contact.spring_constants)[rows, np.newaxis]
    moved, friction = sampled.moved, sampled.friction
    by_row, reach = np.zeros((2, rows.size))
    q, way = balance.parted(q)
    by_row[rows] = series.work((friction @ series.projection).T, sampled.slip.T)
    if way is not None:
        by_row[rows] += friction.mean(axis=1) * (balance.contact.rows[: len(friction)] @ way)
    if series.odd:
        moved = np.hstack([moved, -moved])
    reach[rows] = np.ptp(moved, axis=1)
    held = 0.5 * (friction**2 / springs).sum(axis=0)
    strain = max(
        0.5 * x @ (K @ x) + contact.normal.potential(x) + float(h)
        for x, h in zip(series.basis @ balance.outer(q), held, strict=True)
    )
    return contact.by_point(by_row), 0.5 * contact.slip_norm(reach), float(strain)


def state_of(balance: Balance, q: FloatArray, omega: float) -> tuple[FloatArray, ...]:
    """State at the start of the period, as `integrate` takes it, with friction and limits."""
    series, contact = balance.series, balance.system.contact
    sampled, (q, way) = balance.sampled(q, False), balance.parted(q)
    rows = contact.on_rows(contact.rubs)
    friction = np.zeros(rows.size)
    friction[rows] = sampled.friction[:, 0]
    u = balance.outer(q)
    start = series.basis[0] @ u
    limits = contact.limits(contact.normal.elastic_forces(start))
    over = contact.on_rows(limits)
    sigma = np.divide(friction, over, out=np.zeros_like(friction), where=over > 0.0)
    size = contact.on_rows(contact.slip_norm(sigma)) * (1.0 + 1e-12)  # round-off is refused
    sigma /= np.maximum(size, 1.0)
    rate = series.basis[0] @ series.rate(u)
    if way is not None:
        rate = rate + balance.outer(way) / (2.0 * np.pi)
    state = start, omega * rate, sigma
    return (*state, limits) if contact.opens else state
