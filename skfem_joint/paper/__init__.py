"""Tables and figures of the paper, computed anew and set beside their published values."""
