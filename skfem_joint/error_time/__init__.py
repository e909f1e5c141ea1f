"""Error against run time: our models and ready-made integrators on one scene, with a reference."""
