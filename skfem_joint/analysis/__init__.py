"""Running the models of a scene, what their runs say, how accurate they are and what they cost.

A scene: `study` calls one step of the analysis after the other; `models` has their results;
`scene_plan` turns the scene into a plan and a basis; `description` says what its structure is
before it is run; `accuracy` chooses time steps and a reduced model for an accuracy; `summary`
collects numbers and warnings.

A run: `history` (loops, stick and slip, distances between runs), `contact_history`, `stress`,
`active_region`.

Its errors: `estimate` (of every result), `certificate` (mesh and law as well), `error_time` (errors
against run time).

A system: `natural_modes`; `backbone` (damping over amplitude) with `cycles`, `gross_slip` and
`backbone_sensitivity`; `ring_down`; `response` (steady vibration over frequency) with
`linear_response`. `scene_backbone` and `scene_response` do this for a scene's models; `sweep` runs
many scenes; `rows` keeps finished work.

A measurement: `damping_curve` (of a free vibration); `measured` (curves in files and arrays) with
`measured_table`; `fit` (values that fit such curves) with `fit_model` and `fit_curves`.
"""
