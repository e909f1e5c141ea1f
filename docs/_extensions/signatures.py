"""Signatures in the reference: none of classes whose objects users get, and defaults as written."""

import re
from typing import Any

from sphinx.application import Sphinx

#: Classes whose objects are results of functions. Their attributes are in the docstring.
RESULTS = (
    "ActiveRegion",
    "Backbone",
    "Basis",
    "Counters",
    "Curve",
    "Cycles",
    "DampingCurve",
    "Description",
    "Errors",
    "Estimate",
    "Failure",
    "Model",
    "NaturalModes",
    "Patch",
    "Preload",
    "ProperModes",
    "RingDown",
    "Row",
    "Run",
    "Scene",
    "SlipHistory",
    "Steady",
    "SteadyPoint",
    "StressHistory",
    "Study",
    "Swept",
)


def signature(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, shown: str | None, returned: Any
) -> tuple[str | None, Any]:
    """Leave out the arguments of a result and of a class to derive from; name default functions."""
    if what == "class" and name.rpartition(".")[2] in (*RESULTS, "Amplitude"):
        return "", None
    if shown:
        shown = re.sub(r"<function (\w+)[^>]*>", r"\1", shown.replace("<factory>", "{}"))
    return shown, returned


def setup(app: Sphinx) -> dict[str, bool]:
    """Let autodoc ask for each signature."""
    app.connect("autodoc-process-signature", signature)
    return {"parallel_read_safe": True}
