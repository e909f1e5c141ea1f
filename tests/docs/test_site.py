"""The pages of the site: short, linked with each other, and complete where they are a reference."""

import ast
import inspect
import io
import pkgutil
import re
import tokenize
from fnmatch import fnmatch
from pathlib import Path

import skfem_joint
from skfem_joint.cli import parser

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PYTHON = [DOCS / "reference" / "python.md", *sorted((DOCS / "reference" / "python").glob("*.md"))]
#: Pages to look something up in, which may be long.
LONG = {*PYTHON, *(DOCS / "reference" / f"{name}.md" for name in ("keys", "commands"))}
_FENCED = re.compile(r"^(```+|:::+)[^\n]*\n.*?^\1[ ]*$", re.MULTILINE | re.DOTALL)
TOCTREE = re.compile(r"^```\{toctree\}\n(.*?)^```", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\(<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\)")
_IMAGE = re.compile(r"^```\{(?:image|figure)\} (\S+)", re.MULTILINE)


def excluded():
    """Patterns of files below docs/ that are no pages, from conf.py."""
    tree = ast.parse((DOCS / "conf.py").read_text(encoding="utf-8"))
    values = {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    return ast.literal_eval(values["exclude_patterns"])


def pages():
    """Pages of the site that are not made when it is built."""
    made = ("gallery/*", "_build/*", *excluded())
    found = (path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))
    return sorted(DOCS / path for path in found if not any(fnmatch(path, each) for each in made))


def gallery():
    """Scripts that have a page in the gallery."""
    apart = ("make_pictures", "paraview_joint")
    return sorted(path for path in (ROOT / "examples").glob("*.py") if path.stem not in apart)


def text_of(script):
    """Docstring and comments of a script."""
    source = script.read_text(encoding="utf-8")
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    comments = (token.string for token in tokens if token.type == tokenize.COMMENT)
    return "\n".join([ast.get_docstring(ast.parse(source)) or "", *comments])


def sections(thing):
    """Entries of each section of a docstring in numpydoc's form."""
    lines = (inspect.getdoc(thing) or "").splitlines()
    found, entries = {}, None
    for line, below in zip(lines, [*lines[1:], ""], strict=True):
        if line and set(below) == {"-"}:
            entries = found.setdefault(line, [])
        elif entries is not None and line and not line.startswith((" ", "-")):
            entries += [name.strip(" *`") for name in line.partition(" : ")[0].split(",")]
    return found


def test_pages_are_short():
    for page in {ROOT / "README.md", *pages(), *gallery()} - LONG:
        text = text_of(page) if page.suffix == ".py" else page.read_text(encoding="utf-8")
        assert len(text.split()) <= (900 if page.name == "README.md" else 2000), page


def test_every_page_stands_in_a_table_of_contents():
    listed = {DOCS / "index"}
    for page in pages():
        for entries in TOCTREE.findall(page.read_text(encoding="utf-8")):
            names = (line.strip() for line in entries.splitlines() if not line.startswith(":"))
            listed |= {(page.parent / name).resolve() for name in names if name}
    assert listed - {DOCS / "gallery" / "index"} == {page.with_suffix("") for page in pages()}


def links_of(page):
    """What the links and pictures of a page lead to: other sites left out, places in pages too."""
    text = page.read_text(encoding="utf-8")
    links = [*_IMAGE.findall(text), *_LINK.findall(re.sub(r"`[^`\n]+`", "", _FENCED.sub("", text)))]
    own = (link.partition("#")[0] for link in links if not re.match(r"mailto:|.*://", link))
    return [(page.parent / path).resolve() for path in own if path]


def test_links_lead_to_files():
    made = {DOCS / "gallery" / f"{script.stem}.rst" for script in (*gallery(), Path("index"))}
    for page in (ROOT / "README.md", *(ROOT / "examples").glob("*.md"), *pages()):
        assert [path for path in links_of(page) if not (path.exists() or path in made)] == [], page


def test_the_reference_and_its_first_page_have_every_public_name_once():
    text = "\n".join(page.read_text(encoding="utf-8") for page in PYTHON[1:])
    shown = re.findall(r"^\.\. auto(?:class|function):: skfem_joint\.(\w+)$", text, re.MULTILINE)
    listed = re.findall(r"^   (\w+)$", PYTHON[0].read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(shown) == sorted(listed) == skfem_joint.__all__


def test_members_that_the_reference_shows_exist_and_are_described():
    classes = re.compile(r"^\.\. autoclass:: ([\w.]+)\n   :members: (.+)$", re.MULTILINE)
    for page in PYTHON[1:]:
        for name, members in classes.findall(page.read_text(encoding="utf-8")):
            thing = pkgutil.resolve_name(name)
            for member in members.split(", "):
                assert inspect.getdoc(inspect.getattr_static(thing, member)), f"{name}.{member}"


def test_docstrings_say_what_goes_in_and_what_comes_out():
    assert inspect.getdoc(skfem_joint.Amplitude)  # users derive from it
    for name in {*skfem_joint.__all__} - {"Amplitude"}:
        thing = getattr(skfem_joint, name)
        described = sections(thing)
        said = {*described.get("Parameters", ()), *described.get("Attributes", ())}
        assert not set(inspect.signature(thing).parameters) - said, name
        assert inspect.isclass(thing) or described.keys() & {"Returns", "Yields"}, name


def test_the_page_of_the_commands_has_each_of_them():
    (commands,) = (each for each in parser()._actions if isinstance(each.choices, dict))
    page = (DOCS / "reference" / "commands.md").read_text(encoding="utf-8")
    shown = re.findall(r"^```\{command\} ([\w-]+)$", page, re.MULTILINE)
    assert sorted(shown) == sorted(commands.choices)
    assert re.findall(r"^## (.+)$", page, re.MULTILINE)[1:] == shown
