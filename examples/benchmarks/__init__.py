"""What a step costs, and the same problem in the hands of ready-made integrators."""
