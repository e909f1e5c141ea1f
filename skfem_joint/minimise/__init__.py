"""The step problem: minimise 1/2 v H v - g v + sum w psi(|B v|) + sum phi(N v), and its methods.

`problem` states it and the protocol of its solvers; `law` has the law of friction, whose slope and
potential psi are used by all; `limits` says how friction limits follow normal forces where contact
opens; `choice` chooses the method.
The methods: `front_elimination` with `minty_newton` (chains), `contact_newton` with
`condensed_newton` and `contact_loops` (systems whose slips and approaches are unknowns, of which
`touching` keeps those of points that touch), `primal_dual_newton` with `dense_loop` and
`dense_pressures` (few unknowns). `line_search` is in common; `compiled_step` is the protocol of
those that the compiled time loop calls. `linearisation` gives the change of a solution with
forces, offsets, limits and bounds.
"""
