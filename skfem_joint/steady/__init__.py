"""Steady vibration: the state that a period of the loads brings back.

`steady` finds it by Newton's method and mixing, `marching` where contact opens; `runs.steady_run`
goes through the periods. How the end of a period depends on its start is in `transition` and, for
chains, `chain_transition`; `advanced` has the coordinates of the states. A smaller model may help
by `correction`.
"""
