"""Results as data frames of pandas, which read back equal."""

import csv
import sys
from io import StringIO

import numpy as np
import pandas as pd
import pytest
from bodies import STEEL

import skfem_joint as sj

NAMES = ("run", "losses", "curve", "ring_down", "fit", "places", "response", "estimate", "loops")
NAMES += ("swept", "random")


@pytest.fixture(scope="module")
def tables():
    """Results of a bar that slips, by the names of what they are."""
    mesh = sj.build_bar([("joint", 0.1, 6), ("arm", 0.5, 6)], {"left": 0.0, "right": 0.6})
    structure = sj.Structure(
        mesh, STEEL, width=0.02, thickness=0.01, joints=[sj.Joint("joint", 5e6, 0.5)],
        fixed=["left"], damping_ratio=0.01,
    )  # fmt: skip
    system = structure.system([sj.Load("right", sj.Harmonic(500.0, 100.0))])
    run = sj.integrate(system, cycles=2, steps_per_cycle=50, save=sj.Save(fields=True))
    (curve,) = sj.backbone(system, (1,), 3)
    (response,) = sj.response(system, [100.0, 150.0], refined=False)
    ring_down = sj.ring_down(system, curve, cycles=12)
    places = sj.places_of(structure, system).of_curve(curve.friction_work, curve.slip)
    time = np.linspace(0.0, 0.5, 2000)
    fit = sj.damping_curve(time, np.exp(-10.0 * time) * np.cos(2.0 * np.pi * 60.0 * time))
    slow = sj.quasi_static(system, cycles=1, steps_per_cycle=40)
    swept = sj.swept_response(system, (100.0, 150.0), 600.0)
    random = sj.random_response(system, [curve], [[1.0, 1e-6], [1000.0, 1e-6]])
    found = run, curve.losses, curve, ring_down, fit, places, response, sj.estimate(run), slow.loops
    found += swept, random
    return dict(zip(NAMES, found, strict=True))


@pytest.mark.parametrize("name", NAMES)
def test_a_data_frame_has_the_values_of_a_result_and_reads_back_equal(tables, name):
    frame = tables[name].to_pandas()
    again = [*csv.DictReader(StringIO(frame.to_csv(index=False)))]
    assert [*frame] == [*tables[name].table]
    for column, values in tables[name].table.items():
        np.testing.assert_array_equal(frame[column].to_numpy(), np.asarray(values))
        if np.asarray(values).dtype.kind == "f":
            read = [float(row[column] or "nan") for row in again]
            np.testing.assert_array_equal(read, values)


def test_rows_of_columns_are_those_of_the_results(tables):
    curve, run = tables["curve"], tables["run"]
    frame = curve.to_pandas()
    assert np.array_equal(frame["loss_factor"], curve.losses.loss_factor)
    assert np.array_equal(frame["displacement_0_m"], curve.displacement[:, 0])
    assert [*frame["state"]] == [*curve.state]
    assert np.array_equal(run.to_pandas()["displacement_right_m"], run.point("right"))
    estimate = tables["estimate"].to_pandas().set_index("source")
    total = tables["estimate"].of("total", "friction_energy")
    assert estimate.loc["total", "friction_energy"] == total


def test_rows_of_a_sweep_stand_below_each_other():
    rows = [sj.Row(0, {"full.peak": 1.5}), sj.Row(1, {}, "it failed")]
    frame = pd.concat([row.to_pandas() for row in rows])
    assert [*frame["number"]] == [0, 1]
    assert frame["full.peak"].iloc[0] == 1.5
    assert np.isnan(frame["full.peak"].iloc[1])


def test_without_pandas_the_extra_is_named(tables, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(sj.InputError, match=r"pip install 'skfem-joint\[pandas\]'"):
        tables["curve"].to_pandas()
