"""Stress at rest by clamp forces, and mean and range of a cycle on it."""

import json

import numpy as np
import pytest
from bodies import STEEL
from clamped_plates import BOLTS, DEEP, JOINT, plates
from joint_scenes import harmonic, plate_scene
from scene_texts import csv_rows

import skfem_joint as sj
from skfem_joint.output.folder import write
from skfem_joint.results.stress import preload_stress, von_mises

FORCE, PULL = 1000.0, 400.0
WITHOUT_POISSON = sj.Material(200e9, 8000.0, 0.0)


SIDES = {"under": "bottom", "over": "top", "end": "right", "back": "left"}
BLOCK = sj.build_plate([("block", 0.04, 8)], 0.01, 4, boundaries=SIDES)


def pressed():
    """A block whose whole top one bolt presses on a rigid base, pulled along it."""
    return sj.Structure(
        BLOCK, WITHOUT_POISSON, thickness=0.01, joints=[sj.Joint("under", "preload", 0.3)],
        bolts=[sj.Clamp(FORCE, head="over")], fixed_x=["back"], damping_ratio=0.02,
    )  # fmt: skip


def test_a_bolt_that_presses_a_whole_block_strains_it_by_force_over_area():
    rest = preload_stress(pressed())
    assert rest[:, 1] == pytest.approx(np.full(len(rest), -FORCE / (0.04 * 0.01)), rel=1e-9)
    assert np.abs(np.delete(rest, 1, axis=1)).max() < 1e-6 * FORCE / (0.04 * 0.01)


def test_stress_at_rest_is_not_known_where_pressures_are_given():
    mesh = sj.build_plate([("joint", 0.04, 8), ("arm", 0.02, 2)], 0.01, 2)
    structure = sj.Structure(
        mesh, STEEL, thickness=0.01, joints=[sj.Joint("joint", 5e6, 0.3)], fixed=["left"]
    )
    assert np.isnan(preload_stress(structure)).all()
    run = sj.integrate(
        structure.system([sj.Load("right", sj.Harmonic(10.0, 50.0), (1.0, 0.0))]),
        cycles=1, steps_per_cycle=64, save=sj.Save(fields=True),
    )  # fmt: skip
    found = sj.stress_history(structure, run)
    assert ["the pressure of 'joint' is given" in note for note in found.notes] == [True]
    assert [name for name, _ in found.cycle().largest()] == ["vibration", "alternating"]


def test_stress_of_a_bar_without_joints_is_that_of_its_load_alone():
    bar = sj.build_bar([("bar", 0.5, 5)], {"left": 0.0, "right": 0.5})
    structure = sj.Structure(bar, STEEL, width=0.02, thickness=0.01, fixed=["left"])
    system = structure.system([sj.Load("right", sj.Harmonic(PULL, 1.0))], quasi_static=True)
    run = sj.quasi_static(system, cycles=1, steps_per_cycle=64, save=sj.Save(fields=True))
    cycle = sj.stress_history(structure, run).cycle(1.0)
    assert cycle.range[:, 0] == pytest.approx(np.full(5, 2.0 * PULL / 2e-4), rel=1e-9)
    assert np.abs(cycle.mean).max() < 1e-9 * PULL / 2e-4
    assert not cycle.preload.any()


def pressed_scene():
    """The same block, which a slow load presses and pulls along its bolt."""
    return plate_scene(
        "full",
        mesh=BLOCK,
        support={"fixed_x": ["back"]},
        joint=[{"on": "under", "pressure": "preload", "friction": 0.3}],
        bolt=[{"force": FORCE, "head": "over"}],
        load=[harmonic("over", PULL, 50.0) | {"direction": [0.0, 1.0]}],
        damping={},
        time={"cycles": 1, "quasi_static": True, "steps_per_cycle": 400},
        output={"stress": ["block"]},
    )


def test_a_scene_tells_stress_at_rest_mean_and_range_of_a_region(tmp_path):
    """Exact: force over area, of the bolt at rest and in the mean, of twice the load as range."""
    scene = pressed_scene()
    study = sj.run_scene(scene)
    write(study, tmp_path)
    told = json.loads((tmp_path / "summary.json").read_text())["models"]["full"]["stress"]["block"]
    assert [*told] == ["preload", "vibration", "total", "alternating"]
    rest, load = FORCE / 4e-4, PULL / 4e-4
    for row in told.values():
        assert row["preload_von_mises_Pa"] == pytest.approx(rest, rel=1e-6)
        assert row["vibration_von_mises_Pa"] == pytest.approx(load, rel=1e-6)
        assert row["total_von_mises_Pa"] == pytest.approx(rest + load, rel=1e-6)
        assert row["alternating_von_mises_Pa"] == pytest.approx(load, rel=1e-6)
        assert row["mean_von_mises_signed_Pa"] == pytest.approx(-rest, rel=1e-6)
        assert row["mean_YY_Pa"] == pytest.approx(-rest, rel=1e-6)
        assert row["range_YY_Pa"] == pytest.approx(2.0 * load, rel=1e-6)
        element = BLOCK.mesh.p[:, BLOCK.mesh.t[:, row["element"]]].mean(axis=1)
        assert [row["x_m"], row["y_m"], row["z_m"]] == pytest.approx([*element, 0.0])
    rows = csv_rows(tmp_path / "stress.csv")
    assert [row["largest"] for row in rows] == [*told]
    assert float(rows[2]["range_YY_Pa"]) == pytest.approx(told["total"]["range_YY_Pa"], rel=1e-9)
    found = sj.stress_history(scene.structure(), study.runs["full"], "block").cycle(1.0 / 50.0)
    assert {name: row for name, row in found.largest()} == told


@pytest.mark.parametrize(("steps", "told"), [(28, False), (32, True)])
def test_as_many_times_as_are_said_to_be_needed_suffice(steps, told):
    made = pressed_scene().changed(time={"steps_per_cycle": steps})
    said = [note for note in sj.run_scene(made).notes if "too few for a range" in note]
    assert len(said) == (not told)
    assert told or f"stored {steps + 1} times, too few for a range of stress: 33 of a" in said[0]


def test_a_series_has_mean_and_range_of_the_last_cycle(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    study = sj.run_scene(pressed_scene())
    sj.write_vtk(tmp_path / "fields.pvd", study.structure, study.runs)
    block = pyvista.get_reader(tmp_path / "fields.pvd").read().combine()
    n, rest, load = block.n_cells, FORCE / 4e-4, PULL / 4e-4
    assert block["von_mises_range"] == pytest.approx(np.full(n, 2.0 * load), rel=1e-6)
    assert block["von_mises_mean"] == pytest.approx(np.full(n, -rest), rel=1e-6)


def test_stress_by_bolts_is_that_of_elements_of_a_quarter_of_the_size_within_3_percent():
    """Von Mises stress at the fourteen places where it is largest, under the bolts' heads too."""

    def made(mesh):
        return sj.Structure(
            mesh, STEEL, thickness=DEEP, fixed=["left"], joints=[JOINT], bolts=BOLTS
        )

    coarse = made(plates(False, order=2))
    fine = made(sj.refined(sj.refined(coarse.mesh)))
    inside, stress = fine.mesh.mesh.p[:, fine.mesh.mesh.t].mean(axis=1), preload_stress(fine)
    corners = coarse.mesh.mesh.p[:, coarse.mesh.mesh.t]
    low, high = corners.min(axis=1), corners.max(axis=1)
    beside = (inside[..., np.newaxis] > low[:, np.newaxis]).all(axis=0)
    beside &= (inside[..., np.newaxis] < high[:, np.newaxis]).all(axis=0)
    assert np.array_equal(beside.sum(axis=0), np.full(low.shape[1], 16))
    true = von_mises(beside.T @ stress / 16.0)
    most = np.argsort(-true)[:14]
    assert von_mises(preload_stress(coarse))[most] == pytest.approx(true[most], rel=0.03)


def test_mean_and_range_of_a_cycle_are_those_of_load_and_preload():
    """A slow pull on the end: what the frictionless part carries is force over area."""
    structure = pressed()
    system = structure.system([sj.Load("end", sj.Harmonic(PULL, 50.0), (1.0, 0.0))])
    run = sj.integrate(system, cycles=3, steps_per_cycle=64, save=sj.Save(fields=True))
    found = sj.stress_history(structure, run)
    assert np.array_equal(found.total[5], found.preload + found.stress[5])
    cycle = found.cycle(1.0 / 50.0)
    across, along = -FORCE / 4e-4, PULL / 1e-4
    last = np.flatnonzero(structure.mesh.mesh.p[0, structure.mesh.mesh.t].mean(axis=0) > 0.035)
    top = np.flatnonzero(structure.mesh.mesh.p[1, structure.mesh.mesh.t].mean(axis=0) > 0.0075)
    (corner,) = np.intersect1d(last, top)  # beside the load, away from what rubs
    assert cycle.range[corner, 0] == pytest.approx(2.0 * along, rel=0.05)
    assert cycle.amplitude[corner] == pytest.approx(along, rel=0.05)
    assert cycle.mean[:, 1] == pytest.approx(np.full(len(cycle.mean), across), rel=0.1)
    assert abs(cycle.mean[corner, 0]) < 0.02 * along
    assert np.all(cycle.amplitude <= cycle.amplitude[cycle.worst])
    with pytest.raises(sj.InputError, match=r"at most the 0\.06 s that are stored"):
        found.cycle(0.07)
    with pytest.raises(sj.InputError, match="at least 33 times"):
        found.cycle(1e-3)


@pytest.mark.parametrize(("every", "share"), [(1, 1e-4), (6, 5e-3), (8, None), (25, None)])
def test_the_range_of_a_cycle_does_not_miss_peaks_between_stored_times(every, share):
    mesh = sj.build_plate([("all", 0.2, 4)], 0.05, 1)
    held = {"fixed_x": ["left"], "fixed_y": ["bottom"], "thickness": 0.01}
    structure = sj.Structure(mesh, sj.Material(200e9, 8000.0, 0.0), **held)
    system = structure.system([sj.Load("right", sj.Harmonic(1e3, 50.0, 0.35), (1.0, 0.0))])
    save = sj.Save(fields=True, every=every)
    run = sj.quasi_static(system, cycles=2, steps_per_cycle=200, save=save)
    found = sj.stress_history(structure, run)
    if share is None:
        with pytest.raises(sj.InputError, match="peaks lie between"):
            found.cycle(0.02)
    else:
        assert found.cycle(0.02).range[:, 0] == pytest.approx(2e3 / 5e-4, rel=share)
