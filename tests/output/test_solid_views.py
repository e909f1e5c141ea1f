"""What the command writes of a scene of solids, as pyvista and ParaView show it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import pyvista
from test_paraview_script import in_paraview, paraview
from test_solid_scenes import FILES, SCENE

from skfem_joint.cli import main
from skfem_joint.output.fields import CELL_ARRAYS, POINT_ARRAYS

BODIES = ["full: lower", "full: upper"]
FACES = ["full: contact upper below", "full: contact lower above"]
#: Components of the arrays that are no numbers.
COMPONENTS = {name: 3 for name in ("displacement", "velocity", "slip", "friction_traction")} | {
    "stress": 6
}
LOOK = """
import json, sys
from paraview import servermanager, simple
reader = simple.OpenDataFile(sys.argv[1])
reader.UpdatePipeline(reader.TimestepValues[-1])
data = servermanager.Fetch(reader)
found, blocks = {"names": [], "arrays": [], "units": []}, data.NewTreeIterator()
while not blocks.IsDoneWithTraversal():
    grid, words = blocks.GetCurrentDataObject(), []
    found["names"].append(blocks.GetCurrentMetaData().Get(data.NAME()))
    arrays = {}
    for values in (grid.GetPointData(), grid.GetCellData()):
        for k in range(values.GetNumberOfArrays()):
            arrays[values.GetArrayName(k)] = values.GetArray(k).GetNumberOfComponents()
    units = grid.GetFieldData().GetAbstractArray("units")
    found["arrays"].append(arrays)
    found["units"].append([units.GetValue(k) for k in range(units.GetNumberOfValues())])
    blocks.GoToNextItem()
print("FOUND" + json.dumps(found))
"""


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fields of a run of two blocks of hexahedra of twenty nodes."""
    folder = tmp_path_factory.mktemp("run")
    text = SCENE.format(folder=FILES.as_posix(), kind="hex20")
    (folder / "scene.toml").write_text(f"{text}[output]\nvtk = true\nframes = 4\n")
    assert main(["--quiet", "run", str(folder / "scene.toml"), "--out", str(folder / "out")]) == 0
    return folder / "out" / "fields.pvd"


def in_pyvista(index: Path) -> dict[str, Any]:
    reader = pyvista.PVDReader(index)
    reader.set_active_time_value(reader.time_values[-1])
    blocks = reader.read()[0]
    arrays = [{name: 1 if (one := grid[name]).ndim == 1 else one.shape[1] for name in (
        *grid.point_data, *grid.cell_data)} for grid in blocks]  # fmt: skip
    units = [[str(word) for word in grid.field_data["units"]] for grid in blocks]
    return {"names": blocks.keys(), "arrays": arrays, "units": units}


@pytest.mark.parametrize("program", ["pyvista", pytest.param("ParaView", marks=paraview)])
def test_blocks_have_names_arrays_units_and_vectors_three_components(
    index: Path, tmp_path: Path, program: str
) -> None:
    found = in_pyvista(index) if program == "pyvista" else in_paraview(LOOK, index, folder=tmp_path)
    assert found["names"] == [*BODIES, *FACES]
    for arrays, units in zip(found["arrays"], found["units"], strict=True):
        assert {*POINT_ARRAYS, *CELL_ARRAYS} <= {*arrays}
        for name, meaning in (POINT_ARRAYS | CELL_ARRAYS).items():
            assert arrays[name] == COMPONENTS.get(name, 1)
            assert f"{name}: {meaning}" in units
