"""Linear algebra: compressed rows, factors (of bands and of any pattern), Schur complements."""
