"""Time integration: implicit steps of any system, full, condensed or reduced.

`integrate.integrate` is the way in. `arrangement` gives a system the order of unknowns and the
stepper that its matrices allow: `steppers` holds those of large sparse systems, `chain` that of
tridiagonal and `dense` that of reduced ones. `recording` says what a run keeps, `schemes` what a
step is, `resolution` how long it may be, `checkpoint` how a run that was killed goes on. `march`
is the compiled loop over steps, `compiled` what compiled functions share.
"""
