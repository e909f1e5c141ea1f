"""The step problem: minimise 1/2 v H v - g v + sum w psi(|B v|), and three methods for it."""
