"""Runs: the public `integrate` and `quasi_static`.

`integrate` turns arguments into a plan, `resolution` checks whether its steps are short enough, and
`stepping.driver`, `steady.shooting` or `slow_run` follows it. `friction_along` is friction along
motions that are known already.
"""
