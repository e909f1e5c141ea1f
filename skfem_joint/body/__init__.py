"""Elastic bodies of any dimension on a mesh.

`nodes` are those of the displacement, `assembly` has the bilinear forms of mass and stiffness that
scikit-fem assembles, `body` makes mass, stiffness and stress of them; `checks` refuses names and
words that are not known, `named_parts` says what the names of a mesh stand for.
"""
