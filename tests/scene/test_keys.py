"""The reference of keys: complete, as its page has it, and found by name."""

import io
from pathlib import Path

from rich.console import Console

from skfem_joint import cli
from skfem_joint.scene import Scene
from skfem_joint.scene.joint_tables import JointTable
from skfem_joint.scene.keys import markdown, reference, show
from skfem_joint.scene.matrices import MatricesTable

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "keys.md"
#: Keys that hold pure numbers: factors, ratios and relative errors.
PURE = {
    *("poisson", "friction", "ratio", "rho_infinity", "displacement", "energy", "levels", "up_to"),
    *("gap_scale", "axes"),
    "acceleration_g",
    *("axis", "direction"),  # their length does not count
    *("sweep.KEY.from", "sweep.KEY.to"),  # in the unit of the key they stand for
    *("reduction.range.slip", "reduction.range.KEY"),
}


def test_the_page_says_what_the_code_does():
    assert PAGE.read_text(encoding="utf-8") == markdown(reference()), (
        "make it again: skfem-joint keys > docs/reference/keys.md"
    )


def test_every_key_has_a_meaning_and_every_quantity_a_unit():
    tables = reference()
    assert set(Scene.model_fields) == {row.key for row in tables[0].keys}
    assert set(Scene.model_fields) - {"title"} == {t.path.split(".")[0] for t in tables} - {""}
    for table in tables:
        assert table.title, table
        assert table.meaning, table
        for row in table.keys:
            where = f"{table.path}.{row.key}".replace('"TABLE.KEY"', "KEY")
            assert row.meaning, where
            assert row.allowed, where
            if "number" in row.allowed.replace("whole number", ""):
                assert row.unit or {where, row.key} & PURE, where


def test_help_of_a_table_has_the_meaning_of_each_key():
    for table in (Scene, JointTable, MatricesTable):
        for name, field in table.model_fields.items():
            assert f"\n{name}\n    {field.description}" in table.__doc__


def test_a_table_is_shown_by_its_name(capsys):
    assert cli.main(["keys", "joint.pressure"]) == 0
    shown = capsys.readouterr().out
    assert "| `head_radius` | m | required | number > 0 |" in shown
    assert "clamping" in shown
    assert "| `law` |" not in shown
    assert cli.main(["keys"]) == 0
    assert capsys.readouterr().out == PAGE.read_text(encoding="utf-8")
    assert cli.main(["keys", "laod"]) == 2
    assert "did you mean 'load'" in capsys.readouterr().err


def test_a_terminal_shows_all_of_it_at_any_width():
    for width in (60, 200):
        stream = io.StringIO()
        show(reference(), Console(file=stream, width=width))
        text = stream.getvalue()
        assert max(map(len, text.splitlines())) <= width
        for table in reference():
            assert all(row.key in text for row in table.keys)
