"""The matrix of stiff and extreme cases: bars, then plates."""

from __future__ import annotations

from skfem_joint.stability.bar_cases import BarCase, bars
from skfem_joint.stability.plate_cases import PlateCase, plates
from skfem_joint.stability.problem import Case

#: Bars and plates of a quick matrix, a few on each axis.
QUICK_BARS, QUICK_PLATES = 3, 1


def matrix() -> tuple[Case, ...]:
    """All cases."""
    return (*bars(), *plates())


def quick_matrix() -> tuple[Case, ...]:
    """A few cases of each axis, for a look and for tests."""
    few: dict[str, list[Case]] = {}
    for case in matrix():
        if case.steps * case.periods <= 1000 and not _large(case):
            few.setdefault(case.axis, []).append(case)
    return tuple(case for cases in few.values() for case in cases[:: _stride(cases)])


def _large(case: Case) -> bool:
    return isinstance(case, BarCase) and case.elements > 1000


def _stride(cases: list[Case]) -> int:
    count = QUICK_PLATES if isinstance(cases[0], PlateCase) else QUICK_BARS
    return max(1, (len(cases) - 1) // count)
