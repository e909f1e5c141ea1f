"""Time integration: implicit steps of any system, full, condensed or reduced.

`integrate` is the entry: its arguments make a `plan`, and `driver` follows it. `arrangement` finds
the unknowns in which a system is stepped and the kind of its matrices; `steppers` advances it by
step problems (`skfem_joint.minimise`), in Python or in the compiled loop of `time_loop`;
`normal_forces` is what a step has beside where contact opens. `schemes` defines a step, `energy`
its works and peaks, `recording` what a run keeps, `load_steps` where loads cut steps, `resolution`
whether steps are short enough, `checkpoint` how an interrupted run is resumed, `stopwatch` what
took its time.

Steady vibration: `steady` finds the state that a period brings back, `marching` does where contact
opens; `shooting` goes through the periods. `advanced` has the states that steps depend on alone,
`transition` and `chain_transition` how the end of a period depends on its start. A smaller model
may help by `correction`; `warp` makes the trapezoidal rule exact at the frequency of the load.

Without inertia: `levels` says what is known of a level of the loads and what a solver of levels
does, `quasi_static` is this solver, `slow_run` makes a run of its levels, `loops` their hysteresis
loops, and `level_rates` derives what it finds by parameters.
"""
