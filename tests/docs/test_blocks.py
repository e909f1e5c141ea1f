"""The code blocks of README.md and of the site's pages run, and print what the pages show.

A page is run from top to bottom in an empty folder, see `page_blocks`.
"""

import shutil
from pathlib import Path

import pytest
from page_blocks import alike, compare, run_page

ROOT = Path(__file__).resolve().parents[2]

#: Commands that .ci/run itself runs, by the comments before them.
RUN_BY_CI = "main-job", "tests"

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("start/*.md"))]
PAGES += sorted((ROOT / "docs").glob("how-to/*.md"))
#: Pages that take long, by the names of their files.
SLOW = {
    "README",
    "accuracy",
    "bolts",
    "damping",
    "gross-slip",
    "loss-factor",
    "matrices",
    "opening-contact",
    "plate",
    "python",
}
SLOW |= {"ranges", "slow-cycles", "solid", "sweeps"}


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[pytest.mark.slow] * (page.stem in SLOW)) for page in PAGES],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_page_runs(page, tmp_path):
    if page.stem == "README":  # which speaks to someone in a checkout
        for folder in ("meshes", "examples"):
            shutil.copytree(ROOT / folder, tmp_path / folder)
    for target in run_page(page, tmp_path, exempt=RUN_BY_CI):
        assert (page.parent / target).is_file(), f"{target} is not in the repository"


def page_of(folder, text):
    page = folder / "page.md"
    page.write_text(text, encoding="utf-8")
    return page


def test_a_block_that_needs_a_module_is_run_only_where_it_is(tmp_path):
    text = "<!-- test: needs {} -->\n\n```python\nprint(1)\n```\n```text\n2\n```\n"
    run_page(page_of(tmp_path, text.format("no_such_module")), tmp_path)
    with pytest.raises(AssertionError, match="the page shows"):
        run_page(page_of(tmp_path, text.format("json")), tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("```python\nprint(1)\n```\n```text\n2\n```\n", "the page shows"),
        ("```python\nprint(1, 2)\nprint(3)\n```\n```text\n1 2\n```\n", "does not show: 3"),
        ("```python\n1 / 0\n```\n", "division by zero"),
        ("```bash\nskfem-joint check nothing.toml\n```\n", "exit status 2"),
        ("```bash\nrm -r /\n```\n", "not a command"),
        ("```toml\na = b\n```\n", "Invalid value"),
        ("<!-- test: picture no.png -->\n![a](pictures/no.png)\n", "is not written"),
        ("```python\n1\n", "not closed"),
    ],
)
def test_wrong_pages_fail(tmp_path, text, words):
    with pytest.raises(Exception, match=words):
        run_page(page_of(tmp_path, text), tmp_path)


@pytest.mark.parametrize(
    ("shown", "line", "same"),
    [
        ("peak 0.0064932 m", "peak  0.0065 m", True),
        ("peak 0.0064932 m", "peak 0.0075 m", False),
        ("peak 0.0064932 m", "peak 0.0064932 mm", False),
        ("error, % 0.9 -", "error, %   1.1 -", True),
        ("error, % 0.9 -", "error, %   2.1 -", False),
        ("run time, ms 20", "run time, ms 3.5e+04", True),
        ("Mass 1 kg, ...", "Mass 1 kg, extent 2 m", True),
        ("Mass 1 kg", "Mass 1 kg, extent 2 m", False),
        ("-----", "-------", True),
        ("36,864 points", "36864 points", True),
    ],
)
def test_lines_are_alike(shown, line, same):
    assert alike(shown, line) is same


def test_any_lines_stand_for_dots():
    compare("...\nb\n...\n", "a\na\nb\nc\n")
    with pytest.raises(AssertionError, match="the page shows"):
        compare("a\nc\n...\n", "a\nb\nc\n")
