"""Runs: the public `integrate` and `quasi_static`.

`integrate` turns arguments into a plan, `resolution` checks whether its steps are short enough, and
`stepping.driver`, `steady_run` or `slow_run` follows it. `swept_response` runs under a
sine whose frequency changes. `friction_along` is friction along motions that are known already.
"""
