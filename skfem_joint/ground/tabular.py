"""Results that are tables, as data frames of pandas."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from skfem_joint.ground.files import needed


class Tabular:
    """Result whose values are columns of one length."""

    @property
    @abstractmethod
    def table(self) -> Mapping[str, Any]:
        """Columns by their names, which end with the unit; arrays or lists of one length."""

    def to_pandas(self) -> Any:
        """Table as a ``pandas.DataFrame``: a column for each name, with its unit at the end.

        Raises
        ------
        InputError
            If pandas is missing.
        """
        return needed("pandas", "pandas").DataFrame(dict(self.table))


def spread(name: str, values: Any, labels: Iterable[Any] | None = None) -> dict[str, Any]:
    """Columns of an array (rows, k), with a label or number in place of the {} in their name."""
    columns = np.asarray(values).T
    return dict(zip(map(name.format, labels or range(len(columns))), columns, strict=True))
