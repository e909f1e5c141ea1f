"""A system that is saved and loaded is the same to the last bit; damaged files are sentences."""

import io
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

import skfem_joint as sj
from skfem_joint.ground.array_files import fingerprint
from skfem_joint.ground.loads import Scaled

TIMES = np.linspace(0.0, 2e-3, 7)
SHAPES = [
    sj.Harmonic(40e3, 500, 0.1),
    sj.MultiHarmonic([sj.Harmonic(20e3, 500.0), sj.Harmonic(10e3, 1500.0)]),
    sj.Triangle(40e3, 2e-4),
    sj.HalfSine(40e3, 2e-4, 1e-5),
    sj.Versine(40e3, 2e-4),
    sj.RampAndHold(40e3, 2e-4),
    sj.Rectangle(40e3, 2e-4),
    sj.Table(TIMES, 1e4 * np.sin(1e3 * TIMES)),
    Scaled(sj.Table(TIMES, np.sin(1e3 * TIMES)), 1e4),
]


def bar(*shapes):
    """A bar pressed on a base over a third of its length."""
    mesh = sj.build_bar([("joint", 0.1, 10), ("arm", 0.2, 10)], {"loaded_end": 0.1, "end": 0.3})
    structure = sj.Structure(
        mesh, sj.Material(E=200e9, density=8000.0), width=0.05, thickness=0.01,
        joints=[sj.Joint("joint", 50e6, 0.7)], stiffness_damping=1e-6, free=True,
    )  # fmt: skip
    return structure.system(
        [sj.Load("end", shape) for shape in shapes or [sj.Harmonic(40e3, 500.0, 0.1)]]
    )


def models():
    system = replace(bar(), notes=("of a test",))
    T = np.asfortranarray(system.T.toarray())
    modes = sj.natural_modes(system, 8).modes
    return {
        "full": system,
        "columns": replace(system, K=sparse.csc_array(system.K), T=T),
        "condensed": sj.condense(system),
        "reduced": sj.reduce(system, modes=6),
        "projected": system.project(modes).with_beta(1e5),
    }  # fmt: skip


@pytest.mark.parametrize("name", ["full", "columns", "condensed", "reduced", "projected"])
def test_a_loaded_system_integrates_to_the_same_bits(tmp_path, name):
    system = models()[name]
    loaded = sj.load(sj.save(system, tmp_path / "system.npz"))
    assert fingerprint(loaded) == fingerprint(system)
    runs = [sj.integrate(each, cycles=1, steps_per_cycle=200) for each in (system, loaded)]
    assert runs[0].peak_of("end") > 0.0
    for array in ("point_u", "point_v", "joint_work", "slip_peak", "friction_work"):
        np.testing.assert_array_equal(*(getattr(run, array) for run in runs))
    np.testing.assert_array_equal(*(run.system.expand(run.final[0]) for run in runs))


def test_every_shape_of_the_package_is_kept(tmp_path):
    system = bar(*SHAPES)
    loaded = sj.load(sj.save(system, tmp_path / "system.npz"))
    t = np.linspace(0.0, 3e-3, 1000)
    np.testing.assert_array_equal(loaded.load_amplitudes(t), system.load_amplitudes(t))
    assert [type(load.amplitude) for load in loaded.loads] == [type(shape) for shape in SHAPES]


def test_a_plain_function_is_refused_with_the_cure(tmp_path):
    with pytest.raises(sj.InputError, match=r"'end'.*plain function of time.*sj\.Table\("):
        sj.save(bar(np.sin), tmp_path / "system.npz")
    with pytest.raises(sj.InputError, match=r"must be '\.npz'"):
        sj.save(bar(), tmp_path / "system.mat")
    assert not list(tmp_path.iterdir())


def changed(path, summed=False, **members):
    """Write a file anew with other members, or without those that are None.

    If ``summed``, with a digest that is right again, as a mistake of the package would.
    """
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    arrays |= {name.replace("__", "/"): value for name, value in members.items()}
    arrays = {name: value for name, value in arrays.items() if value is not None}
    if summed:
        content = json.loads(str(arrays.pop("description")))
        del content["digest"]
        content["digest"] = fingerprint(arrays, json.dumps(content))
        arrays["description"] = np.array(json.dumps(content))
    np.savez(path, **arrays)


def description(path, of_system=(), **changes):
    """Description in a file with other entries, and other fields of its system."""
    with np.load(path) as file:
        content = json.loads(str(file["description"])) | changes
    content["system"]["!System"] |= dict(of_system)
    return np.array(json.dumps(content))


def load_of(path, **amplitude):
    """Description with a load of another amplitude."""
    vector = {"!array": "loads/0/vector"}
    load = {"!AppliedLoad": {"vector": vector, "on": "end", "amplitude": amplitude}}
    return description(path, {"loads": {"!tuple": [load]}})


HARMONIC = {"amplitude": 1.0, "frequency": -2.0, "phase": 0.0}
PARTS = "format", "shape", "data", "indices", "indptr"
SAVED = "not what was saved"
GIVEN, SPRINGS = "contact/given", "contact/stiffness"  # members
#: What is done to a file, what is said of it, and what is if its digest is right again.
DAMAGE = {
    "indices": (lambda _: {"contact__B__indices": np.full(11, 10**6)}, SAVED, "indices must be"),
    "starts": (lambda _: {"K__indptr": np.array([0, 10**9])}, SAVED, "indptr|index pointer"),
    "no mass": (lambda _: {f"M__{part}": None for part in PARTS}, SAVED, "no .*M"),
    "no points": (lambda _: {f"P__{part}": None for part in PARTS}, SAVED, "no .*P"),
    "nan": (lambda _: {GIVEN: np.full(11, np.nan)}, SAVED, "must be finite and not negative"),
    "negative": (lambda _: {GIVEN: np.full(11, -1.0)}, SAVED, "must be finite and not negative"),
    "objects": (lambda _: {GIVEN: np.array([None] * 11, dtype=object)}, "Object arrays", ""),
    "texts": (lambda _: {GIVEN: np.array(["a"] * 11)}, SAVED, "real numbers"),
    "shape": (
        lambda _: {"T__shape": np.array([10**12, 21])}, SAVED, "too few|indptr|index pointer"
    ),
    "more": (lambda _: {"more": np.zeros(3)}, SAVED, ""),
    "kind": (lambda p: {"description": description(p, kind="x")}, "something else", ""),
    "form": (lambda p: {"description": description(p, form=9)}, "form 9", ""),
    "no name": (
        lambda p: {"description": description(p, {"points": {"!tuple": []}})}, SAVED,
        "P: found shape",
    ),
    "load": (
        lambda p: {"description": load_of(p, **{"!Harmonic": HARMONIC})}, SAVED,
        "frequency: found -2",
    ),
    "no shape": (
        lambda p: {"description": load_of(p, **{"!os": {}})}, SAVED, "none of the package",
    ),
}  # fmt: skip


def _sprung():
    """Joint whose friction has springs in series; without them it would be another system."""
    system = bar(sj.Harmonic(40e3, 500.0), sj.Table(TIMES, np.sin(1e3 * TIMES)))
    return system.with_contact(stiffness=np.full(system.contact.w.size, 1e9))


EDITS = {
    "no springs": (lambda _: {SPRINGS: None}, ""),
    "springs, one": (lambda _: {SPRINGS: np.full(1, 1e9)}, "stiffness: found shape"),
    "springs, small floats": (lambda a: {SPRINGS: a[SPRINGS].astype(np.float32)}, ""),
    "no shape over time": (
        lambda _: {"loads__1__amplitude__forces": None},
        "has no 'loads/1/amplitude/forces'",
    ),
    "no load": (lambda _: {"loads__0__vector": None}, "has no 'loads/0/vector'"),
    "no T": (lambda _: {f"T__{part}": None for part in PARTS}, ""),
    "no indices": (lambda _: {"contact__B__indices": None}, "has no 'contact/B/indices'"),
    "negative mass": (lambda a: {"M__data": -a["M/data"]}, "M: is not positive definite"),
    "negative stiffness": (lambda a: {"K__data": -a["K/data"]}, "K: is indefinite"),
    "negative damping": (lambda a: {"C__data": -a["C/data"]}, "C: is negative somewhere"),
    "another limit": (lambda a: {GIVEN: 2.0 * a[GIVEN]}, ""),
    "another mass": (lambda a: {"M__data": 1.5 * a["M/data"]}, ""),
    "another row": (lambda a: {"contact__B__indices": a["contact/B/indices"][::-1]}, ""),
    "times": (
        lambda a: {"loads__1__amplitude__times": a["loads/1/amplitude/times"][:-1]},
        "Table|times",
    ),
    "no names": (lambda _: {"description": None}, ""),
    "halves": (lambda a: {"contact/directions": 1.5 * a["contact/directions"]}, "must be 1 or 2"),
    "infinite mass": (lambda a: {"M__data": np.inf * a["M/data"]}, "M: "),
    "one number": (lambda a: {GIVEN: a[GIVEN][0]}, "must be 1 or 2"),
    "truth values": (lambda a: {GIVEN: a[GIVEN] > 0.0}, "real numbers"),
    "complex": (lambda a: {"K__data": 1j * a["K/data"]}, "real numbers"),
    "nan": (lambda a: {SPRINGS: np.nan * a[SPRINGS]}, "stiffness: must be positive"),
}


def assert_refused(path, words):
    with pytest.raises(sj.InputError, match=f"cannot be read as a saved system: .*({words})"):
        sj.load(path)


@pytest.mark.parametrize("what", EDITS)
def test_an_edited_file_is_one_sentence(tmp_path, what):
    """Also where what is left would make a system, such as one without springs."""
    path = sj.save(_sprung(), tmp_path / "system.npz")
    edit, words = EDITS[what]
    with np.load(path) as file:
        members = edit(dict(file))
    changed(path, **members)
    assert_refused(path, f"{SAVED}|has no 'description'")
    if words:
        changed(path, summed=True)
        assert_refused(path, words)


@pytest.mark.parametrize("what", DAMAGE)
def test_a_file_that_is_wrong_is_one_sentence(tmp_path, what):
    path = sj.save(bar(), tmp_path / "system.npz")
    make, words, summed = DAMAGE[what]
    changed(path, **make(path))
    assert_refused(path, words)
    if summed:
        changed(path, summed=True)
        assert_refused(path, summed)


def test_a_cut_or_changed_file_is_one_sentence(tmp_path):
    path = sj.save(bar(), tmp_path / "system.npz")
    whole = path.read_bytes()
    generator = np.random.default_rng(0)
    for _ in range(60):
        cut = int(generator.integers(0, len(whole)))
        path.write_bytes(whole[:cut])
        with pytest.raises(sj.InputError, match="cannot be read as a saved system"):
            sj.load(path)
        damaged = bytearray(whole)
        damaged[cut] ^= 1 << int(generator.integers(8))
        path.write_bytes(damaged)
        try:
            loaded = sj.load(path)
        except sj.InputError:
            continue
        assert fingerprint(loaded) == fingerprint(bar())  # bytes that no reader uses
    with pytest.raises(sj.InputError, match="no such file"):
        sj.load(tmp_path / "nothing.npz")
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as file:
        file.writestr("description.npy", b"nothing")
    path.write_bytes(packed.getvalue())
    with pytest.raises(sj.InputError, match="cannot be read"):
        sj.load(path)
