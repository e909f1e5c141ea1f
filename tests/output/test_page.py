"""The page of a report says what the summary says, needs nothing else, and computes nothing."""

import base64
import html
import json
import re
import shutil
import tomllib

import pytest
from joint_scenes import bar_scene, harmonic, joint, plate_scene

import skfem_joint as sj
from skfem_joint.cli import main
from skfem_joint.output import write
from skfem_joint.output.record import clear
from skfem_joint.study.premises import (
    OF_MODES,
    assumptions,
    loads_of,
    premises,
    random_loads_of,
    response_loads,
    scene_text,
)

TITLE = "<script>alert(1)</script> & co"


def text_of(page):
    """Text of a page without tags, each run of white space one space."""
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", page)).split())


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Folder of a run of two models with pictures, and its page."""
    out = tmp_path_factory.mktemp("out")
    made = bar_scene(
        "full", "reduced", bar="coarse", title=TITLE, output={"plots": True, "frames": 3},
        load=[harmonic(amplitude=40e3)], damping={"ratio": 0.01},
        time={"cycles": 2, "steps_per_cycle": 40},
        reduction={"modes": 4},
    )  # fmt: skip
    write(sj.run_scene(made), out)
    return out, sj.write_report(out).read_text(encoding="utf-8")


def test_the_page_has_every_sentence_and_stated_error_of_the_summary(results):
    out, page = results
    content, text = json.loads((out / "summary.json").read_text()), text_of(page)
    premises = content["premises"]
    for sentence in (*content["warnings"], *premises["structure"], *premises["assumptions"]):
        assert " ".join(sentence.split()) in text
    for model in content["models"].values():
        total = model["estimated_error"]["friction_energy_per_cycle"]["total"]
        assert f"{100 * total:.2g}" in text
    assert content["written_by"]["libraries"] in text


def test_the_page_needs_no_network_and_no_other_file(results):
    out, page = results
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert sources
    shown = [base64.b64decode(source.split("base64,")[1]) for source in sources]
    written = [path.read_bytes() for path in out.glob("*.png")]
    assert set(shown) <= {*written, *(path.read_bytes() for path in out.glob("*.gif"))}
    assert not re.search(r"url\(|@import|https?://", page)


def test_a_picture_that_is_gone_is_named(results, tmp_path):
    out = shutil.copytree(results[0], tmp_path / "out")
    gone = next(out.glob("*.png"))
    gone.unlink()
    with pytest.raises(sj.InputError, match=re.escape(gone.name)):
        sj.write_report(out)


def test_texts_of_the_scene_are_no_html(results):
    _, page = results
    assert "<script>" not in page
    assert html.escape(TITLE) in page


def test_a_report_is_a_result_that_the_next_command_replaces(results):
    out, page = results
    assert sj.write_report(out).read_text(encoding="utf-8") == page  # again
    assert clear(out) == []
    assert not (out / "report.html").exists()


def test_curves_of_modes_are_reported_too_with_a_line_for_each_column_of_wide_tables(
    tmp_path, capsys
):
    """Amplitudes, losses and shares of bolts without a scroll bar."""
    assert main(["example", "structure_harmonic", "--out", str(tmp_path / "bar")]) == 0
    scene, out = tmp_path / "bar" / "structure_harmonic.toml", tmp_path / "out"
    asked = '\n[backbone]\nlevels = 3\nat = { point = "free_end", force = [100.0, 200.0] }\n'
    scene.write_text(scene.read_text(encoding="utf-8") + asked, encoding="utf-8")
    capsys.readouterr()
    assert main(["backbone", str(scene), "--out", str(out)]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert main(["report", str(out)]) == 0
    page = (out / "report.html").read_text(encoding="utf-8")
    for line in printed[:-1]:
        if "model, mode" in line or line.startswith("Note: "):
            assert " ".join(line.removeprefix("Note: ").split()) in text_of(page)
    assert scene.read_text(encoding="utf-8").strip() in html.unescape(page)
    (row,) = re.findall(r"<tr><th>point</th>.*</tr>", page)
    assert row.count("free_end") >= 2
    losses = next(x for x in page.splitlines() if x.startswith("<tr><td>loss factor, -</td>"))
    assert len(re.findall(r"<td>[\d.e-]+</td>", losses)) >= 2


def test_the_scene_of_a_page_is_what_was_computed(tmp_path):
    """Its own text with comments; where values were changed since, all keys with their values."""
    main(["example", "structure_harmonic", "--out", str(tmp_path / "bar")])
    path = tmp_path / "bar" / "structure_harmonic.toml"
    read = sj.load_scene(path)
    assert scene_text(read) == path.read_text(encoding="utf-8")
    changed = read.changed({"joint[0].friction": 0.123})
    keys = tomllib.loads(path.read_text(encoding="utf-8"))
    keys["joint"][0]["friction"] = 0.123
    assert tomllib.loads(scene_text(changed)) == keys


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"joint": [joint(friction=0.25)]}, "friction coefficient of 0.25"),
        ({}, "keeps the normal force that it has at rest"),
        ({}, "damping by a matrix of 1e-05 s times the stiffness."),
        ({"damping": {}}, "Friction is the only damping."),
        ({"damping": {"ratio": 0.02}}, "viscous damping of 2 % of the critical"),
        (
            {"joint": [joint(pressure={"bolts": [
                {"at": [0.05, 0.0], "force": 20e3, "head_radius": 0.01}
            ]})]},
            "joint_bolt_1 presses with 20000 N at (0.05, 0) m, evenly over the cone",
        ),
    ],
)  # fmt: skip
def test_assumptions_tell_what_joints_bolts_and_damping_are(changes, words):
    assert words in " ".join(assumptions(bar_scene(bar="coarse", **changes)))


def test_assumptions_tell_what_opens_and_where_it_is_held():
    opening = {"on": "base", "friction": 0.5, "pressure": 1e6, "contact": "unilateral"}
    block = sj.build_plate(
        [("block", 0.04, 2)], 0.04, 2, boundaries={"base": "bottom", "right": "right"}
    )
    across = harmonic("block", 1.0) | {"direction": [0.0, 1.0]}
    opens = plate_scene(mesh=block, joint=[opening], support={"fixed_x": ["right"]}, load=[across])
    said = " ".join(assumptions(opens))
    assert "opens and closes" in said
    assert "Held along x, without any give: 'right' at x = 0.04, y = 0 to 0.04, z = 0 m." in said


def test_what_has_no_report_is_refused(tmp_path):
    with pytest.raises(sj.InputError, match=r"has no summary\.json"):
        sj.write_report(tmp_path)
    (tmp_path / "summary.json").write_text("{")
    with pytest.raises(sj.InputError, match="not the JSON"):
        sj.write_report(tmp_path)
    (tmp_path / "summary.json").write_text('{"title": ""}')
    with pytest.raises(sj.InputError, match="another command or an older version"):
        sj.write_report(tmp_path)


def test_a_page_tells_what_acts_in_each_command(tmp_path):
    """The loads of a run, levels and frequencies of a response, a density; none in a curve."""
    made = bar_scene(
        bar="coarse",
        response={"frequencies": {"from": 900.0, "to": 1100.0}, "levels": [0.5, 2.0]},
    )
    (own,) = loads_of(made)
    assert own == "Load on 'free_end': kind harmonic, amplitude 87500 N, frequency 500 Hz."
    first, second = response_loads(made)
    assert first == own
    assert "levels 0.5, 2" in second
    assert "from 900 to 1100 Hz" in second
    (tmp_path / "psd.csv").write_text("Hz,N2/Hz\n20,0.5\n1000,0.25\n", encoding="utf-8")
    shaken = bar_scene(bar="coarse", random={"psd": str(tmp_path / "psd.csv")})
    (said,) = random_loads_of(shaken, "free_end")
    assert "0.5 N²/Hz at 20 Hz, 0.25 N²/Hz at 1000 Hz" in said
    other = premises(made, (), OF_MODES)["assumptions"]
    assert own not in other
    assert OF_MODES[0] in other
    assert "Held in all directions, without any give: 'fixed' at x = 0, y = 0, z = 0 m." in other
