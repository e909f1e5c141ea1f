"""Dynamics of bolted joints with micro-slip friction: a finite-element plugin on scikit-fem.

The folders of the package; a module imports only from its own folder and those above it:

============  ====================================================================================
ground        errors, arrays, files, loads (force over time), progress, compilation
matrix_files  matrices as Abaqus, CalculiX, Nastran and ANSYS write them
linalg        compressed rows, factors, Schur complements, shifts, compiled kernels
system        `System`, the type of all models, its contact, modes and files:
              ``M a + C v + K u + B^T (w sigma(B v)) = f(t)``
mesh          named meshes of lines, triangles, quadrilaterals, tetrahedra, hexahedra and prisms:
              read, checked, built, merged, refined, written
body          elastic bodies: mass, stiffness, stress
joint         joints, pressure, preload, and the contact manifold with its friction limits
structure     `Structure`, which makes a `System` of bodies and joints; `MatrixModel` for matrices
minimise      the step problem ``1/2 v H v - g v + sum w psi(|B v|)``: the law of friction, the
              protocol, and three methods: front elimination on chains, truncated nonsmooth
              Newton, primal-dual Newton
stepping      time steps: the plan of a run, schemes, steppers, the compiled time loop, energies,
              recording, checkpoints
slow          quasi-static levels and their derivatives
steady        steady vibration
runs          `integrate` and `quasi_static`, and whether a step is short enough
reduction     proper orthogonal modes, the static slip path, bases, fewer friction points,
              condensation, active lengths; in ``scaled`` the paper's scaled modes
scene         the text file that describes a run, checked as a whole, and the reference of its keys
results       slips, stress and active regions of a run, natural modes
accuracy      estimated errors
vibration     damping over amplitude, ring-downs, response over frequency, random vibration
harmonic      harmonic balance: nonlinear modes into gross slip
fitting       measured curves and fits to them
study         scenes, run and compared; error against run time; sweeps of many scenes
output        tables, histories, fields for ParaView, pictures
============  ====================================================================================

How a scene is computed: `scene.load_scene` reads it and `mesh.load_meshes` its mesh. `Structure`
makes the `System`, `runs.integrate` the run, and `reduction` the smaller system, which is run in
the same way. `study.study.run_scene` does all of it, pass by pass, and `output.folder.write` writes
the results. Words and symbols are explained in ``docs/reference/glossary.md``.

The names below are loaded when they are first used.
"""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

__version__ = "0.2.0"

#: Public names by the module that defines them, as the stub of this module imports them.
_MODULE = {
    alias.name: str(node.module)
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}
__all__ = sorted(_MODULE)


def __getattr__(name: str) -> Any:
    if name not in _MODULE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
