"""Dynamics of bolted joints with micro-slip friction: a finite-element plugin on scikit-fem."""

__version__ = "0.1.0"
