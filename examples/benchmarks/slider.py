"""An elastic slider whose normal load varies in time, beside the closed form of its loop.

    python examples/benchmarks/slider.py [--quick]

A point is driven by X sin(2 pi t). A spring holds it to a slider, whose friction limit is that of
the present normal load, N + V sin(2 pi t + phase), or zero where contact is open. In phase the
energy of a cycle has a closed form; at other phases the force of the spring is followed in small
increments. Slow cycles and vibration, far below the first natural frequency, are compared with it.
"""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import head, row

# isort: split

import numpy as np
from scipy import sparse

import skfem_joint as sj

#: Stiffness of the spring, N/m, amplitude of the slip, m, friction, and constant normal load, N.
SPRING, X, MU, PRESSED = 2e5, 1e-3, 0.4, 250.0
#: Stiffness of what prescribes the slip and of what holds the faces apart, N/m; mass, kg.
HOLDS, LIFTS, MASS = 1e10, 1e3, 1e-3


def slider(varies, phase, spring=SPRING):
    """System of a point driven by X sin(2 pi t) under PRESSED + varies sin(2 pi t + phase), N."""
    N, one = sparse.csr_array([[0.0, 1.0]]), np.ones(1)
    pressed = sj.NormalPart(N, gap=0.0 * one, force=PRESSED * one, stiffness=np.inf * one, area=one)
    K, M = sparse.diags_array([HOLDS, LIFTS]).tocsr(), MASS * sparse.eye_array(2, format="csr")
    loads = [
        sj.AppliedLoad(np.array([1.0, 0.0]), sj.Harmonic(HOLDS * X, 1.0), "along"),
        sj.AppliedLoad(np.array([0.0, 1.0]), sj.Harmonic(varies, 1.0, phase), "across"),
    ]
    B, gain = sparse.csr_array([[1.0, 0.0]]), sparse.csr_array([[MU]])
    contact = sj.Contact(B, [0.0], np.inf, stiffness=spring * one, normal=pressed, gain=gain)
    P, points = sparse.eye_array(2, format="csr"), ("along", "across")
    return sj.System(M, 1e-3 * M, K, contact, loads=loads, P=P, points=points)


def loop_energy(varies, slip=X):
    """Of a cycle with slip and normal load in phase, J: the slider turns where its way does.

    ``slip`` is its amplitude, m.

    With s = sin(2 pi t) the force rises by SPRING slip s until it is MU (PRESSED + varies s), and
    falls so until it is the opposite of that.
    """
    k, n, a = SPRING * slip, MU * PRESSED, MU * varies
    up, down = (2.0 * n - a - k) / (k - a), (k - 2.0 * n - a) / (k + a)
    low, high = -(n - a), n + a

    def sliding(s):
        """Integral of the limit."""
        return n * s + 0.5 * a * s**2

    rising = low * (up + 1.0) + 0.5 * k * (up + 1.0) ** 2 + sliding(1.0) - sliding(up)
    falling = high * (1.0 - down) - 0.5 * k * (1.0 - down) ** 2 - (sliding(down) - sliding(-1.0))
    return slip * (rising - falling)


def followed(varies, phase, cycles, steps, fine=50):
    """Force of the slider at each step, N: its increments, cut to the limits of the time.

    ``fine`` increments are in a step. Returns the energy of the last cycle, J, too.
    """
    turns = 2.0 * np.pi * np.linspace(0.0, cycles, cycles * steps * fine + 1)
    limit = MU * np.maximum(PRESSED + varies * np.sin(turns + phase), 0.0)
    force = np.zeros(turns.size)
    ways = np.diff(X * np.sin(turns))
    for j, way in enumerate(SPRING * ways, 1):
        force[j] = min(max(force[j - 1] + way, -limit[j]), limit[j])
    last = steps * fine
    energy = 0.5 * (force[-last - 1 : -1] + force[-last:]) @ ways[-last:]
    return force[::fine], float(energy)


def main(arguments):
    steps = (50,) if "--quick" in arguments else (50, 100, 200, 400)
    print("Energy of a cycle of an elastic slider under a normal load that varies in time\n")
    head(
        *("load varies by, of its mean", "phase, degrees", "energy of a cycle, mJ", "from"),
        *(f"slow cycle, {n} steps, %" for n in steps),
        *(f"vibration, {n} steps, %" for n in steps),
    )
    for varies, phase in ((0.0, 0.0), (0.6, 0.0), (0.6, 90.0), (0.6, 180.0), (1.4, 60.0)):
        load, angle = varies * PRESSED, np.radians(phase)
        known = loop_energy(load) if phase == 0.0 else followed(load, angle, 3, 400)[1]
        system, cells = slider(load, angle), []
        for solve in (sj.quasi_static, sj.integrate):
            for n in steps:
                run = solve(system, cycles=3, steps_per_cycle=n)
                cells.append(f"{100 * (run.cycles.friction[-1] / known - 1.0):+.3f}")
        source = "closed form" if phase == 0.0 else "20,000 increments a cycle"
        row(f"{varies:g}", f"{phase:g}", f"{1e3 * known:.3f}", source, *cells)


if __name__ == "__main__":
    main(sys.argv[1:])
