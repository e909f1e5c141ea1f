"""What files beside the code say about versions is the same everywhere."""

import re
import tomllib
from pathlib import Path

import skfem_joint

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
#: Extras and groups that `tests/oldest.txt` installs; the others need a compiler or another system.
EXTRAS = ("plot", "vtk", "report", "parquet", "salome")


def test_oldest_versions_are_the_lower_bounds():
    requirements = [*PROJECT["project"]["dependencies"], *PROJECT["dependency-groups"]["test"]]
    for extra in EXTRAS:
        requirements += PROJECT["project"]["optional-dependencies"][extra]
    bounds = {}
    for requirement in requirements:
        name, lowest = re.match(r"([\w-]+)>=([\d.]+)", requirement).groups()
        assert bounds.setdefault(name, lowest) == lowest, f"{name} has two lower bounds"

    lines = (ROOT / "tests" / "oldest.txt").read_text(encoding="utf-8").splitlines()
    oldest = dict(line.split("==") for line in lines if not line.startswith("#"))
    assert oldest.keys() == {*bounds, "pyparsing"}  # needed by matplotlib, not by this package
    for name, lowest in bounds.items():
        parts = lowest.split(".")
        pinned = oldest[name].split(".")
        assert pinned == parts + ["0"] * (len(pinned) - len(parts)), name


def test_the_extra_all_has_the_extras_that_need_no_compiler():
    (everything,) = PROJECT["project"]["optional-dependencies"]["all"]
    assert everything == f"skfem-joint[{','.join(EXTRAS)}]"


def test_citation_and_changelog_have_this_version():
    version = skfem_joint.__version__
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.+)$", citation, re.MULTILINE) == [version]
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## \[(.+?)\]", changelog, re.MULTILINE)
    assert headings[:2] == ["Unreleased", version]
    assert re.findall(r"^\[(.+?)\]: ", changelog, re.MULTILINE) == headings
