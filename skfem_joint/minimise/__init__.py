"""The step problem: minimise 1/2 v H v - g v + sum w psi(|B v|), and three methods for it.

`problem` states it and the protocol of its solvers; `law` has the law of friction, whose slope and
potential psi are used by all; `choice` chooses the method. The methods: `front_elimination` with
`minty_newton` (chains), `truncated_newton` with `condensed_newton` and `point_loops` (sparse
systems whose slips are unknowns), `primal_dual_newton` (dense systems, with contact that opens as
well). Other systems with contact that opens have a method of their own, `opening_newton` with
`opening_loops`, on the points that touch (`touching`). `line_search` is in common; `compiled_step`
is the protocol of those that the compiled time loop calls.
"""
