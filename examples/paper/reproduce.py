"""Reproduce the paper: every table and figure beside its published value.

    python examples/paper/reproduce.py [ITEM ...] --out DIR

prints the tables. It writes into DIR a page with tables and notes (reproduction.md), its summary
(summary.md), the pictures, every curve as CSV, and files of the jointed structure for ParaView.
Items are tables, figures or sections such as table3, fig19, section7.5; all of them (about a
minute) if none is given.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # this folder is the package `paper`

from paper import active, harmonic, impulse, joint, page, reduction, structure

from skfem_joint.ground.errors import InputError, JointError
from skfem_joint.output.folder import kept
from skfem_joint.output.record import writing

#: Items in the paper's order: the function, and the names of others that it covers.
ITEMS = {
    "fig2": (joint.fig2,),
    "fig3": (joint.fig3,),
    "fig4": (joint.fig4,),
    "table1": (joint.table1, "fig5"),
    "fig6": (active.fig6,),
    "table2": (active.table2, "fig7"),
    "table3": (harmonic.table3, "fig8", "fig9"),
    "fig10": (active.fig10,),
    "table4": (harmonic.table4, "fig11"),
    "table5": (harmonic.table5, "fig12", "fig13", "fig14"),
    "fig15": (impulse.fig15, "fig16", "fig17"),
    "section7.3": (structure.section7_3, "fig18", "fig19"),
    "section7.4": (structure.section7_4, "fig20", "fig21"),
    "section7.5": (reduction.section7_5, "fig22"),
    "modes": (reduction.modes,),
}


def made(key, quick=False):
    """Compute an item; ``quick`` makes sweeps coarser and keeps the rows."""
    ITEMS[key][0](item := page.Item(key), quick)
    return item


def chosen(names):
    """Keys of the items that cover some names, in the paper's order; all items without names."""
    covers = {name: key for key, (_, *others) in ITEMS.items() for name in (key, *others)}
    if unknown := [name for name in names if name.lower() not in covers]:
        raise InputError(
            f"no item {', '.join(map(repr, unknown))} in the paper; there are: {', '.join(covers)}"
        )
    wanted = {covers[name.lower()] for name in names} or set(ITEMS)
    return [key for key in ITEMS if key in wanted]


def main(arguments=None):
    """Run the command; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("items", nargs="*", metavar="ITEM", help="table3, fig19, section7.5, ...")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--quick", action="store_true", help="coarser sweeps")
    parser.add_argument("--overwrite", action="store_true", help="replace files of other origin")
    options = parser.parse_args(arguments)
    try:
        keys, items = chosen(options.items), []
        with (
            kept(options.out, overwrite=options.overwrite),
            writing(options.out, {"title": "Reproduction of the paper", "items": keys}),
        ):
            for key in keys:
                items.append(made(key, options.quick))
                print(*items[-1].markdown()[:2], sep="\n\n", end="\n\n", flush=True)
                page.write(options.out, items[-1])
                page.write_page(options.out, items)
    except JointError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_status
    print(f"Written to {options.out}: reproduction.md, pictures/, curves/")
    return 0


if __name__ == "__main__":
    sys.exit(main())
