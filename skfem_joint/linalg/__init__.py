"""Linear algebra: compressed rows, factors, Schur complements, shifts.

`compressed` (rows of sparse matrices as arrays), `bands` (factors along a band), `factors` (of any
pattern, SuperLU or PARDISO), `fill` (what a factor takes, from its pattern), `schur` (some unknowns
eliminated), `eliminated` (a changing set of them), `shifts` (a stiffness that leaves rigid motions,
made regular), `vectors` and `kernels` (compiled loops).
"""
