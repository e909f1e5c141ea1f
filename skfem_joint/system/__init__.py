"""`System`, the type of all models: ``M a + C v + K u + B^T (w sigma(B v)) = f(t)``.

`system` is that type and its projection, `contacts` its contact points, of which `normal` is the
part that opens. `slips` are rows of contact to make one of, whatever the matrices come from;
`unknowns` changes to unknowns among which the slips are. `modes` are natural modes of matrices and
damping by a ratio, `modal_response` follows them under loads, `sensitivity` is the derivative of a
system by a parameter, `served` says which range a reduced model serves, `system_files` keeps
systems in files.
"""
