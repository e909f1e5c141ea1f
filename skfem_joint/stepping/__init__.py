"""Implicit time steps of any system, full, condensed or reduced.

`driver` follows a `plan`. `arrangement` finds the unknowns in which a system is stepped, the kind
of its matrices and the method for it; a `stepper` advances it by step problems
(`skfem_joint.minimise`), in Python or in the compiled loop of `time_loop`. What a step has beside
where contact opens is in `normal_forces`, and in `loop_contact` for that loop. `schemes` defines a
step, `energy` its works and peaks, `recording` what a run keeps, `loops` hysteresis loops,
`load_steps` where loads cut steps, `checkpoint` how an interrupted run is resumed, `stopwatch` what
took its time; `warp` makes the trapezoidal rule exact at the frequency of the load.
"""
