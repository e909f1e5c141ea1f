"""From the joint that a user describes to slip rows B, friction limits w and pressure points N.

`joints` and `clamps` describe and check joints and clamping bolts, `pressure` a given pressure, of
bolts too.
`manifold` is the surface of a joint, `patch` collects its nodes with their normal forces. Under
bolts these forces are found by `preload`, with the pressures of `pressure_space`, the unilateral
contact of `active_set` and the free motions of `rigid`. `contact` makes slip rows and limits, w +=
friction * normal force; where faces may part, `opening` makes the pressure points whose forces
these limits follow. `doubts` are sentences about what is allowed but unusual.
"""
