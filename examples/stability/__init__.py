"""Stiff and extreme cases: each is computed right, or refused with a reason."""
