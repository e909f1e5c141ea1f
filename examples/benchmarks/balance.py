"""Steady vibration by harmonic balance: pyHarm (Safran, ``pyharm-os``), for systems of arctan law.

pyHarm has neither our friction law nor slip rows. Here all friction is a single element, which goes
from frequency to time and back by pyHarm's own operators. Newton's method takes all unknowns, which
is faster here than condensation on the joint, and faster than SciPy's hybrid method.
"""

import logging
import math
import os
import warnings
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.linalg import block_diag

# The place of pyHarm's settings, which would otherwise be the current folder.
os.environ.setdefault("PYHARM_CONTEXT_FILE", str(Path.home() / ".pyHarm" / "context.json"))
import pyHarm
from pyHarm.Elements.ABCElement import ABCElement

from skfem_joint.ground.errors import ConvergenceError


class Arctan(ABCElement):
    """Friction ``w * 2/pi * atan(beta v)`` between nodes and the ground."""

    factory_keyword = "arctan"

    def __init_data__(self, name, data, CS):
        self.name, self.nodes = name, data["nodes"]
        self.w, self.beta = data["w"][:, np.newaxis], data["beta"][:, np.newaxis]

    def __flag_update__(self):
        self.flag_nonlinear = self.flag_AFT = True

    def __str__(self):
        return str(self.name)

    def adim(self, lc, wc):
        """Change to other units of length and angular frequency."""
        self.beta = self.beta * lc * wc

    def generateIndices(self, expl_dofs):
        """Find the unknowns of each node: cosine and sine of each harmonic."""
        indices_of_nodes = [expl_dofs.index[expl_dofs.node_num == n] for n in self.nodes]
        self.indices = np.concatenate(indices_of_nodes)

    def _rate(self, x):
        """Velocity over angular frequency at the samples of a period, shape (nodes, times)."""
        q = x[self.indices].reshape(len(self.nodes), -1)
        return np.asarray(q @ self.nabla.T @ self.D["ft"])

    def evalResidual(self, x, om):
        """Harmonics of the friction force."""
        force = self.w * (2.0 / math.pi) * np.arctan(self.beta * om * self._rate(x))
        return np.asarray(force @ self.D["tf"]).ravel()

    def evalJacobian(self, x, om):
        """Derivatives of the harmonics by the unknowns and by the angular frequency."""
        rate = self._rate(x)
        slope = self.w * self.beta * (2.0 / math.pi) / (1.0 + (self.beta * om * rate) ** 2)
        there, back = self.D["tf"].T, om * self.D["ft"].T @ self.nabla
        blocks = [(there * slope_at_node) @ back for slope_at_node in slope]
        return block_diag(*blocks), np.asarray((slope * rate) @ self.D["tf"]).ravel()


pyHarm.pyHarm_plugin(Arctan)


def balanced(system, harmonics):
    """Amplitude (m) of the first harmonic at the node that a sine pulls.

    ``system`` is one whose slip rows pick one unknown each. `ConvergenceError`: Newton's method
    does not converge.
    """
    (load,) = system.loads
    force, omega = load.amplitude.amplitude, 2.0 * math.pi * load.amplitude.frequency
    end = int(np.flatnonzero(load.vector)[0])
    nodes = sparse.csr_array(system.contact.B).indices
    # Newton's method ends at this residual (N) and this change of an unknown (m).
    newton = {"tol_residual": 1e-6 * force, "tol_delta_x": 1e-9, "max_iter": 100}
    pull = {"type": "SinusForcing", "connect": {"bar": [end]}, "dirs": [0], "amp": force}
    study = {"study": "frf", "solver": "NewtonRaphson", "solver_options": newton}
    study |= {"puls_inf": omega, "puls_sup": omega}
    law = {"type": "arctan", "nodes": nodes, "w": system.contact.w, "beta": system.contact.beta}
    matrices = {name: getattr(system, name).toarray() for name in "MCK"}
    task = {
        "system": {"type": "Base", "nh": harmonics, "nti": 128},  # times in a period
        "substructures": {"bar": {"ndofs": 1, "matrix": matrices}},
        "connectors": {"pull": pull, "friction": law},
        "analysis": {"one": study},
    }
    logging.disable(logging.INFO)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of its compiled loops, about speed
            peer = pyHarm.Maestro(task)
            peer.nls["one"].initialise()  # the first frequency; further ones would follow a curve
    finally:
        logging.disable(logging.NOTSET)
    (solution,) = peer.nls["one"].SolList
    if not solution.flag_accepted:
        raise ConvergenceError("pyHarm: Newton's method did not converge")
    dofs = peer.system.expl_dofs
    return float(np.hypot(*solution.x[dofs.index[(dofs.node_num == end) & (dofs.harm == 1)]]))
