"""Matrices as other finite-element programs write them.

`reading` tells formats apart by the content of a file and reads one of its matrices; `abaqus`,
`triples` (CalculiX, and Abaqus in coordinates), `op4`, `dmig` and `ansys_full` have the formats,
`numbers` the numbers in their texts, `bulk_data` Nastran's entries, which its meshes have too.
`given` is what they return, `labels` the nodes and directions of unknowns, `symmetry` completes
halves. `model` puts several matrices in one order, `massless`
eliminates internal unknowns, `units` converts to SI, `modes` says up to which frequency
fixed-interface modes serve.
"""
