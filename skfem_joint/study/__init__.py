"""From a scene to its results: each command is a row of public functions.

`study` runs a scene's models: `models` gives their plan and makes them, `description` says what the
structure is, `accuracy` chooses models for an accuracy or of a range, `results` holds what was
found, `summary` puts it into numbers and sentences. `scene_backbone`, `scene_response` and
`scene_range` do the same for their tables, `backbone_peaks` compares both curves. `error_time`
compares many models with the reference of `certificate`, `against_opening` both kinds of contact;
`sweep` runs many scenes.
"""
