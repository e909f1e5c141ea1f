"""A series of any dimension opens in ParaView itself, and the script for it shows the joint.

Skipped only where ParaView's Python, ``pvpython``, is not installed; drawing needs a display or
``Xvfb`` besides (Debian: ``apt-get install python3-paraview xvfb``).
"""

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from pictured import bar, bars, blocks, lap, pulled

from skfem_joint.output.drawing.pictures import STATES
from skfem_joint.output.fields import CELL_ARRAYS, POINT_ARRAYS
from skfem_joint.output.series import write_load, write_series

SCRIPT = Path(__file__).parents[2] / "examples" / "paraview_joint.py"
#: Structures of every dimension, and the names of their bodies.
PLACES = {
    "bar": (lambda: bar((3.0, 4.0, 0.0)), [""]),
    "bars": (bars, ["body 1", "Stoß"]),
    "plates": (lap, ["body 1", "body 2"]),
    "solids": (blocks, ["below", "above", "contact upper_front", "contact lower_back"]),
}

paraview = pytest.mark.skipif(shutil.which("pvpython") is None, reason="pvpython not installed")
drawing = pytest.mark.skipif(
    shutil.which("pvpython") is None or not (os.environ.get("DISPLAY") or shutil.which("Xvfb")),
    reason="pvpython, or a display or Xvfb for it, not there",
)

LOOK = """
import json, sys
from paraview import servermanager, simple
reader = simple.OpenDataFile(sys.argv[1])
reader.UpdatePipeline()
tree = reader.GetDataInformation().GetHierarchy()
found = {
    "reader": type(reader).__name__,
    "times": list(reader.TimestepValues),
    "blocks": [
        tree.GetAttributeOrDefault(node, "label", "")
        for node in tree.GetChildNodes(tree.GetRootNode(), False)
    ],
    "units": [],
}
for kind, data in (("points", reader.PointData), ("cells", reader.CellData)):
    found[kind] = {array.GetName(): array.GetNumberOfComponents() for array in data}
reader.UpdatePipeline(reader.TimestepValues[2])
found["largest"] = reader.PointData["displacement"].GetRange(-1)[1]
data = servermanager.Fetch(reader)
blocks = data.NewTreeIterator()
while not blocks.IsDoneWithTraversal():
    units = blocks.GetCurrentDataObject().GetFieldData().GetAbstractArray("units")
    found["units"].append([units.GetValue(k) for k in range(units.GetNumberOfValues())])
    blocks.GoToNextItem()
print("FOUND" + json.dumps(found))
"""


@pytest.fixture(scope="module", params=PLACES)
def series(request, tmp_path_factory):
    """Full and reduced model of a structure pulled along its length, their bodies and series."""
    build, bodies = PLACES[request.param]
    frames = pulled(build(), ("full", "reduced"))
    path = tmp_path_factory.mktemp("series") / "fields.pvd"
    write_series(path, frames)
    write_load(path.with_name("fields_load.csv"), frames)
    return frames, bodies, path


def pvpython(*arguments: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    command = ["pvpython", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240.0, **options)


@paraview
@pytest.mark.parametrize("series", ["bars"], indirect=True)
def test_paraview_reads_blocks_times_and_arrays(series, tmp_path):
    frames, bodies, path = series
    (tmp_path / "code.py").write_text(LOOK)
    ended = pvpython(tmp_path / "code.py", path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    (line,) = [line for line in ended.stdout.splitlines() if line.startswith("FOUND")]
    found = json.loads(line.removeprefix("FOUND"))
    assert found["reader"] == "PVDReader"
    assert found["times"] == frames.times.tolist()
    models = ("full", "reduced")
    names = [f"{model}: {body}".removesuffix(": ") for model in models for body in bodies]
    assert found["blocks"] == names
    # What the arrays hold is read back in the tests of the series, by the same library.
    largest = np.linalg.norm(frames.fields[0].displacement[2], axis=1).max()
    assert found["largest"] == pytest.approx(largest, rel=1e-12)
    vectors = {"displacement", "velocity", "slip", "friction_traction"}
    assert found["points"] == {name: 1 + 2 * (name in vectors) for name in POINT_ARRAYS}
    meanings = {f"{name}: {meaning}" for name, meaning in (POINT_ARRAYS | CELL_ARRAYS).items()}
    assert len(found["units"]) == len(names)
    assert all(meanings <= set(units) for units in found["units"])
    assert found["cells"]["stress"] == 6  # components
    assert set(found["cells"]) >= {*CELL_ARRAYS, "body", "region"}
    assert ("thickness" in found["cells"]) == (frames.structure.dim < 3)


@pytest.mark.slow
@paraview
@pytest.mark.parametrize("series", ["bars"], indirect=True)
def test_without_a_display_the_script_draws_or_says_what_is_missing(series, tmp_path):
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    picture = tmp_path / "a.png"
    ended = pvpython(SCRIPT, series[2], picture, env=environment)
    if ended.returncode == 0:  # built for EGL or OSMesa
        assert matplotlib.image.imread(picture).std() > 0.05
    else:
        assert ended.returncode == 1
        assert "xvfb-run" in ended.stderr
        assert "Traceback" not in ended.stderr
        assert not picture.exists()


@pytest.fixture(scope="module")
def display():
    """Environment with a display: the one that is there, or a server that says when it listens."""
    if os.environ.get("DISPLAY"):
        yield dict(os.environ)
        return
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1400x900x24", "-noreset"]
    with subprocess.Popen(command, pass_fds=[writing], stderr=subprocess.DEVNULL) as server:
        os.close(writing)
        with open(reading, encoding="ascii") as told:
            number = told.readline().strip()
        try:
            yield {**os.environ, "DISPLAY": f":{number}"}
        finally:
            server.terminate()


@pytest.mark.slow
@drawing
@pytest.mark.parametrize("series", ["bars", "solids"], indirect=True)
def test_the_script_draws_the_joint_and_the_mark_on_its_load(series, tmp_path, display):
    picture = tmp_path / "a.png"
    ended = pvpython(SCRIPT, series[2], picture, "--time", "5e-4", env=display)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    pixels = matplotlib.image.imread(picture)[..., :3]
    assert pixels.shape == (900, 1400, 3)
    joint = pixels[: int(0.6 * 900)]
    for colour in STATES.values():
        close = np.linalg.norm(joint - matplotlib.colors.to_rgb(colour), axis=-1) < 0.12
        assert close.mean() > 0.004, colour
    mark = np.linalg.norm(pixels[int(0.63 * 900) :] - (0.82, 0.12, 0.12), axis=-1) < 0.12
    assert mark.sum() > 20


def test_the_script_and_the_package_use_the_same_words_and_colours():
    text = SCRIPT.read_text(encoding="utf-8")
    for name, colour in STATES.items():
        parts = matplotlib.colors.to_rgb(colour)
        assert f'"{name}", ({", ".join(f"{part:.2f}" for part in parts)})' in text
