"""Values of a structure from measured curves.

`measured_table` reads tables, `measured` makes curves of them and `damping_curve` makes them of a
signal. `fit_model` is the structure as a function of its free values, and `fit` finds these, their
uncertainty and curves with bands.
"""
