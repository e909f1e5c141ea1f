"""Reproduce the paper: every table and figure beside its published value."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module

from skfem_joint.errors import InputError
from skfem_joint.paper import page
from skfem_joint.paper.items import Item
from skfem_joint.paper.workspace import Workspace

#: Items in the paper's order: key -> (module of skfem_joint.paper, function, what it covers).
ITEMS: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "fig2": ("mesh_and_law", "fig2", ("fig2",)),
    "fig3": ("mesh_and_law", "fig3", ("fig3",)),
    "fig4": ("mesh_and_law", "fig4", ("fig4",)),
    "table1": ("modes", "table1", ("table1", "fig5")),
    "fig6": ("active", "fig6", ("fig6",)),
    "table2": ("active", "table2", ("table2", "fig7")),
    "table3": ("harmonic", "table3", ("table3", "fig8", "fig9")),
    "fig10": ("active", "fig10", ("fig10",)),
    "table4": ("harmonic", "table4", ("table4", "fig11")),
    "table5": ("vicinity", "table5", ("table5", "fig12", "fig13", "fig14")),
    "fig15": ("impulse", "fig15", ("fig15", "fig16", "fig17")),
    "section7.3": ("structure_runs", "section7_3", ("section7.3", "fig18", "fig19")),
    "section7.4": ("structure_runs", "section7_4", ("section7.4", "fig20", "fig21")),
    "section7.5": ("cost", "section7_5", ("section7.5", "fig22")),
    "modes": ("accuracy", "modes", ("modes",)),
}


def chosen(names: Sequence[str]) -> list[str]:
    """Keys of the items that cover the names asked for, in the paper's order; all if none.

    Raises
    ------
    InputError
        For a name that no item covers.
    """
    covers = {name: key for key, (_, _, covered) in ITEMS.items() for name in covered}
    unknown = [name for name in names if name.lower() not in covers]
    if unknown:
        raise InputError(
            f"no item {', '.join(map(repr, unknown))} in the paper; there are: {', '.join(covers)}"
        )
    wanted = {covers[name.lower()] for name in names} or set(ITEMS)
    return [key for key in ITEMS if key in wanted]


def reproduce(
    names: Sequence[str],
    workspace: Workspace,
    progress: Callable[[str, int, int], None] | None = None,
    report: Callable[[Item], None] | None = None,
) -> list[Item]:
    """Compute items, and write the page and the curves if the workspace has a folder.

    Parameters
    ----------
    names : sequence of str
        Tables, figures or sections such as ``table3`` or ``fig19``; all if empty.
    progress : callable, optional
        Called with (label, items done, items in all).
    report : callable, optional
        Called with each item when it is done.
    """
    keys = chosen(names)
    items: list[Item] = []
    for done, key in enumerate(keys):
        if progress is not None:
            progress("reproducing the paper", done, len(keys))
        module, function, _ = ITEMS[key]
        make = getattr(import_module(f"skfem_joint.paper.{module}"), function)
        item: Item = make(workspace)
        items.append(item)
        if report is not None:
            report(item)
        if workspace.folder is not None:
            page.write_curves(workspace.folder, item)
            page.write_page(workspace.folder, items)
    if progress is not None:
        progress("reproducing the paper", len(keys), len(keys))
    return items
