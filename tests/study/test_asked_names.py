"""Names that a command refuses are refused by `check` before, in the same words."""

import pytest
import tomlkit
from joint_scenes import BARS, bar_tables, harmonic

from skfem_joint.cli import main
from skfem_joint.mesh import build_bar, write_mesh

DENSITY = {"psd": "density.csv"}
FREQUENCIES = {"from": 100.0, "to": 200.0, "points": 2}
TWO = [harmonic(), harmonic("junction")]


@pytest.mark.parametrize(
    ("command", "tables", "words"),
    [
        (
            "backbone", {"backbone": {"at": {"point": "tip", "force": [1.0]}}},
            "backbone.at.point: found 'tip', must be one of free_end",
        ),
        (
            "backbone", {"backbone": {"modes": [1, 900]}},
            "backbone.modes: found mode 900, there are 10 with the contact stuck",
        ),
        (
            "backbone", {"backbone": {"ring_down": 8, "released": "loads"}},
            "backbone.released: found 'loads', which must be pulses that end",
        ),
        (
            "nonlinear-modes", {"nonlinear_modes": {"amplitudes": [1e-4], "at": "tip"}},
            "nonlinear_modes.at: found 'tip', must be one of free_end",
        ),
        (
            "nonlinear-modes", {"nonlinear_modes": {"amplitudes": [1e-4], "modes": [900]}},
            "nonlinear_modes.modes: found mode 900, there are 10",
        ),
        ("random", {"random": DENSITY | {"load": "tip"}}, "random.load: found 'tip', must be one"),
        ("random", {"random": DENSITY, "load": TWO}, "random.load: found None, must be one of"),
        ("random", {"random": {"psd": ["density.csv"] * 3}}, "random.psd: found 3 densities"),
        (
            "random", {"random": DENSITY, "backbone": {"modes": [900]}},
            "backbone.modes: found mode 900",
        ),
        (
            "response",
            {"response": {"frequencies": FREQUENCIES, "functions": ["transmissibility"]}},
            "response.functions: found 'transmissibility', which needs a base that moves",
        ),
        (
            "response", {"response": {"frequencies": FREQUENCIES}, "backbone": {"modes": [900]}},
            "backbone.modes: found mode 900",
        ),
        (
            "run", {"reduction": {"active_length": {"seam": 0.1}}, "models": {"run": ["full"]}},
            "reduction.active_length.seam: found 'seam', which is no joint",
        ),
    ],
)  # fmt: skip
def test_check_refuses_what_a_command_refuses(command, tables, words, tmp_path, capsys):
    (tmp_path / "density.csv").write_text("1,2\n9,2\n", encoding="utf-8")
    write_mesh(build_bar(*BARS["coarse"]), tmp_path / "bar.msh")
    file = tmp_path / "scene.toml"
    file.write_text(tomlkit.dumps(bar_tables("full", reduction={}) | tables), encoding="utf-8")
    said = []
    for arguments in (["check", str(file)], [command, str(file), "--out", str(tmp_path / "out")]):
        assert main(arguments) == 2
        said.append(capsys.readouterr().err.partition("skfem-joint: ")[2])
    assert words in said[0]
    assert said[0] == said[1]


def test_a_response_does_not_ask_for_the_loads_of_a_ring_down(tmp_path):
    """One scene serves both, though its harmonic load releases no mode."""
    write_mesh(build_bar(*BARS["coarse"]), tmp_path / "bar.msh")
    file = tmp_path / "scene.toml"
    more = {
        "response": {"frequencies": FREQUENCIES},
        "backbone": {"ring_down": 8, "released": "loads"},
    }
    file.write_text(tomlkit.dumps(bar_tables("full", reduction={}) | more), encoding="utf-8")
    assert main(["response", str(file), "--out", str(tmp_path / "out")]) == 0
