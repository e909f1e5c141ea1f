"""The paper's scaled modes: modes of a reference joint, stretched over the active length of others.

`reference` has the paper's reference system and its modes on a unit active length, `zones` the ends
of joints where force enters and their active lengths, `estimated_length` Eqs. (17)-(20) for these,
`basis` the modes scaled along each zone, and `gauss` the friction points along lines.

All this holds for loads that pull along the axes of the joints: the joints do not bend. The default
basis, of the static slip path, knows no such limit. Only `skfem_joint.study.models` uses
this folder.
"""
