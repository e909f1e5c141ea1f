"""The pages of verification: every claim has its command, its table, its page and its date."""

import importlib.util
import os
import re
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "verification"
MEASURED = PAGES / "measured"
_spec = importlib.util.spec_from_file_location("measure", PAGES / "measure.py")
measure = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(measure)
#: Tables that no command makes, from earlier studies; they say so.
BY_HAND = {"estimates-merging", "large-before", "reduction-choices", "solids-choices"}
TABLES = {name: claim for claim in measure.CLAIMS.values() for name in claim.tables}
INCLUDE = re.compile(r"```\{include\} measured/(\S+)\.md\n```")


def text_of(name):
    return (MEASURED / f"{name}.md").read_text(encoding="utf-8")


def whole(page):
    """Text of a page with the tables that it includes."""
    return INCLUDE.sub(lambda found: text_of(found[1]), page.read_text(encoding="utf-8"))


def test_every_table_is_of_a_claim_or_named_here_and_is_on_one_page():
    files = {path.stem for path in MEASURED.glob("*.md")}
    assert files == {*TABLES, *BY_HAND, "list"}
    pages = [path.read_text(encoding="utf-8") for path in PAGES.glob("*.md")]
    included = [name for page in pages for name in INCLUDE.findall(page)]
    assert sorted(included) == sorted(files)


def test_every_picture_is_of_a_claim_is_shown_and_is_small():
    made = {f"{name}.png" for claim in measure.CLAIMS.values() for name in claim.pictures}
    files = {path.name: path for path in (PAGES / "pictures").iterdir()}
    pages = "".join(path.read_text(encoding="utf-8") for path in PAGES.glob("*.md"))
    assert set(files) == made == set(re.findall(r"\]\(pictures/([^)]+)\)", pages))
    assert max(path.stat().st_size for path in files.values()) < measure.LARGEST


def test_tables_say_when_and_by_which_command_they_were_made():
    for name in (*TABLES, *BY_HAND):
        last = text_of(name).splitlines()[-1]
        made = date.fromisoformat(re.match(r"\*Made on (\S+) ", last)[1])
        assert date(2026, 1, 1) < made <= datetime.now(UTC).date() + timedelta(days=1), name
        assert "version" in last, name
        if name in TABLES:
            assert measure.MADE.search(last)[2] == TABLES[name].command.format(out="out")
        else:
            assert "by `python" in last or "no command makes it anew" in last, name


def test_commands_name_scripts_and_scenes_that_exist():
    for claim in measure.CLAIMS.values():
        words = [*claim.command.split(), *measure.short_form(claim).split()]
        files = [word for word in words if word.startswith("examples/")]
        assert files, claim
        assert [file for file in files if not (ROOT / file).exists()] == []


def test_the_list_on_the_page_is_that_of_the_command(capsys):
    assert measure.main(["--list"]) == 0
    assert text_of("list") == f"```text\n{capsys.readouterr().out.strip()}\n```\n"
    assert measure.main(["--list", "--quick"]) == 0
    assert {"paper", "steady"} & {*capsys.readouterr().out.split()} == {"paper"}


def test_pages_are_short_with_their_tables():
    for page in PAGES.glob("*.md"):
        assert len(re.findall(r"\w[\w.,'-]*", whole(page))) <= 2000, page


def test_tests_that_pages_name_exist():
    texts = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("*.py"))
    defined = set(re.findall(r"def (test_\w+)\(", texts))
    named = {
        name
        for page in PAGES.glob("*.md")
        for name in re.findall(r"`(test_\w+)`", page.read_text(encoding="utf-8"))
    }
    assert len(named) > 40
    assert named <= defined


@pytest.mark.parametrize(
    ("page", "says", "table", "shows"),
    [
        ("stability", "1,387 stiff and extreme cases", "stability", "1387 cases: "),
        ("stability", "wrong in silence", "stability", " 0 wrong in silence"),
        ("error-time", "a reduction does not pay", "error-time", "A reduction does not pay"),
        ("steady", "48 pairs are its default", "pairs", "amplitudes are those of marching"),
        ("paper", "structure under harmonic load", "paper-number-of-modes", "structure, harmonic"),
        ("two-plates", "four times the friction energy", "two-plates", "(b) strut"),
    ],
)
def test_what_pages_say_of_their_tables_is_there(page, says, table, shows):
    assert says in (PAGES / f"{page}.md").read_text(encoding="utf-8")
    assert shows in text_of(table)


# The command


SCRIPT = """
import sys
from pathlib import Path
from PIL import Image

if "--fail" in sys.argv:
    sys.exit("no luck")
out = Path(sys.argv[sys.argv.index("--out") + 1])
(out / "page.md").write_text("# Title\\n\\n## One\\n\\n| a |\\n\\n## Two\\n\\n| b |\\n")
Image.effect_noise((900, 900), 100).save(out / "large.png")
print("| x | y |")
"""


@pytest.fixture
def claims(tmp_path):
    """Two claims, of a script that writes a page and a picture, and of one that fails."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT, encoding="utf-8")
    tables = {"said": measure.printed, "page": measure.section("page.md", "Two")}
    good = measure.Claim(f"python {script} --out {{out}}", 1, tables, {"noise": "large.png"})
    bad = good._replace(command=good.command + " --fail", tables={"lost": measure.printed})
    return {"good": good, "bad": bad}


def test_tables_and_pictures_are_made_and_what_fails_leaves_its_table(claims, tmp_path, capsys):
    out, keep = tmp_path / "new", tmp_path / "keep"
    (out / "measured").mkdir(parents=True)
    (out / "measured" / "lost.md").write_text("before")
    assert measure.main(["--out", str(out), "--keep", str(keep)], claims) == 1
    said = capsys.readouterr()
    assert "good: made in" in said.out
    assert "bad: status 1: no luck" in said.err
    assert "not made: bad" in said.err
    table, made = (out / "measured" / "said.md").read_text().strip().split("\n\n")
    assert table == "| x | y |"
    assert measure.MADE.match(made)[1] == f"{datetime.now(UTC):%Y-%m-%d}"
    assert "--out out` in " in made
    assert (out / "measured" / "page.md").read_text().startswith("## Two\n\n| b |\n\n*Made")
    assert (out / "measured" / "lost.md").read_text() == "before"
    assert (keep / "good" / "files" / "page.md").exists()
    picture = out / "pictures" / "noise.png"
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size < (keep / "good" / "files" / "large.png").stat().st_size * 1.2


@pytest.mark.parametrize("busy", [False, True])
def test_a_busy_machine_is_said(claims, tmp_path, capsys, busy):
    good = claims["good"]._replace(timed=True, pictures={})
    (tmp_path / "measured").mkdir()
    measure.measure(good, good.command, tmp_path, tmp_path / "kept", busy)
    assert ("busy" in capsys.readouterr().err) == busy
    cores = f" s on {os.cpu_count()} {'busy ' * busy}cores"
    assert cores in (tmp_path / "measured" / "said.md").read_text()


def test_unknown_names_and_short_forms_over_the_site_are_refused(claims, capsys):
    for arguments in (["nothing"], ["--short"]):
        with pytest.raises(SystemExit):
            measure.main(arguments, claims)
    said = capsys.readouterr().err
    assert "no claim is called nothing; there are: good, bad" in said
    assert "give --out DIR" in said


#: Seconds of the processor: first-run, which compiles all, and bowed-beam some 50, others 2 to 35.
SHORT = ["paper", "stability", "plates", "growth", "estimates", "estimates-accuracy", "pairs"]
SHORT += ["reduction", "first-run", "solids", "contact-points", "contact-point-steps"]
SHORT += ["fit-gradients", "fit-coverage", "fit-solid", "bowed-beam", "contact-block"]
SHORT += ["contact-wall", "contact-alike", "contact-loops"]


@pytest.mark.slow
@pytest.mark.parametrize("name", SHORT)
def test_short_forms_of_claims_run(name, tmp_path):
    assert measure.main([name, "--short", "--out", str(tmp_path)]) == 0
    made = {path.stem for path in (tmp_path / "measured").iterdir()}
    assert made == {*measure.CLAIMS[name].tables}
