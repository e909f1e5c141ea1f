"""Pages for developers: their picture, the changes that they show, and their code."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "contributing"
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def module_of(path):
    """Module of a file that no package has."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def blocks(page, language):
    """Code blocks of a page in a language."""
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    return [code for kind, code in BLOCK.findall(text) if kind == language]


def changed_lines():
    """File and text of each line that the changes on the page keep or take away."""
    for diff in blocks("extend", "diff"):
        file = None
        for line in diff.splitlines():
            if line.startswith("--- a/"):
                file = line.removeprefix("--- a/")
            elif not line.startswith("+"):
                yield file, line[1:]


def test_the_picture_is_what_its_script_draws():
    drawing = module_of(PAGES / "draw_architecture.py")
    assert (PAGES / "architecture.svg").read_text(encoding="utf-8") == drawing.picture(), (
        "draw it again: python docs/contributing/draw_architecture.py"
    )


def test_folders_stand_in_the_order_of_their_imports():
    order = module_of(ROOT / "tests" / "test_imports.py").FOLDERS
    names = ["cli" if name == "" else name for name in order]
    drawn = module_of(PAGES / "draw_architecture.py").FOLDERS
    assert [name for name, _ in drawn] == [name for name in names if "." not in name]
    page = (PAGES / "architecture.md").read_text("utf-8")
    section = page.partition("\n## Folders\n")[2].partition("\n## ")[0]
    listed = re.findall(r"^\| `([\w.]+)` \|", section, re.MULTILINE)
    assert [name for name in listed if name in names] == names


@pytest.mark.parametrize(("file", "line"), list(changed_lines()))
def test_a_shown_change_starts_from_lines_that_are_there(file, line):
    assert line in (ROOT / file).read_text(encoding="utf-8").splitlines()


def test_the_code_of_the_page_says_what_the_page_says(capsys):
    names = {}
    for code in blocks("extend", "python"):
        exec(code, names)
    assert capsys.readouterr().out in blocks("extend", "text")
