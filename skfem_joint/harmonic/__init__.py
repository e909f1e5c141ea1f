"""Harmonic balance: periodic motions into gross slip, of reduced and small models.

A `balance` takes the harmonics of a motion, a `series`, to its residual and derivatives, with
`contact_forces` by one compiled pass (`contact_loop`) over its periods. `newton` solves equations,
such as the `mode_equations` of a nonlinear mode or `forced` ones, and follows their branches.
`modes` is the way of a mode: its `levels` are met by a branch, found again with stiffer sticking
and more harmonics, judged by time steps (`marched`), and become a `curve`.

`response` follows steady vibration of `forced` equations over frequency: `search` finds branches,
raises harmonics and marches, `points` are results at a frequency, `stability` is Hill's.
"""
