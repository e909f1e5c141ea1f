"""The step problem: minimise 1/2 v H v - g v + sum w psi(|B v|) + sum phi(N v), and its methods.

`problem` states it and what its solvers have in common; `law` has the law of friction, whose slope
and potential psi are used by all; `limits` says how friction limits follow normal forces where
contact opens. The methods, of which `stepping.arrangement` chooses one: `front_elimination` with
`minty_newton` (chains), `contact_newton` with `condensed_newton` and `contact_loops` (systems whose
slips and approaches are unknowns; `touching` says which points touch, `mean_approaches` makes means
of unknowns the approaches), `primal_dual_newton` with `dense_loop` and
`dense_pressures` (few unknowns). `line_search` is in common. `linearisation` gives the change of a
solution with forces, offsets, limits and bounds.
"""
