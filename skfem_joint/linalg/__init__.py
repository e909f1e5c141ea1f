"""Linear algebra: compressed rows, factors along bands and of any pattern, Schur complements."""
