"""`System`, the type of all models: ``M a + C v + K u + B^T (w sigma(B v)) = f(t)``.

`system` is that type and its projection, `contacts` its contact points, of which `normal` is the
part that opens. `slips` has the rows of contact that users and structures give, and makes a
`Contact` of them; `unknowns` changes to unknowns among which the slips are. `modes` are natural
modes of matrices and Rayleigh damping by a ratio, `modal_response` follows them under loads,
`sensitivity` is the derivative of a system by a parameter, `served` says which range a reduced
model serves, `system_files` keeps systems in files.
"""
