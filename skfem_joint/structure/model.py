"""Structures, whether given on a mesh or by matrices."""

from typing import TypeAlias

from skfem_joint.structure.matrices import MatrixModel
from skfem_joint.structure.structure import Structure

#: A jointed structure, given by a mesh or by matrices. Functions that need geometry use the
#: `Structure` that `meshed` returns, or the ``body``, which is None if it is given by matrices.
AnyStructure: TypeAlias = Structure | MatrixModel
