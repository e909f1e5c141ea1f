"""Slow motion, without inertia: one level of the loads after another.

`levels` says what is known of a level, `quasi_static` solves it for all kinds of contact, and
`level_rates` derives what is found by parameters. Runs of levels are in `runs.slow_run`, cycles of
them in `vibration.cycles`.
"""
