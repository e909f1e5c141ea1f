"""Time integration: implicit steps of any system, full, condensed or reduced.

`integrate` is the entry: its arguments make a `plan`, and `driver` follows it. `arrangement` finds
the unknowns in which a system is stepped and the kind of its matrices; `steppers` advances it by
step problems (`skfem_joint.minimise`), in Python or in the compiled loop of `time_loop`. `schemes`
defines a step, `energy` its works and peaks, `recording` what a run keeps, `load_steps` where loads
cut steps, `resolution` whether steps are short enough, `checkpoint` how an interrupted run is
resumed. `steady` finds steady vibration, `marching` that with contact that opens,
`quasi_static` the response without inertia.
"""
