"""Reduced models of structures with joints.

`models` is the maker: `reduce` for users, `reduced` for scenes and estimates. It takes a basis of
`sources` and projects the system on it. What a basis is made of: `excitation` (loads of the run to
come), `static_path` (how the joints slip, without a run of the full model), `elastic_contact` (the
same with contact that opens), `stuck` (modes with the contact stuck), `pod` (proper orthogonal
decomposition of snapshots), `interface_modes` (vibration without slip), `joint_slides` (joints that
slip as a whole). `basis` is what all of these end in, `friction_points` leaves fewer contact
points, `missing_modes` finds what a reduced run shows that its basis is missing. `condensed` keeps
all of the contact and reduces the rest; `active_length` measures where joints slip. Models for a
range are in `ranges`, the paper's scaled modes in `scaled`.

From the keys of a scene to modes: `scene.tables.ReductionTable` reads the table ``[reduction]``,
`study.models.options_of` copies it to `basis.Options`, and `study.models.model_of` hands these to
`models.reduced`. What becomes of the key ``interface_modes``:

- "static": `static_path.slip_path` (finds modes by `interface_modes.driven`), then
  `sources.static_basis` (takes the number asked for; if "auto" the max(2, modes // 6) with the
  largest shares, less those that `interface_modes.beside` drops);
- "self": `sources.own_basis` (the lowest modes; none if "auto");
- "paper": `scaled.basis.paper_basis` -> `interface_modes.participating`.
"""
