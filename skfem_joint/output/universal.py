"""Universal files (UFF), which programs of modal test open: geometry, mode shapes, responses.

Their text is written by pyuff; here stands what goes into which data set.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError, listed
from skfem_joint.ground.files import needed, replacing
from skfem_joint.output.series import corners_of, once
from skfem_joint.results.natural_modes import NaturalModes, natural_modes
from skfem_joint.scene import Scene
from skfem_joint.structure.structure import Structure
from skfem_joint.system.system import System
from skfem_joint.vibration.backbone import Backbone
from skfem_joint.vibration.response_curve import Curve, frequency_response

#: Elements of data set 2412 by dimension and corners: rod or beam as line, thin plate, solid.
_ELEMENTS = {(2, 3): 41, (2, 4): 44, (3, 4): 111, (3, 6): 112, (3, 8): 115}
_STEEL_GREY = 8


def write_uff(
    path: str | Path,
    structure: Structure,
    system: System,
    *,
    modes: NaturalModes | None = None,
    curves: Sequence[Curve] = (),
    backbones: Sequence[Backbone] = (),
) -> Path:
    """Write geometry, mode shapes and frequency responses as a universal file.

    Parameters
    ----------
    path : str or Path
        File with the ending ``.uff`` or ``.unv``; one that is there is replaced.
    structure : Structure
        With a mesh of N displacement nodes, which get the numbers 1 to N in their order.
    system : System
        The full model of the structure, with its loads.
    modes : NaturalModes, optional
        Of the system: real modes of unit modal mass (data set 55).
    curves : sequence of Curve
        Responses of the system or of a smaller model of it, to one harmonic load: for each named
        point and level the first harmonic over the force, m/N (data set 58). What was not found is
        left out. The node is the one with most weight in the point's displacement.
    backbones : sequence of Backbone
        Of the system: the shape of each mode at each level, of unit modal mass, with its frequency,
        damping ratio (as viscous) and loss factor (as hysteretic) there (data set 55, whose load
        case is the number of the level).

    Returns
    -------
    Path

    Raises
    ------
    InputError
        For another ending, modes or curves of another system, several loads beside curves, a file
        that cannot be written, and without pyuff.

    Notes
    -----
    Data sets 164 (SI units), 2411 (nodes) and 2412 (elements; 82, lines, for bars), 55 and 58, as
    the University of Cincinnati describes them. Elements of second order come as linear ones.
    """
    pyuff, path = needed("pyuff", "uff"), Path(path)
    if path.suffix.lower() not in (".uff", ".unv"):
        raise InputError(f"{path}: found ending {path.suffix!r}, must be '.uff' or '.unv'")
    if system.origin is not None or system.T is None or system.T.shape[0] != structure.n_dofs:
        raise InputError(
            "system: is not the full model of this structure; give structure.system(loads)"
        )
    sets = [
        *_geometry(structure),
        *(_shapes(structure, system, modes) if modes is not None else ()),
        *(each for curve in backbones for each in _levels(structure, system, curve)),
        *_responses(structure, system, curves),
    ]
    with replacing(path) as temporary:
        pyuff.UFF(str(temporary)).write_sets(sets, "overwrite")
    return path


def check_uff(scene: Scene) -> None:
    """See that a scene's universal file, if it asks for one, can be written; else InputError."""
    if scene.output.uff:
        needed("pyuff", "uff")
        scene.structure().meshed("a universal file needs a mesh")


def scene_uff(
    path: Path, scene: Scene, curves: Sequence[Curve] = (), backbones: Sequence[Backbone] = ()
) -> Path:
    """Universal file of a scene: geometry, lowest modes with the joints stuck, and results.

    Stuck modes are left out beside modes at levels.
    """
    structure, system = scene.structure().meshed("a universal file needs a mesh"), scene.system()
    modes = None if backbones else natural_modes(system, joints="stuck")
    return write_uff(path, structure, system, modes=modes, curves=curves, backbones=backbones)


def _geometry(structure: Structure) -> Iterator[dict[str, Any]]:
    yield {
        "type": 164, "units_code": 1, "units_description": "SI", "temp_mode": 1,
        "length": 1.0, "force": 1.0, "temp": 1.0, "temp_offset": 273.15,
    }  # fmt: skip
    at = structure.positions
    count = len(at)
    yield {
        "type": 2411, "node_nums": np.arange(1, count + 1), "def_cs": np.zeros(count, int),
        "disp_cs": np.zeros(count, int), "color": np.full(count, _STEEL_GREY),
        "x": at[:, 0], "y": at[:, 1], "z": at[:, 2],
    }  # fmt: skip
    corners = corners_of(structure) + 1
    if structure.dim == 1:
        # Each line is followed by a 0, which lifts the pen.
        lines = np.column_stack([corners, np.zeros(len(corners), int)]).ravel()
        yield {
            "type": 82, "trace_num": 1, "n_nodes": lines.size, "color": _STEEL_GREY,
            "id": "bars", "nodes": lines,
        }  # fmt: skip
        return
    numbered: dict[Any, Any] = {"type": 2412}
    # Prisms, and triangles beside quadrilaterals, are cells some of whose corners coincide.
    kept = once(corners) if (structure.dim, corners.shape[1]) in ((2, 4), (3, 8)) else None
    for number, nodes in enumerate(corners, 1):
        own = nodes if kept is None else nodes[kept[number - 1]]
        kind = _ELEMENTS[structure.dim, own.size]
        element = {
            "element_nums": number, "fe_descriptor": kind, "phys_table": 1, "mat_table": 1,
            "color": _STEEL_GREY, "num_nodes": own.size, "nodes_nums": own.tolist(),
        }  # fmt: skip
        numbered.setdefault(kind, []).append(element)
    yield numbered


def _shapes(structure: Structure, system: System, modes: NaturalModes) -> Iterator[dict[str, Any]]:
    _check_unknowns("modes", len(modes.modes), system)
    for number, frequency in enumerate(modes.frequencies.tolist(), 1):
        shape, name = modes.modes[:, number - 1], f"mode {number}, {frequency:.6g} Hz"
        yield _shape(structure, system, shape) | {"id1": name, "mode_n": number, "freq": frequency}


def _levels(structure: Structure, system: System, curve: Backbone) -> Iterator[dict[str, Any]]:
    _check_unknowns("backbones", curve.shape.size, system)
    for k, (state, frequency) in enumerate(
        zip(curve.states, curve.frequency.tolist(), strict=True)
    ):
        shape = state / np.sqrt(state @ (system.M @ state))
        level = f"level {curve.level[k] / curve.slips_at:.4g} of slip as a whole"
        yield _shape(structure, system, shape) | {
            "id1": f"mode {curve.mode}, {frequency:.6g} Hz, {level}", "load_case": k + 1,
            "mode_n": curve.mode, "freq": frequency,
            "modal_damp_vis": float(curve.damping_ratio[k]),
            "modal_damp_his": float(curve.losses.loss_factor[k]),
        }  # fmt: skip


def _check_unknowns(name: str, count: int, system: System) -> None:
    if count != system.n:
        raise InputError(f"{name}: have {count} unknowns, must be of the system, with {system.n}")


def _shape(structure: Structure, system: System, shape: FloatArray) -> dict[str, Any]:
    """Data set of a shape of unit modal mass, (n,), but for its names and frequency."""
    x, y, z = structure.body.in_space(structure.unpacked(system.expand(shape))).T
    return {
        "type": 55, "model_type": 1, "analysis_type": 2, "data_ch": 2, "spec_data_type": 8,
        "load_case": 1, "modal_m": 1.0, "node_nums": np.arange(1, len(structure.nodes) + 1),
        "r1": x, "r2": y, "r3": z,
    }  # fmt: skip


def over_one_force(system: System) -> bool:
    """Whether responses of a system have a force that they can be taken over."""
    return len(system.loads) == 1 and system.loads[0].carried is None


def _responses(
    structure: Structure, system: System, curves: Sequence[Curve]
) -> Iterator[dict[str, Any]]:
    if not curves:
        return
    if not over_one_force(system):
        where = listed([load.on for load in system.loads])
        raise InputError(
            f"curves: found {len(system.loads)} loads on {where}, must be one force on a part, "
            "over which responses are taken"
        )
    rows = zip(system.points, np.asarray(system.P.toarray()), strict=True)
    places = [_place(structure, system, *row) for row in rows]
    for curve in curves:
        if curve.points[0].amplitude.size != len(places):
            raise InputError("curves: have other named points than the system")
        known = np.isfinite(curve.column("harmonics")[:, :, 0]).all(axis=1)
        x = curve.column("frequency")[known]
        for name, (node, direction) in zip(system.points, places, strict=True):
            if x.size < 2:  # no function
                continue
            yield {
                "type": 58, "id1": f"{name}, level {curve.level:g}", "func_type": 4,
                "rsp_ent_name": name[:10], "rsp_node": node, "rsp_dir": direction,
                "ref_ent_name": str(system.loads[0].on)[:10], "ref_node": places[0][0],
                "ref_dir": places[0][1], "load_case_id": 0, "x": x, "abscissa_spacing": 0,
                "data": frequency_response(system, curve, name)[known, 0],
                "abscissa_spec_data_type": 18, "abscissa_axis_lab": "Frequency",
                "abscissa_axis_units_lab": "Hz", "ordinate_spec_data_type": 8,
                "ordinate_axis_lab": "Displacement", "ordinate_axis_units_lab": "m",
                "orddenom_spec_data_type": 13, "orddenom_axis_lab": "Force",
                "orddenom_axis_units_lab": "N",
            }  # fmt: skip


def _place(structure: Structure, system: System, label: str, row: FloatArray) -> tuple[int, int]:
    """Node with most weight in a named point's displacement, and its direction.

    1 to 3 are x to z, -1 to -3 against them, 0 any other direction. The row on the unknowns alone
    does not tell: at a joint both bodies move with an unknown, and closed contact turns it.
    """
    names = {*structure.mesh.points, *structure.mesh.boundaries, *structure.mesh.regions}
    name, _, end = label.rpartition(".")
    weights = structure.body.in_space(structure.unpacked(system.T @ row))
    size, along = np.linalg.norm(weights, axis=1), weights.sum(axis=0)
    if label in names or name in names:
        size = structure.body.even_shares(label if label in names else name)
    node = int(size.argmax()) + 1
    if label not in names and name in names and end in ("x", "y", "z"):
        return node, "xyz".index(end) + 1
    axis = int(np.abs(along).argmax())
    straight = abs(along[axis]) > (1.0 - 1e-9) * float(np.linalg.norm(along))
    return node, int(np.sign(along[axis])) * (axis + 1) if straight else 0
