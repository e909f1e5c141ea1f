"""Gaps of joints: closed forms of contact, invariants of fields and scans, and what is refused."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

import meshio
import numpy as np
import pytest
import skfem
from bodies import NU, PLANE, SOLID, STEEL, E, block, mapped, structure, turned
from clamped_plates import bolted, loads
from mesh_files import read_or_refusal
from stability.mutated import damaged
from test_preload import BOLT, JOINT, clamped, stacked
from test_sensitivities import agrees

import skfem_joint as sj
from skfem_joint.mesh import named, write_mesh
from skfem_joint.structure.parameters import with_values

#: Plane strain modulus of one elastic body on a rigid one, Pa.
MODULUS = E / (1.0 - NU**2)


def pressed_down(x: Any, y: Any, gap: Any, force: float, order: int = 1) -> tuple[Any, Any, Any]:
    """Places and pressures of a flat face with a gap under a force (N/m), and its structure.

    The body is in plane strain; both sides are planes of symmetry, and its base is rigid.
    """
    end, top = x[-1], y[-1]
    mesh = skfem.MeshQuad.init_tensor(x, y).with_boundaries(
        {
            "face": lambda p: p[1] == 0.0,
            "top": lambda p: p[1] == top,
            "sides": lambda p: (p[0] == 0.0) | (p[0] == end),
        }
    )
    pressed = sj.Structure(
        named(mesh, order=order), STEEL, thickness=1.0, plane="strain", fixed_x=["sides"],
        joints=[sj.Joint("face", 0.0, 0.0, contact="unilateral", gap=gap)], free=True, order=order,
    )  # fmt: skip
    load = sj.Load("top", sj.Table([0.0, 1.0], [0.0, force]), direction=(0.0, -1.0))
    run = sj.quasi_static(pressed.system([load]), step=0.1, n_steps=10, save=sj.Save(fields=True))
    space = pressed.spaces[0]
    p = space.means(np.zeros(space.area.size)) @ run.normal_force[-1] / space.area
    place = pressed.nodes[space.nodes, 0]
    by_x = np.argsort(place)
    return place[by_x], p[by_x], pressed


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("share", [0.25, 0.75, 1.5])
def test_a_wavy_face_touches_as_westergaard_says(share, order):
    """Pressed by a share of what closes it: sin²(π a / λ) = share, or closed with p + p* cos.

    The wave is measured, at places of its own, and the cell between two planes of symmetry is
    periodic; 2 % of the peak, and the half width within an element.
    """
    length, amplitude, n = 0.01, 1e-6, 48
    closing = np.pi * MODULUS * amplitude / length
    x = np.linspace(0.0, 0.5 * length, n + 1)
    y = np.concatenate([[0.0], np.cumsum(np.geomspace(0.5 * length / n, 0.15 * length, 20))])
    measured = np.linspace(0.0, 0.5 * length, 500)
    wave = sj.Scan(measured, amplitude * np.cos(2.0 * np.pi * measured / length), kind="height")
    place, p, _ = pressed_down(x, y, wave, share * closing * 0.5 * length, order)
    angle, half_width = np.pi * place / length, np.inf
    if share > 1.0:
        known = closing * (share + np.cos(2.0 * angle))
    else:
        edge = np.sqrt(share)
        inside = np.sqrt(np.maximum(edge**2 - np.sin(angle) ** 2, 0.0))
        known = 2.0 * share * closing * np.cos(angle) / edge**2 * inside
        half_width = length / np.pi * np.arcsin(edge)
        assert place[p > 0.0].max() == pytest.approx(half_width, abs=1.01 * x[1])
    # At the edge, where the pressure falls with an infinite slope, an element errs by more.
    away = np.abs(place - half_width) > 1.5 * x[1]
    np.testing.assert_allclose(p[away], known[away], atol=0.02 * known.max())
    assert p.max() == pytest.approx(known.max(), rel=0.01)


def touching(mesh: Any, **joint: Any) -> Any:
    """Structure of a block on a rigid base, with a gap in the joint."""
    return structure(
        mesh, [sj.Joint("base", 0.0, 0.3, contact="unilateral", **joint)], fixed=("left",)
    )


def gap_of(found: Any) -> Any:
    """Gap at rest of the pressure points of a structure that opens."""
    return found.unloaded.contact.normal.gap


@pytest.mark.parametrize(("shape", "order"), [*PLANE, *SOLID])
def test_a_constant_field_is_the_number(shape, order):
    mesh = block(shape, order, 2)
    number = gap_of(touching(mesh, gap=2e-6))
    assert np.all(number == 2e-6)
    assert gap_of(touching(mesh, gap=lambda x: np.full(len(x), 2e-6))) == pytest.approx(
        number, rel=1e-12
    )
    assert gap_of(touching(mesh, gap=1e-6, gap_scale=2.0)) == pytest.approx(number, rel=1e-15)


@pytest.mark.parametrize("kind", ["gap", "height"])
@pytest.mark.parametrize(("shape", "order"), [*PLANE, *SOLID])
def test_a_plane_whose_plane_is_removed_is_no_gap(shape, order, kind):
    mesh = block(shape, order, 2)
    scan = measured(mesh.dim, lambda s: 1e-5 + s @ [3e-6, -2e-6][: s.shape[1]], kind)
    found = touching(mesh, gap=scan, remove_plane=True)
    assert np.abs(gap_of(found)).max() < 1e-12 * 1e-5
    tilted = touching(mesh, gap=scan) if kind == "height" else None
    if tilted is not None:
        assert gap_of(tilted).min() == 0.0
        assert gap_of(tilted).max() == pytest.approx(np.ptp(scan.values), rel=0.4)


def measured(dim: int, value: Any, kind: str = "gap", **placed: Any) -> sj.Scan:
    """Scan of a unit face, 2 cm over its ends, of a function of places (k, dim - 1)."""
    line = np.linspace(-0.02, 1.02, 14)
    places = np.stack(np.meshgrid(*[line] * (dim - 1), indexing="ij"), axis=-1)
    places = places.reshape(-1, dim - 1)
    return sj.Scan(places, value(places), kind, **placed)


def waves(s: Any) -> Any:
    """Some smooth gap over places (k, d)."""
    return 1e-6 * (2.0 + np.sin(3.0 * s[:, 0]) + np.cos(2.0 * s[:, -1]))


@pytest.mark.parametrize(("shape", "order"), [("tri", 1), ("quad", 2), ("tet", 1), ("hex", 2)])
def test_gaps_scale_and_add(shape, order):
    mesh = block(shape, order, 2)
    first, second = measured(mesh.dim, waves), measured(mesh.dim, lambda s: 1e-6 + 1e-6 * s[:, 0])
    one, two = (gap_of(touching(mesh, gap=scan)) for scan in (first, second))
    both = gap_of(touching(mesh, gap=[first, second]))
    assert both == pytest.approx(one + two, rel=1e-12)
    assert gap_of(touching(mesh, gap=first, gap_scale=3.0)) == pytest.approx(3.0 * one, rel=1e-14)
    # Heights of both faces, of which each takes from the gap, up to what makes the faces touch.
    heights = [replace(scan, kind="height") for scan in (first, second)]
    lower = gap_of(touching(mesh, gap=heights))
    assert lower == pytest.approx(both.max() - both, abs=1e-12 * both.max())


@pytest.mark.parametrize(("shape", "order"), [("tri", 2), ("quad", 1), ("hex", 1)])
def test_a_scan_in_a_turned_frame_is_the_same(shape, order):
    mesh = block(shape, order, 2)
    scan = measured(mesh.dim, waves)
    straight = touching(mesh, gap=scan)
    angle, shift = 35.0, np.array([0.3, -0.2, 0.1][: mesh.dim])
    moved = mapped(turned(mesh, angle), lambda p: p + shift[:, np.newaxis])
    turn = np.eye(mesh.dim)
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turn[:2, :2] = [[c, -s], [s, c]]
    axes = 2.0 * turn.T[: mesh.dim - 1]
    placed = replace(scan, origin=tuple(shift), axes=tuple(map(tuple, axes)))
    found = touching(moved, gap=placed)
    assert gap_of(found) == pytest.approx(gap_of(straight), rel=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_scan_is_linear_between_its_places_and_goes_on_at_its_edge(dim):
    flat = measured(dim, lambda s: 1.0 + s @ [0.5, 0.25][: dim - 1], margin=0.1)
    x = np.random.default_rng(3).uniform(0.0, 1.0, (40, dim))
    normal = np.zeros((40, dim))
    normal[:, -1] = -1.0
    known = 1.0 + x[:, :-1] @ [0.5, 0.25][: dim - 1]
    assert flat.at(x, normal) == pytest.approx(known, rel=1e-12)
    beyond = x.copy()
    beyond[:, 0] = 1.1
    edge = 1.0 + np.column_stack([np.full(40, 1.02), x[:, 1:-1]]) @ [0.5, 0.25][: dim - 1]
    assert flat.at(beyond, normal) == pytest.approx(edge, rel=1e-8)
    beyond[:3, 0] = 1.3
    with pytest.raises(sj.InputError, match=r"3 of 40 points .* by up to 0.28 m, at \(1.3"):
        flat.at(beyond, normal)


@pytest.mark.parametrize("order", [1, 2])
def test_what_the_mesh_resolves_is_the_best_fit_by_hats(order):
    """Beside a dense fit by hats of the test's own; a plane is resolved, and fine waves are not."""
    mesh = block("quad", order, 6, (1.0, 1.0, 1.0))
    for periods, lost in ((0.0, 0.0), (1.0, None), (40.0, 1.0)):

        def field(x: Any, periods: float = periods) -> Any:
            waves = np.sin(2.0 * np.pi * periods * x[:, 0])
            return 1e-6 * (2.0 + (waves if periods else x[:, 0]))

        pressed = touching(mesh, gap=field)
        found = pressed.spaces[0].resolution
        assert found.whole**2 == pytest.approx(found.resolved**2 + found.rest**2, rel=1e-9)
        if lost is None:
            known = np.unique(pressed.nodes[pressed.spaces[0].nodes, 0])
            fine = np.linspace(0.0, 1.0, 20001)
            hats = np.array([np.interp(fine, known, row) for row in np.eye(known.size)]).T
            values = field(fine[:, np.newaxis])
            left = values - hats @ np.linalg.lstsq(hats, values)[0]
            assert found.rest == pytest.approx(np.sqrt(np.mean(left**2)), rel=0.02)
            assert found.whole == pytest.approx(1e-6 / np.sqrt(2.0), rel=0.01)
        else:
            # Of waves between the points of quadrature these are but samples.
            assert found.lost == pytest.approx(0.0, abs=1e-6) if lost == 0.0 else found.lost > 0.6
        notes = " ".join(pressed.system().notes)
        assert ("miss" in notes) == (periods == 40.0)
        assert any("resolve" in line for line in pressed.at_rest())


def test_units_of_a_scan_are_questioned():
    mesh = block("hex", 1, 2)
    far = measured(3, waves)
    far = replace(far, places=1e3 * far.places)
    high = measured(3, lambda s: 1e6 * waves(s))
    for scan, words in ((far, "are its places in metres"), (high, "is it in metres")):
        found = [note for note in touching(mesh, gap=scan).system().notes if words in note]
        assert len(found) == 1, words
    good = touching(mesh, gap=measured(3, waves)).system().notes
    assert not any("metres" in note for note in good)


@pytest.mark.parametrize("contact", ["constant", "unilateral"])
@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_by_the_scale_of_a_gap_are_those_of_the_system(contact, order):
    """Of clamped plates, whose preload changes with the gap."""

    def bow(x):
        return 3e-7 * ((x[:, 0] - 0.075) / 0.075) ** 2

    given = bolted(order=order, joint={"contact": contact, "gap": bow, "gap_scale": 0.8})
    found = agrees(given, loads("right", 2), "joint[0].gap_scale")
    assert found.w is not None
    if contact == "unilateral":
        assert found.gap.any()
    other = with_values(given, {"joint[0].gap_scale": 0.4})
    anew = replace(given, joints=[replace(given.joints[0], gap_scale=0.4)])
    assert other.preload.joints[0].force == pytest.approx(
        anew.preload.joints[0].force, abs=1e-9 * anew.preload.joints[0].force.max()
    )


def test_derivatives_by_the_scale_of_a_gap_without_bolts():
    given = structure(
        block("quad", 1, 4),
        [sj.Joint("base", 0.0, 0.3, contact="unilateral", gap=measured(2, waves))],
    )
    found = agrees(given, loads("top", 2), "joint[0].gap_scale")
    assert found.gap == pytest.approx(gap_of(given), rel=1e-12)


@pytest.mark.parametrize(
    ("joint", "words"),
    [
        ({"gap": 1e-6, "pressure": 1e6, "contact": "constant"}, "a gap, which needs contact"),
        ({"gap": lambda x: 1e-6 + 0 * x[:, 0], "pressure": 1e6, "contact": "constant"},
         "a gap, which needs contact"),
        ({"gap": lambda x: 1e-6 + 0 * x[:, 0], "pressure": 1e6}, "a pressure beside a gap of up"),
        ({"gap": -1e-6}, "gap: found -1e-06, must be >= 0"),
        ({"gap": "scan.csv"}, r"read_scan reads its file"),
        ({"gap": None}, "gap: found None"),
        ({"gap": [1e-6]}, "must be a number in m, a function"),
        ({"gap": lambda x: x}, r"gave values of shape \(.*, 2\) for places"),
        ({"gap": lambda x: np.nan * x[:, 0]}, "finite"),
        ({"gap": lambda x: x[:, 0] - 0.5}, "must be >= 0; is it a height"),
        ({"gap": 1e-6, "gap_scale": -1.0}, "gap_scale: found -1.0, must be >= 0"),
        ({"gap": 1e-6, "remove_plane": True}, "has no plane"),
        ({"gap": measured(3, waves)}, "found 2 coordinates of places, must be those of a line"),
        ({"gap": measured(2, waves, axes=[(0.0, 1.0)])}, "lies across the scan's axes"),
        ({"gap": measured(2, waves, origin=(0.0, 0.0, 0.0))}, "origin: found 3 numbers"),
        ({"gap": measured(2, waves, origin=(0.5, 0.0))}, "points of the joint lie outside"),
    ],
)  # fmt: skip
def test_wrong_gaps_are_refused(joint, words):
    values = {"pressure": 0.0, "friction": 0.3, "contact": "unilateral"} | joint
    with pytest.raises(sj.InputError, match=words):
        structure(block("quad", 1, 2), [sj.Joint("base", **values)])


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"places": [[0.0, 0.0]]}, "found places of shape"),
        ({"places": [0.0, 1.0], "kind": "depth"}, "must be 'gap' or 'height'"),
        ({"places": [0.0, np.inf]}, "not finite"),
        ({"places": [0.0, 0.0]}, "2 values at one place"),
        ({"places": [0.0, 1.0], "values": [1.0, np.nan]}, "found 1 measured places"),
        ({"places": [[0, 0], [1, 1], [2, 2]], "values": [1, 2, 3]}, "lie in one line"),
        ({"places": [0.0, 1.0], "axes": [(1.0, 0.0), (0.0, 1.0)]}, "must be a direction"),
        ({"places": [[0, 0], [1, 1], [2, 0]], "values": [1, 2, 3],
          "axes": [(1.0, 0.0, 0.0), (1.0, 1.0, 0.0)]}, "two directions"),
        ({"places": [0.0, 1.0], "margin": -1.0}, "margin: found -1.0"),
    ],
)  # fmt: skip
def test_wrong_scans_are_refused(values, words):
    with pytest.raises(sj.InputError, match=words):
        sj.Scan(**{"values": [1.0, 2.0], **values})


def test_bolts_between_shifted_blocks_close_what_heights_leave(tmp_path):
    """Heights of both faces from files, of which the constants do not matter: bodies float."""
    mesh = stacked("hex", 1, 3, 3)
    line = np.linspace(0.0, 1.0, 9)
    x, y = (part.ravel() for part in np.meshgrid(line, line))
    files = []
    for name, height in (("upper", -40.0 * x * (1.0 - x)), ("lower", 5.0 + 20.0 * x * y)):
        path = tmp_path / f"{name}.csv"
        rows = "\n".join(f"{1e3 * a},{1e3 * b},{h}" for a, b, h in zip(x, y, height, strict=True))
        path.write_text(f"x (mm),y (mm),height (µm)\n{rows}\n", encoding="utf-8")
        files.append(sj.read_scan(path))

    def field(p: Any) -> Any:
        known = np.interp(p[:, 0], line, 40.0 * line * (1.0 - line))
        lower = files[1].at(p, np.tile([0.0, 0.0, -1.0], (len(p), 1)))
        return 1e-6 * known + lower + 30e-6

    read, given = (
        clamped(mesh, [replace(JOINT, gap=gap)]).preload.joints[0] for gap in (files, field)
    )
    assert read.force == pytest.approx(given.force, abs=1e-6 * given.force.max())
    assert read.force.sum() == pytest.approx(BOLT.force, rel=1e-9)
    assert (read.force > 0.0).sum() < np.count_nonzero(read.area)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "found no columns"),
        ("0,0,1\n", "line 1: found '0,0,1', must be the names of the columns"),
        ("x,y,z\n0,0,1\n", "line 1: column 'z': must be one of x, y, gap, height"),
        ("x,y\n0,0\n", "line 1: found columns x, y, must be x, y and height or gap"),
        ("y,gap\n0,0\n", "line 1: found columns y, gap"),
        ("x,gap,height\n0,0,0\n", "line 1: found columns x, gap, height"),
        ("x (in),gap\n0,1\n1,1\n", "found unit 'in', must be one of m, cm, mm, um, nm"),
        ("x,gap\n0,1\n1,a\n2,inf\n3\n", "line 3: gap: found 'a', must be a number"),
        ("x,gap\n0,1\n,1\n", "line 3: x: found '', must be a number"),
        ("x,gap\n0,1\n2,inf\n", "line 3: gap: found inf, must be finite"),
        ("x,gap\n0,1\n# said\n1,1\n0,2\n", "line 5: has the place of line 2"),
        ("x,gap\n0,1\n1,nan\n2,\n", "found 1 measured places, must be >= 2"),
    ],
)
def test_wrong_files_are_refused_with_their_lines(tmp_path, text, words):
    path = tmp_path / "scan.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(sj.InputError) as refused:
        sj.read_scan(path)
    said = str(refused.value)
    assert words in said
    assert said.startswith(str(path))


def test_columns_may_have_any_order_units_and_gaps_in_them(tmp_path):
    path = tmp_path / "scan.csv"
    path.write_text("# of a part\ngap [µm]; x (cm)\n1; 0\n; 5\nnan; 7\n3; 10\n", encoding="utf-8")
    scan = sj.read_scan(path)
    assert scan.places.tolist() == [[0.0], [0.1]]
    assert scan.values == pytest.approx([1e-6, 3e-6], rel=1e-15)
    assert scan.kind == "gap"
    assert scan.name == str(path)


def test_own_matrices_take_a_gap():
    """`contact` on a basis of scikit-fem, beside the structure of the same mesh."""
    mesh = block("quad", 1, 3)
    basis = skfem.Basis(mesh.mesh, skfem.ElementVector(skfem.ElementQuad1()))
    scan = measured(2, waves)
    rows = sj.contact(basis, "base", friction=0.3, contact="unilateral", gap=scan, gap_scale=2.0)
    known = gap_of(structure(mesh, [sj.Joint("base", 0.0, 0.3, contact="unilateral", gap=scan)],
                             fixed=("top",)))  # fmt: skip
    assert rows.normal.part.gap == pytest.approx(2.0 * known, rel=1e-12)
    rough = sj.contact(
        basis, "base", friction=0.3, contact="unilateral",
        gap=lambda x: 1e-6 * (1.0 + np.sin(300.0 * x[:, 0])),
    )  # fmt: skip
    assert any("miss" in note for note in rough.notes)


def with_field(path: Any, mesh: Any, value: Any, *, binary: bool = False) -> Any:
    """Gmsh file of a mesh with a field "bow" of its nodes; in binary by meshio."""
    write_mesh(mesh, path)
    if binary:
        raw = meshio.read(path, file_format="gmsh")
        raw.point_data = {"bow": value(raw.points), "other": 0.0 * raw.points[:, 0]}
        raw.cell_sets = {}
        raw.write(path, file_format="gmsh22", binary=True)
        return path
    values = value(mesh.coordinates).tolist()
    rows = "\n".join(f"{k} {v}" for k, v in enumerate(values, 1))
    head = f'$NodeData\n1\n"bow"\n1\n0.0\n3\n0\n1\n{len(values)}\n'
    with path.open("a", encoding="utf-8") as file:
        file.write(f"{head}{rows}\n$EndNodeData\n")
    return path


@pytest.mark.parametrize(
    ("shape", "order", "binary"),
    [("tri", 1, False), ("quad", 2, True), ("tet", 1, False), ("tet", 2, True), ("hex", 1, True)],
)
def test_a_field_of_nodes_is_linear_between_them(tmp_path, shape, order, binary):
    mesh = block(shape, order, 3)

    def bow(x):
        return 1e-6 * (1.0 + 2.0 * x[:, 0] + (x[:, 1] if mesh.dim == 3 else 0.0))

    path = with_field(tmp_path / "block.msh", mesh, bow, binary=binary)
    field = sj.read_node_field(path, "bow", "base")
    found = gap_of(touching(mesh, gap=field))
    assert found == pytest.approx(gap_of(touching(mesh, gap=bow)), rel=1e-9)
    # As heights it is what they leave.
    heights = gap_of(touching(mesh, gap=replace(field, kind="height")))
    assert heights == pytest.approx(found.max() - found, abs=1e-12 * found.max())


@pytest.mark.parametrize(
    ("field", "on", "words"),
    [
        ("bau", "base", "found 0 of this name in $NodeData, must be one; the file has bow"),
        ("bow", "bass", "found no group 'bass'; it has"),
        ("bow", "right", "2 of 4 nodes of 'right' have no finite value, first node"),
    ],
)
def test_wrong_fields_of_nodes_are_refused(tmp_path, field, on, words):

    def holes(x):
        return np.where((x[:, 0] > 0.9) & (x[:, 1] > 0.5), np.nan, 1e-6)

    path = with_field(tmp_path / "block.msh", block("quad", 1, 3), holes)
    with pytest.raises(sj.InputError) as refused:
        sj.read_node_field(path, field, on)
    assert words in str(refused.value)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize("part", ["1\n0.0\n", '"bow"', "\n1 1e-06"])
def test_a_cut_field_of_nodes_is_refused(tmp_path, part):
    path = with_field(tmp_path / "block.msh", block("quad", 1, 2), lambda x: 1e-6 + 0.0 * x[:, 0])
    text = path.read_text(encoding="utf-8")
    assert part in text
    path.write_text(text.replace(part, "", 1), encoding="utf-8")
    with pytest.raises(sj.InputError, match=r"block.msh"):
        sj.read_node_field(path, "bow", "base")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100))
def test_damaged_scans_and_fields_are_read_or_refused_with_their_names(tmp_path, seed):
    """None crashes; what is read is a finite gap at every place that was measured."""
    mesh = block("quad", 1, 3)
    binary = {"binary": True} if seed % 3 == 0 else {}
    msh = with_field(tmp_path / "block.msh", mesh, lambda x: 1e-6 * (1.0 + x[:, 0]), **binary)
    csv = tmp_path / "scan.csv"
    csv.write_text(
        "x (mm),gap (um)\n" + "".join(f"{k},{0.1 * k:.3f}\n" for k in range(30)), encoding="utf-8"
    )
    for path, read in (
        (csv, sj.read_scan),
        (msh, lambda path: sj.read_node_field(path, "bow", "base")),
    ):
        path.write_bytes(damaged(path.read_bytes(), random.Random(seed)))
        found = read_or_refusal(read, path)
        if not isinstance(found, str):
            assert np.isfinite(found.values).all()
            assert np.isfinite(found.places).all()


@pytest.mark.parametrize("order", [1, 2])
def test_a_parabola_of_gaps_over_a_flat_face_gives_the_pressure_of_hertz(order):
    """Half width and peak of a cylinder on a rigid flat within 1 %, by 16 elements over it."""
    a, radius, n = 1e-3, 2.0, 16
    size, even = 40.0 * a, 1.5 * a
    peak = MODULUS * a / (2.0 * radius)
    # Even elements in the contact, ever longer ones to forty times its half width.
    x = np.concatenate(
        [np.arange(1.5 * n) * a / n, np.geomspace(even, size, int(4.0 * np.log(size / even)) + 3)]
    )
    y = np.concatenate([[0.0], np.cumsum(np.geomspace(a / n, 0.15 * size, 16))])
    y *= size / y[-1]
    place, p, pressed = pressed_down(
        x, y, lambda x: x[:, 0] ** 2 / (2.0 * radius), 0.25 * np.pi * peak * a, order
    )
    inside = p > 0.3 * p.max()
    slope, top = np.polyfit(place[inside] ** 2, p[inside] ** 2, 1)
    assert np.sqrt(-top / slope) == pytest.approx(a, rel=0.01)
    assert np.sqrt(top) == pytest.approx(peak, rel=0.01)
    assert p.max() == pytest.approx(peak, rel=0.01)
    assert place[p > 0.0].max() == pytest.approx(a, abs=1.01 * a / n)
    assert p.sum() > 0.0
    assert pressed.spaces[0].resolution.lost < 0.01
