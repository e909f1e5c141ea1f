"""Scenes of bars and plates for the tests of analysis, in SI units; changes are by table."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from skfem_joint.mesh import NamedMesh, build_bar, build_plate, merged, write_mesh
from skfem_joint.scene import Scene, scene_from
from skfem_joint.study.premises import scene_text

WIDTH, THICKNESS, MU = 0.05, 0.01, 0.7
LENGTH, ELEMENTS = 0.25, 25

STRUCTURE = {"fixed": 0.0, "junction": 0.1, "free_end": 0.6}
#: Regions and points of bars; all are held at ``fixed``.
BARS: dict[str, tuple[list[tuple[str, float, int]], dict[str, float]]] = {
    # The structure of Fig. 18.
    "structure": ([("joint", 0.1, 100), ("linear", 0.5, 100)], STRUCTURE),
    "two_joints": (
        [("left", 0.1, 50), ("middle", 0.4, 40), ("right", 0.1, 50)],
        {"fixed": 0.0, "centre": 0.3, "end": 0.6},
    ),
    "inner_joint": (
        [("a", 0.2, 20), ("joint", 0.2, 100), ("b", 0.2, 20)],
        {"fixed": 0.0, "loaded_end": 0.2, "free_end": 0.6},
    ),
    "coarse": ([("joint", 0.1, 4), ("linear", 0.5, 10)], STRUCTURE),
    "lap_joint": ([("joint", LENGTH, 100)], {"fixed": 0.0, "free_end": LENGTH}),
    "short_lap_joint": ([("joint", LENGTH, 40)], {"fixed": 0.0, "free_end": LENGTH}),
}


def harmonic(
    on: str = "free_end", amplitude: float = 87.5e3, frequency: float = 500.0
) -> dict[str, Any]:
    return {"on": on, "kind": "harmonic", "amplitude": amplitude, "frequency": frequency}


def joint(on: str = "joint", **changes: Any) -> dict[str, Any]:
    law = {} if "law" in changes else {"beta": 1e5}
    return {"on": on, "pressure": 50e6, "friction": MU, "normal_force": "equal"} | law | changes


def bar_tables(*run: str, **changes: Any) -> dict[str, Any]:
    """Tables of the structure of Fig. 18; of ``run`` full and reduced if not given."""
    base: dict[str, Any] = {
        "mesh": {"file": "bar.msh"},
        "material": {"E": 200e9, "density": 8000.0},
        "section": {"width": WIDTH, "thickness": THICKNESS},
        "support": {"fixed": ["fixed"]},
        "joint": [joint()],
        "damping": {"stiffness": 1e-5},
        "load": [harmonic()],
        "time": {"cycles": 12},
        "models": {"run": list(run) or ["full", "reduced"]},
        "reduction": {"reference": "paper"},
    }
    return base | changes


def bar_scene(*run: str, bar: str | NamedMesh = "structure", **changes: Any) -> Scene:
    mesh = build_bar(*BARS[bar]) if isinstance(bar, str) else bar
    return scene_from(bar_tables(*run, **changes), mesh)


def scene_file(folder: Path, scene: Scene) -> Path:
    """File of a scene, with its mesh beside it."""
    write_mesh(scene.named_mesh, folder / str(scene.mesh.file))
    path = folder / "scene.toml"
    path.write_text(scene_text(scene), encoding="utf-8")
    return path


def lap_joint(
    *run: str, bar: str | NamedMesh = "lap_joint", beta: float = 1e5, **changes: Any
) -> Scene:
    """The paper's reference system: 63 kN at 1 kHz on 0.25 m pressed with 8 MPa."""
    law: Mapping[str, Any] = {"beta": beta} if beta < float("inf") else {"law": "coulomb"}
    values: dict[str, Any] = {
        "joint": [joint(pressure=8e6, **law)],
        "load": [harmonic(amplitude=63e3, frequency=1000.0)],
        "time": {"cycles": 3, "steps_per_cycle": 50},
    }
    return bar_scene(*(run or ("full",)), bar=bar, **(values | changes))


def plate_tables(*run: str, **changes: Any) -> dict[str, Any]:
    """Tables of the reference system as a plate without Poisson effect."""
    base: dict[str, Any] = {
        "mesh": {"file": "plate.msh"},
        "material": {"E": 200e9, "density": 8000.0, "poisson": 0.0},
        "section": {"thickness": THICKNESS},
        "support": {"fixed": ["left"]},
        "joint": [{"on": "joint", "pressure": 8e6, "friction": MU, "beta": 1e5}],
        "damping": {"stiffness": 1e-5},
        "load": [harmonic("right", 63e3, 1000.0) | {"direction": [1.0, 0.0]}],
        "time": {"cycles": 3, "steps_per_cycle": 100},
        "models": {"run": list(run) or ["full", "reduced"]},
    }
    return base | changes


def plate(elements: int = ELEMENTS, **options: Any) -> NamedMesh:
    return build_plate([("joint", LENGTH, elements)], WIDTH, 2, **options)


def plate_scene(*run: str, mesh: NamedMesh | None = None, **changes: Any) -> Scene:
    return scene_from(plate_tables(*run, **changes), mesh or plate())


def two_plates(*run: str, **changes: Any) -> Scene:
    """Two plates of 0.2 m that overlap by 0.1 m, pulled apart with half of what friction holds."""
    lower = build_plate([("linear", 0.1, 3), ("joint", 0.1, 4)], WIDTH, 2)
    strips = [("upper_joint", 0.1, 5), ("upper_linear", 0.1, 3)]
    upper = build_plate(strips, WIDTH, 2, origin=(0.1, 0.0), prefix="upper_")
    values: dict[str, Any] = {
        "joint": [joint("upper_joint", against="joint", pressure=8e6, normal_force="consistent")],
        "load": [harmonic("upper_right", 14e3, 1000.0) | {"direction": [1.0, 0.0]}],
        "material": {"E": 200e9, "density": 8000.0, "poisson": 0.3},
    }
    return plate_scene(*run, mesh=merged([lower, upper]), **(values | changes))
