"""What results of a scene rest on: its structure, what is assumed, its text.

`premises` stand in the ``summary.json`` of commands, from which ``skfem-joint report`` makes its
page: what a reader has to know before he relies on a number.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from skfem_joint.ground.arrays import evenly
from skfem_joint.ground.files import read_text
from skfem_joint.scene import Scene
from skfem_joint.scene.joint_tables import BoltPressureTable
from skfem_joint.scene.tables import MaterialOverride, MaterialTable, RandomTable


def premises(
    scene: Scene, facts: Iterable[str], acting: Iterable[str] | None = None
) -> dict[str, Any]:
    """Structure, assumptions and notes of a scene, and the scene itself.

    ``facts`` are sentences about the structure, ``acting`` about what acts, where it is not the
    scene's loads as they are.

    Returns
    -------
    dict
        ``structure``, ``assumptions`` and ``notes`` of the structure (lists of sentences), and
        ``scene`` (str), the scene as a file has it: the text of its own file if it still says the
        same, with its comments; else all of its keys that were given.
    """
    return {
        "structure": [*facts, *_files(scene)],
        "assumptions": [*assumptions(scene), *(loads_of(scene) if acting is None else acting)],
        "notes": [*scene.left_out, *scene.system().notes],
        "scene": scene_text(scene),
    }


def _files(scene: Scene) -> Iterator[str]:
    """Sentence about the files that a scene is of."""
    if scene.has_file:
        names = () if scene.mesh is None else scene.mesh.paths(scene.path.parent)
        of = f", mesh {', '.join(repr(path.name) for path in names)}" if names else ""
        yield f"Scene {scene.path.name!r}{of}."


def scene_text(scene: Scene) -> str:
    """Text of a scene as TOML; its comments are there unless values were changed since."""
    import tomlkit

    given = scene.model_dump(mode="json", exclude_unset=True, exclude_none=True, by_alias=True)
    if scene.has_file:
        text = read_text(scene.path)
        if tomllib.loads(text) == given:
            return text
    return tomlkit.dumps(given)


def assumptions(scene: Scene) -> Iterator[str]:
    """What is assumed of a scene's material, joints, bolts, damping and motion, in sentences."""
    yield from _of_material(scene)
    yield from _of_supports(scene)
    yield from _of_joints(scene)
    yield from _of_damping(scene)
    if scene.time.quasi_static:
        yield "Loads change so slowly that inertia and viscous damping do not matter."


def loads_of(scene: Scene) -> Iterator[str]:
    """A sentence about each load of a scene, its course over time included."""
    for load in scene.load:
        where = f"the supports along {load.base}" if load.base else f"'{load.on}'"
        unit = "m/s²" if load.base else {"force": "N"}.get(load.quantity, "Pa")
        units = _UNITS | {"amplitude": unit, "peak": unit}
        values = load.model_dump(exclude=_OF_PLACE, exclude_unset=True, exclude_none=True)
        yield f"Load on {where}: {_named(values, units)}."


def response_loads(scene: Scene) -> Iterator[str]:
    """What acts in a response: the loads at the levels and frequencies of [response]."""
    yield from loads_of(scene)
    if scene.response is not None:
        levels = ", ".join(f"{level:g}" for level in scene.response.levels)
        band = scene.response.frequencies
        yield (
            f"These loads are multiplied by the levels {levels}, and their first frequency goes "
            f"from {band.from_:g} to {band.to:g} Hz; each vibration is steady."
        )
        if scene.response.sweep_rates:
            rates = ", ".join(f"{rate:g}" for rate in scene.response.sweep_rates)
            yield (
                f"Beside them sines are swept up and down through these frequencies, from rest, at "
                f"{rates} octaves a minute."
            )


#: Points of a density that are told, the first and the last among them.
_POINTS = 12


def random_loads_of(scene: Scene, acts: str) -> Iterator[str]:
    """What acts in random vibration, of the loads of a scene or of that one which ``acts``."""
    table: RandomTable = scene.asked("random")
    several, named = not isinstance(table.psd, str), {x.on: x for x in reversed(scene.load)}
    places = [load.on for load in scene.system().loads] if several else [acts]
    for place, density in zip(places, table.densities, strict=True):
        unit = "g²/Hz" if table.unit == "g2/Hz" else "(m/s²)²/Hz"
        if table.unit != "g2/Hz" and place in named:
            unit = "N²/Hz" if named[place].quantity == "force" else "Pa²/Hz"
        f, values = density.frequencies, density.values
        some = evenly(len(values), _POINTS)
        pairs = zip(f[some].tolist(), values[some].tolist(), strict=True)
        shown = ", ".join(f"{value:.4g} {unit} at {x:g} Hz" for x, value in pairs)
        yield (
            f"Stationary random load on '{place}', in place of its course over time: density of "
            f"one side {shown}, straight between on logarithmic axes and zero beyond."
        )
    if several:
        yield "These loads act without correlation."


#: What acts in curves of modes.
OF_MODES = (
    "Each mode vibrates by itself, slowly compared with what it loses in a cycle, in the shape "
    "that a slow load of its inertia gives it; loads of the scene only name points and directions.",
)
#: Keys of a load that say where it acts.
_OF_PLACE = {"on", "base"}
_UNITS = {"frequency": "Hz", "rise_time": "s", "start": "s", "duration": "s", "phase": "rad"}


def _named(values: dict[str, Any], units: Mapping[str, str]) -> str:
    """Values of a table with their names and units, the plain ones."""
    parts = []
    for name, value in values.items():
        shown = f"{value:g}" if isinstance(value, float) else value
        parts.append(f"{name.replace('_', ' ')} {shown} {units.get(name, '')}".strip())
    return ", ".join(parts)


def _of_supports(scene: Scene) -> Iterator[str]:
    """What holds the structure."""
    for name, how in (
        ("fixed", "in all directions"),
        *((f"fixed_{axis}", f"along {axis}") for axis in "xyz"),
    ):
        if held := getattr(scene.support, name):
            parts = ", ".join(f"{part!r}{_where(scene, part)}" for part in held)
            yield f"Held {how}, without any give: {parts}."


def _where(scene: Scene, part: str) -> str:
    """Ranges of the coordinates of a part of a scene's mesh, in words; empty without nodes."""
    body = scene.structure().body
    if body is None:
        return ""
    at = body.positions[body.nodes_of(part)]
    both = zip("xyz", at.min(axis=0).tolist(), at.max(axis=0).tolist(), strict=False)
    ranges = (
        f"{axis} = {' to '.join(dict.fromkeys((f'{low:.4g}', f'{high:.4g}')))}"
        for axis, low, high in both
    )
    return f" at {', '.join(ranges)} m"


def _of_material(scene: Scene) -> Iterator[str]:
    if scene.material is None:
        yield (
            "Displacements are small. The structure is linear but for its joints: mass and "
            "stiffness are the given matrices."
        )
        return
    yield "Displacements and strains are small, and the material is linear elastic."
    yield f"Material: {_properties(scene.material)}."
    for name, region in scene.material.regions.items():
        yield f"Material of '{name}': {_properties(region)}."
    dimension = scene.named_mesh.mesh.dim()
    if dimension == 1:
        yield "Bars move along their axis alone; they do not bend."
    if dimension == 2:
        yield f"Plates move in their plane alone, in plane {scene.section.plane}."


def _properties(table: MaterialTable | MaterialOverride) -> str:
    values = {
        "modulus of elasticity": table.E,
        "density": table.density,
        "Poisson's ratio": table.poisson,
    }
    known = {name: value for name, value in values.items() if value is not None}
    return _named(known, {"modulus of elasticity": "Pa", "density": "kg/m³"})


def _of_joints(scene: Scene) -> Iterator[str]:
    if not scene.joint:
        yield "No joint has friction."
        return
    for joint in scene.joint:
        law = (
            "Coulomb's law"
            if joint.beta is None
            else f"the arctan law with beta = {joint.beta:g} s/m, which creeps"
        )
        against = f"against '{joint.against}'" if joint.against else "on a rigid base"
        text = (
            f"Joint '{joint.on}' {against}: {law} with a friction coefficient of "
            f"{joint.friction:g}, the same at rest, in slip, and in all directions"
        )
        if joint.tangential_stiffness is not None:
            text += f"; its surfaces yield to slip by {joint.tangential_stiffness:g} Pa/m"
        yield f"{text}."
        if isinstance(joint.pressure, BoltPressureTable):
            yield from _of_rings(joint.on, joint.pressure)
        yield (
            f"Joint '{joint.on}' opens and closes: its normal force follows the motion."
            if joint.contact == "unilateral"
            else f"Joint '{joint.on}' keeps the normal force that it has at rest, and stays closed."
        )
    if scene.bolt:
        forces = ", ".join(f"{bolt.force:g}" for bolt in scene.bolt)
        yield (
            f"Clamp forces of the bolts ({forces} N) do not change in time, and nothing slips "
            "while bolts are tightened."
        )


def _of_rings(joint: str, pressure: BoltPressureTable) -> Iterator[str]:
    """Where bolts press that are given by their places, numbered as in results."""
    for number, bolt in enumerate(pressure.bolts, 1):
        at = ", ".join(f"{x:g}" for x in bolt.at)
        yield (
            f"{joint}_bolt_{number} presses with {bolt.force:g} N at ({at}) m, evenly over the "
            "cone below its head."
        )


def damping_given(scene: Scene) -> str:
    """Keys that give the viscous damping of a scene, in words."""
    if scene.matrices is not None and scene.matrices.C:
        return "given, [matrices] C"
    keys = [key for key in ("ratio", "stiffness", "mass") if getattr(scene.damping, key)]
    return f"given, [damping] {' and '.join(keys)}"


def _of_damping(scene: Scene) -> Iterator[str]:
    damping = scene.damping
    if damping.ratio is not None:
        yield f"Beside friction, viscous damping of {100.0 * damping.ratio:g} % of the critical."
    elif damping.stiffness or damping.mass:
        parts = [
            f"{factor:g} {unit} times the {of}"
            for factor, unit, of in (
                (damping.stiffness, "s", "stiffness"),
                (damping.mass, "1/s", "mass"),
            )
            if factor
        ]
        yield f"Beside friction, viscous damping by a matrix of {' and '.join(parts)}."
    elif scene.matrices is not None and scene.matrices.C:
        yield "Beside friction, viscous damping by the given matrix."
    else:
        yield "Friction is the only damping."
