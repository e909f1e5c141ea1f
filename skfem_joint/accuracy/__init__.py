"""Estimated errors of runs, by the source of error.

`run_estimate` is `estimate` for users. Better models are the rungs of a `ladder`, which says what
each source of error changes and leaves; `rungs` builds them for each kind of model, with
`condensed_reference` and `range_modes`. `estimate` is the result, `against_coulomb` measures the
distance from Coulomb's law.
"""
