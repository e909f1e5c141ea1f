"""Running the models of a scene, what their runs say, how accurate they are and what they cost."""
