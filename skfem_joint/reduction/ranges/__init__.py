"""One reduced model for a range of slip, frequency and friction limits.

`model` makes it, and finds the load that makes the first joint slip as a whole; `stuck` has the
structure with its joints stuck, where that search begins. `training` follows static slip paths at
points spread over the range and pools their modes. `points` takes the system of one point. How far
a run of a point errs is estimated in `skfem_joint.accuracy.range_modes`, by the larger model that
such a model carries.
With contact that opens factors on limits are those on the coefficient of friction, and what models
are judged by is a condensed one. ``docs/theory/ranges.md`` has the method with its formulas.
"""
