"""An item of the paper (table, figure, section): rows beside printed numbers, notes, curves.

``page.md`` holds the words of rows and notes, with fields for what is computed; ``published.toml``
the printed numbers; ``pictures.toml`` says what of the curves is drawn.
"""

import re
import string
import tomllib
from collections import Counter, namedtuple
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from paper.figures import draw

from skfem_joint import write_vtk
from skfem_joint.ground.files import replacing
from skfem_joint.study.error_time import markdown_table

HERE = Path(__file__).parent
#: Cells of a row: our numbers by the full and by the reduced model.
Row = namedtuple("Row", "quantity published full reduced difference verdict")
HEADINGS = Row("quantity", "published", "ours, full", "ours, reduced", "difference", "verdict")
#: How verdicts begin.
KINDS = "agrees", "better than published", "differs", "cannot be right", "meets", "misses"
#: Verdicts in the table of the summary, which is narrow.
SHORT = {"better than published": "better", "agrees within the paper's own tolerance": "agrees\\*"}
#: Printed values by item, some with rounding and name; pictures by item.
PUBLISHED = tomllib.loads((HERE / "published.toml").read_text("utf-8"))
PICTURES = tomllib.loads((HERE / "pictures.toml").read_text("utf-8"))
#: Title and blocks of ``page.md`` by the name in the heading.
TEMPLATES = {}
for section in re.split(r"(?m)^## ", (HERE / "page.md").read_text("utf-8"))[1:]:
    heading, _, text = section.partition("\n")
    name, _, title = heading.partition(" -- ")
    TEMPLATES[name] = title, text.strip().split("\n\n")


def printed(item):
    """Printed values of an item without rounding and name; empty if it has none."""
    entries = PUBLISHED.get(item, {}).items()
    return {key: entry.get("value") if isinstance(entry, dict) else entry for key, entry in entries}


def limit_of(statement):
    """Number in a printed statement such as ``< 1`` or ``slightly > 1``."""
    return float(statement.split()[-1])


class _Words(string.Formatter):
    """Formats of ``page.md``: texts for true // false, a factor*, several values (;)."""

    def format_field(self, value, form):
        if isinstance(value, bool | np.bool_):
            yes, _, no = form.partition(" // ")
            return (yes or "agrees") if value else (no or "differs")
        if isinstance(value, list | tuple | np.ndarray):
            separator = "; " if form.startswith(";") else ", "
            return separator.join(self.format_field(part, form.removeprefix(";")) for part in value)
        factor, _, form = form.rpartition("*")
        return format(float(factor) * value if factor else value, form)


def words(name, /, **fields):
    """Blocks under a heading of ``page.md`` with values in the place of their fields."""
    blocks = (_Words().format(block, **fields) for block in TEMPLATES[name][1])
    return [block if block.startswith("|") else " ".join(block.split()) for block in blocks]


def percent(ours, reference):
    return 100.0 * (ours / reference - 1.0)


def judged_reduced(error, stated, why="", around=0.0):
    """Verdict on a reduced model by its distance from its own full model, percent.

    ``stated`` is that of the paper's model; ``why`` the reason if ours is farther away; ``around``
    the whole number of percent that the text allows itself beside the printed error.
    """
    within = 0.05  # the last digit that the paper prints
    if abs(error) < stated - within:
        return "better than published"
    if abs(error) <= stated + within:
        return "agrees"
    if abs(error) < around + 0.5:
        return f"agrees within the paper's own tolerance (around {around:g} %)"
    verdict = f"differs: {error:+.2g} % from our full model, published {stated:g} %"
    return f"{verdict}; {why}" if why else verdict


@dataclass
class Item:
    """A reproduced table, figure or section: ``table3``, ``fig15``, ``section7.5``.

    ``curves`` holds columns (name with unit) by the name of their CSV file, ``marks`` values that
    are drawn as lines across, ``series`` makers of studies that are written for ParaView.
    """

    key: str
    rows: list = field(default_factory=list)
    notes: list = field(default_factory=list)
    curves: dict = field(default_factory=dict)
    marks: dict = field(default_factory=dict)
    pictures: list = field(default_factory=list)
    series: dict = field(default_factory=dict)

    def __post_init__(self):
        self.title, self.printed = TEMPLATES[self.key][0], printed(self.key)

    def mark(self, name):
        """Value of a line across a picture: a mark, a published value, or a limit."""
        value = self.marks[name] if name in self.marks else self.printed[name.removeprefix("-")]
        value = limit_of(value) if isinstance(value, str) else value
        return -value if name.startswith("-") else value

    def say(self, name="", /, **fields):
        """Add the rows and notes under a heading of ``page.md``, by default the item's own."""
        for text in words(name or self.key, **({"printed": self.printed} | fields)):
            lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.split("\n")]
            if len(lines[0]) == len(HEADINGS):
                self.rows += [Row(*cells) for cells in lines]
            else:
                self.notes.append(text)

    def compare(self, key, full=None, reduced=None, **changed):
        """Add the row of a printed number: ours (the full model's) agrees if it is near enough.

        ``key`` is that of an entry of ``published.toml``, which says how near and what else a row
        needs; some of it may be ``changed``.
        """
        entry = {"form": ".4g", "points": False, "otherwise": "differs"}
        entry |= PUBLISHED[self.key][key] | changed
        value, ours = entry["value"], full if full is not None else reduced
        cells = ["" if x is None else f"{x:{entry['form']}}" for x in (full, reduced)]
        off = f"{percent(ours, value):+.2g} %"
        cells.append(f"{ours - value:+.2f} points" if entry["points"] else off)
        near = abs(ours - value) <= entry["within"] * (1.0 + 1e-12)
        cells.append("agrees" if near else entry["otherwise"])
        self.rows.append(Row(entry["what"], f"{value:g}", *cells))

    def markdown(self):
        """Markdown of the item; the title and the table come first."""
        parts = [f"## {self.title}", markdown_table(HEADINGS, self.rows), *self.notes]
        parts += [f"![{self.title}](pictures/{name}.png)" for name in self.pictures]
        names = ", ".join(f"[{name}.csv](curves/{name}.csv)" for name in self.curves)
        return [*parts, f"Curves: {names}."] if names else parts


def write(folder, item):
    """Write an item's curves (CSV), pictures (PNG) and series for ParaView."""
    for name in ("curves", "pictures"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for name, columns in item.curves.items():
        values, header = np.column_stack(list(columns.values())), ",".join(columns)
        with replacing(folder / "curves" / f"{name}.csv") as temporary:
            np.savetxt(temporary, values, "%.9g", ",", header=header, comments="")
    for name, picture in PICTURES.get(item.key, {}).items():
        draw(picture, item.curves, item.mark, folder / "pictures" / f"{name}.png")
        item.pictures.append(name)
    if item.series and find_spec("pyvista") is None:
        item.say("paraview.missing")
        return
    for name, make in item.series.items():
        study = make()
        write_vtk(folder / "paraview" / f"{name}.pvd", study.structure, study.runs)
        item.say("paraview", path=f"paraview/{name}.pvd")


def summary(items):
    """Table of the rows that stand for the whole, by item, and how many verdicts are of a kind."""
    rows, verdicts = [], Counter()
    for item in items:
        starts = tuple(PUBLISHED["summary"].get(item.key, ()))
        for row in item.rows:
            if starts and row.quantity.startswith(starts):
                name = re.split(r":|,| and ", item.title)[0]
                verdict = re.split(r":|;|,| \(", row.verdict)[0]  # without its reason
                verdict = SHORT.get(verdict, verdict)
                rows.append([name, *row[:4], verdict])
            verdicts += Counter(kind for kind in KINDS if row.verdict.startswith(kind))
    *kinds, met, missed = KINDS
    counts = ", ".join(f"*{kind}* {verdicts[kind]}" for kind in kinds)
    table = markdown_table(["item", *HEADINGS[:4], HEADINGS.verdict], rows)
    return (
        f"{table}\n\n\\* Within the larger tolerance that the paper itself allows.\n\n"
        f"Numbers of verdicts in all tables of the reproduction: {counts}. "
        f"Of its own aims this package meets {verdicts[met]} and misses {verdicts[missed]}."
    )


def write_page(folder, items):
    with replacing(folder / "summary.md") as temporary:
        text = f"# {TEMPLATES['page'][0]}\n\n{summary(items)}\n"
        temporary.write_text(text, encoding="utf-8")
    parts = [f"# {TEMPLATES['page'][0]}", *words("page")]
    parts += [part for item in items for part in item.markdown()]
    with replacing(folder / "reproduction.md") as temporary:
        temporary.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
