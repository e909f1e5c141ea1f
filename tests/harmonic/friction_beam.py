"""The virtual friction-damped beam, a public benchmark, and its published curve.

Euler-Bernoulli beam of 0.71 m x 60 mm x 50 mm, clamped and free, of 15 nodes, with a Jenkins
element at node 6, reduced to 3 modes with that node fixed; 1 % of viscous damping of stuck modes.
"""

import numpy as np
from scipy import linalg

import skfem_joint as sj

SPRING, LIMIT = 1e7, 15.0
#: First harmonic of the tip (m), frequency (Hz) and damping ratio (%).
TIP = 1e-6 * np.array([6.34, 10.05, 15.76, 24.77, 39.06, 61.76, 97.73, 154.8, 388.6])
FREQUENCY = (80.368, 80.143, 76.055, 72.414, 70.364, 69.258, 68.624, 68.290, 68.041)
DAMPING = (1.000, 1.929, 5.773, 6.465, 5.461, 4.269, 3.312, 2.601, 1.779)


def friction_beam():
    """Its system."""
    nodes, node, length, width, height = 15, 6, 0.71, 0.06, 0.05
    bending, mass = 141.225e9 * width * height**3 / 12.0, 7850.0 * width * height
    h, n = length / (nodes - 1), 2 * nodes
    K, M = np.zeros((n, n)), np.zeros((n, n))
    ends, turn = (
        np.array([12.0, 6 * h, -12.0, 6 * h]),
        np.array([6 * h, 4 * h * h, -6 * h, 2 * h * h]),
    )
    k = np.array([ends, turn, -ends, [6 * h, 2 * h * h, -6 * h, 4 * h * h]])
    m = np.array(
        [
            [156.0, 22 * h, 54.0, -13 * h],
            [22 * h, 4 * h * h, 13 * h, -3 * h * h],
            [54.0, 13 * h, 156.0, -22 * h],
            [-13 * h, -3 * h * h, -22 * h, 4 * h * h],
        ]
    )
    for e in range(nodes - 1):
        own = slice(2 * e, 2 * e + 4)
        K[own, own] += bending / h**3 * k
        M[own, own] += mass * h / 420.0 * m
    K, M = K[2:, 2:], M[2:, 2:]
    held = 2 * (node - 2)
    free = np.delete(np.arange(n - 2), held)
    fixed = linalg.eigh(K[np.ix_(free, free)], M[np.ix_(free, free)], subset_by_index=(0, 2))[1]
    T = np.zeros((n - 2, 4))
    T[held, 0], T[free, 1:] = 1.0, fixed
    T[free, 0] = -np.linalg.solve(K[np.ix_(free, free)], K[free, held])
    K, M, B = T.T @ K @ T, T.T @ M @ T, T[held : held + 1]
    squares, shapes = linalg.eigh(K + SPRING * B.T @ B, M)
    C = M @ shapes @ np.diag(0.02 * np.sqrt(squares)) @ shapes.T @ M
    contact = sj.Contact(B, [LIMIT], np.inf, stiffness=np.array([SPRING]))
    return sj.System(M, C, K, contact, P=T[-2:-1], points=("tip",))
