"""The gallery shows every example, its pictures come from its script, and no link leads nowhere."""

import re
import runpy
from pathlib import Path

import matplotlib.image
import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
PAGES = [ROOT / "README.md", *EXAMPLES.glob("*.md")]
SCRIPT = runpy.run_path(str(EXAMPLES / "make_pictures.py"))


def links(page):
    """Files that a page links to or shows."""
    found = re.findall(r"\]\(([^)#\s]+)\)", page.read_text(encoding="utf-8"))
    return [page.parent / one for one in found if "://" not in one]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_to_a_file(page):
    assert [str(link) for link in links(page) if not link.exists()] == []


def test_the_gallery_has_every_example_with_a_question_a_command_and_a_picture():
    page = EXAMPLES / "README.md"
    linked = {link.resolve().relative_to(EXAMPLES).parts[0] for link in links(page)}
    examples = {path.name for path in EXAMPLES.iterdir() if path.suffix != ".md"}
    assert examples - {"make_pictures.py", "__pycache__"} <= linked
    for entry in page.read_text(encoding="utf-8").split("\n### ")[1:]:
        assert entry.split("\n")[0].endswith("?")
        assert len(re.findall(r"```\n(skfem-joint|python|xvfb-run) ", entry)) == 1
        assert len(re.findall(r"!\[[^]]+\]\(pictures/", entry)) == 1


def test_the_pictures_are_those_of_the_script_are_small_and_are_shown():
    pictures = set((EXAMPLES / "pictures").iterdir())
    assert {path.stem for path in pictures} == {*SCRIPT["SHORT"], *SCRIPT["LONG"]}
    assert max(path.stat().st_size for path in pictures) < SCRIPT["LARGEST"]
    assert pictures <= {link for page in PAGES for link in links(page)}


def test_the_script_makes_the_pictures_that_are_named(tmp_path):
    SCRIPT["main"](["own_basis", "lap_joint", "--out", str(tmp_path)])
    assert {path.name for path in tmp_path.iterdir()} == {"own_basis.png", "lap_joint.png"}
    for path in tmp_path.iterdir():
        kept = matplotlib.image.imread(EXAMPLES / "pictures" / path.name)
        assert matplotlib.image.imread(path).shape == kept.shape
    with pytest.raises(SystemExit):
        SCRIPT["main"](["nothing", "--out", str(tmp_path)])
