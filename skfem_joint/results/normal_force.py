"""Change of the normal forces by vibration with stuck joints, which constant contact leaves out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.structure.model import AnyStructure
from skfem_joint.structure.reactions import Reactions

#: Change of the normal force over that force that is not small.
LARGE = 0.1


@dataclass(frozen=True)
class NormalChange:
    """Largest change of the normal force on a contact.

    Attributes
    ----------
    share : float
        Of the normal force that presses there at rest.
    text : str
        The same in words, with its place.
    mean : float
        Largest changes of all nodes, added up, over the whole normal force at rest.
    """

    share: float
    text: str
    mean: float

    @classmethod
    def of(cls, structure: AnyStructure, acts: Reactions, most: FloatArray) -> NormalChange:
        """By the largest changes ``most`` (k,), N, of the reactions."""
        share = most / acts.force
        worst = int(share.argmax())
        where = structure.pressed_at(int(acts.dof[worst]))
        text = f"{100.0 * share[worst]:.3g} % of what presses it, most in {where}"
        return cls(float(share[worst]), text, float(most.sum() / acts.force.sum()))

    @property
    def of_the_mesh(self) -> str:
        """Sentence about how the change depends on the mesh, with the mean, which does less.

        The lap is that of two plates of 10 mm seen from the side, bent by a force at its end, with
        1, 2, 4 and 8 quadratic elements for each 20 mm of the contact.
        """
        return (
            "That is the largest of single nodes, which rises as the mesh is refined (11, 23, 79 "
            "and 163 % on four meshes of one lap, each of half the size); over the whole contact "
            f"it is {100.0 * self.mean:.2g} % on average."
        )

    def doubts(self, when: str = "", what: str = "Vibration of the stuck structure") -> list[str]:
        """What is doubtful if the change, by ``what``, is large; ``when`` begins the sentence."""
        if self.share <= LARGE:
            return []
        subject = f"{what[0].lower()}{what[1:]}" if when else what
        return [
            f"{when}{subject} would change the normal force by {self.text}: that it stays as the "
            "clamping makes it, which constant contact assumes, is doubtful there. Above "
            f"{100.0 * LARGE:.3g} % set contact = 'unilateral' in that [[joint]]. "
            f"{self.of_the_mesh}"
        ]


def normal_change_of_mode(
    structure: AnyStructure, acts: Reactions | None, shape: FloatArray, frequency: float, q: float
) -> NormalChange | None:
    """Change by a mode ``shape`` (n,) of a frequency, Hz, at the modal amplitude q, m kg^1/2.

    None where no contact is closed.
    """
    if acts is None:
        return None
    change = acts.K @ shape - (2.0 * np.pi * frequency) ** 2 * (acts.M @ shape)
    return NormalChange.of(structure, acts, q * np.abs(change))
