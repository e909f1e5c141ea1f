"""Structures: bodies, supports, joints and loads, and the `System` that they make.

`structure` is one on a mesh, `matrices` one of given matrices, `model` what both have in common.
`load` makes vectors of loads, `iwan` a whole joint of sliders in parallel, `reactions` the change
of normal forces by vibration. `parameters` reads and changes single numbers by their keys,
`sensitivities` derives the system by them.
"""
