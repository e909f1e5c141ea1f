"""Scenes: all that a run needs, read from a TOML file and checked as a whole before it runs.

The tables (SI units, unknown keys are errors, NaN and infinity are refused everywhere) say what a
scene says by itself; the structure that is built from them says what only the mesh can tell. Every
mistake found becomes one line, ::

    scene.toml: load[0].frequency: found -5, must be > 0

and all of them are raised together as one `InputError`.
"""

from skfem_joint.scene.reading import Swept, load_scene, load_sweep, scene_from
from skfem_joint.scene.scene import Scene

__all__ = ["Scene", "Swept", "load_scene", "load_sweep", "scene_from"]
