"""Running the models of a scene, what their runs say, how accurate they are and what they cost.

A scene: `study` puts the passes in a row; `models` has their results; `asked` turns the scene into
a plan and a basis; `description` says what its structure is before it is run; `accuracy` chooses
steps and a reduced model for an accuracy; `reduced_models` makes the basis; `summary` collects
numbers and warnings; `memory` estimates what the results take.

A run: `history` (loops, stick and slip, distances between runs), `contact_history`, `stress`,
`active_region`.

Its errors: `estimate` (of every result), `certificate` (mesh and law as well), `error_time` (errors
against run time).

A system: `natural_modes`; `backbone` (damping over amplitude) with `gross_slip`, `own_law_damping`
and `saved_path`; `ring_down`; `response` (steady vibration over frequency) with `linear_response`
and `step_errors`. `scene_backbone` and `scene_response` do this for a scene's models; `sweep` runs
many scenes; `rows` keeps finished work.
"""
