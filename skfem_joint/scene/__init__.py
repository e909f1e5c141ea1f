"""Scenes: everything that a run needs, read from a TOML file and checked before it runs.

`scene` has the whole scene and builds its structure and system; `tables`, `joint_tables`,
`matrices`, `range_table` and `sweep_table` have its tables, with the keys and their meanings;
`unknowns` finds those of matrices by number or name; `values` has the types of values; `reading`
reads files; `messages` words mistakes; `keys` is the reference of keys; `changes` makes scenes with
other values, `rewriting` puts them into a scene's text; `shipped` has the scenes that come with the
package.

All units are SI units. Unknown keys, NaN and infinity are refused. The tables check everything that
does not depend on the mesh; the structure that is built from them checks the rest. Each mistake is
one line, ::

    scene.toml: load[0].frequency: found -5, must be > 0

and all mistakes are raised together as an `InputError`.
"""

from skfem_joint.scene.reading import Swept, load_scene, load_sweep, scene_from
from skfem_joint.scene.scene import Scene

__all__ = ["Scene", "Swept", "load_scene", "load_sweep", "scene_from"]
