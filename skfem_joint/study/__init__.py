"""From a scene to its results: each command is a row of public functions.

`study` runs a scene's models: `scene_plan` makes plan and bases, `description` says what the
structure is, `accuracy` and `range_choice` choose models for an accuracy, `models` are the results,
`summary` puts them into numbers and sentences. `scene_backbone`, `scene_response` and `scene_range`
do the same for their tables, `backbone_peaks` compares both curves. `error_time` compares many
models with the reference of `certificate`, `against_opening` both kinds of contact; `sweep` runs
many scenes.
"""
