"""A bar clamped by a joint, whose last part may be heavier than the rest."""

from bodies import structure

import skfem_joint as sj


def tipped_bar(load: sj.Load, tip: float = 8000.0, elements: int = 40) -> sj.System:
    """Bar of 0.6 m; density of its last 20 mm, and elements in its joint and its arm."""
    strips = [("joint", 0.1, elements), ("arm", 0.48, elements), ("tip", 0.02, 2)]
    made = structure(
        sj.build_bar(strips, {"fixed": 0.0, "end": 0.6}), [sj.Joint("joint", 50e6, 0.7)],
        ["fixed"], regions={"tip": {"density": tip}}, damping_ratio=0.002,
    )  # fmt: skip
    return made.system([load], points=["end"])
