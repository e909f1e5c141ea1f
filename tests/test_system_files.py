"""A system that is saved and loaded is the same to the last bit; damaged files are sentences."""

import io
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

import skfem_joint as sj
from skfem_joint.ground.loads import Scaled
from skfem_joint.ground.plain_values import fingerprint

TIMES = np.linspace(0.0, 2e-3, 7)
SHAPES = [
    sj.Harmonic(40e3, 500, 0.1),
    sj.MultiHarmonic([sj.Harmonic(20e3, 500.0), sj.Harmonic(10e3, 1500.0)]),
    sj.Triangle(40e3, 2e-4),
    sj.HalfSine(40e3, 2e-4, 1e-5),
    sj.Versine(40e3, 2e-4),
    sj.RampAndHold(40e3, 2e-4),
    sj.Rectangle(40e3, 2e-4),
    sj.SweptSine(40e3, 500.0, 1000.0, 60.0),
    sj.Table(TIMES, 1e4 * np.sin(1e3 * TIMES)),
    Scaled(sj.Table(TIMES, np.sin(1e3 * TIMES)), 1e4),
]


def bar(*shapes):
    """A bar pressed on a base over a third of its length, with springs in series with friction."""
    mesh = sj.build_bar([("joint", 0.1, 10), ("arm", 0.2, 10)], {"loaded_end": 0.1, "end": 0.3})
    structure = sj.Structure(
        mesh, sj.Material(E=200e9, density=8000.0), width=0.05, thickness=0.01,
        joints=[sj.Joint("joint", 50e6, 0.7, tangential_stiffness=1e13)],
        stiffness_damping=1e-6, free=True,
    )  # fmt: skip
    return structure.system([sj.Load("end", shape) for shape in shapes or SHAPES[:1]])


def rigid():
    return bar().with_contact(stiffness=None)


def point():
    """A mass whose contact slips as it approaches."""
    stiff = {"normal_stiffness": 5.0, "stiffness": 20.0}
    foot = sj.point_contact([1.0], [1.0], friction=0.3, force=1.0, **stiff)
    loads = {"end": (0, sj.Harmonic(2.0, 0.3))}
    return sj.System.from_matrices([[1.0]], [[4.0]], contact=foot, loads=loads)


MODELS = {
    "point": point,
    "full": lambda: replace(bar(), notes=("of a test",)),
    "columns": lambda: replace(
        rigid(), K=sparse.csc_array(rigid().K), T=np.asfortranarray(rigid().T.toarray())
    ),
    "condensed": lambda: sj.condense(rigid()),
    "reduced": lambda: sj.reduce(rigid(), modes=6),
    "projected": lambda: rigid().project(sj.natural_modes(rigid(), 8).modes).with_beta(1e5),
}


@pytest.mark.parametrize("name", MODELS)
def test_a_loaded_system_integrates_to_the_same_bits(tmp_path, name):
    system = MODELS[name]()
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


def rewrite(path, arrays, summed=False):
    """Write a file anew with other members, without those that are None.

    If ``summed``, with a digest that is right again, as a mistake of the package would.
    """
    arrays = {name: np.asarray(x) for name, x in arrays.items() if x is not None}
    if summed:
        content = json.loads(str(arrays.pop("description")))
        del content["digest"]
        content["digest"] = fingerprint(arrays, json.dumps(content))
        arrays["description"] = np.array(json.dumps(content))
    np.savez(path, **arrays)


def described(arrays, of_system=(), **changes):
    """Other entries of the description, and other fields of its system."""
    content = json.loads(str(arrays["description"])) | changes
    content["system"]["!System"] |= dict(of_system)
    return {"description": np.array(json.dumps(content))}


def load_of(arrays, **amplitude):
    """Description with a load of another amplitude."""
    vector = {"!array": "loads/0/vector"}
    load = {"!AppliedLoad": {"vector": vector, "on": "end", "amplitude": amplitude}}
    return described(arrays, {"loads": {"!tuple": [load]}})


def without(matrix):
    return lambda _: {
        f"{matrix}/{x}": None for x in ("format", "shape", "data", "indices", "indptr")
    }


def scaled(member, factor):
    return lambda arrays: {member: factor * arrays[member]}


HARMONIC = {"amplitude": 1.0, "frequency": -2.0, "phase": 0.0}
SAVED = "not what was saved|has no 'description'"
GIVEN, SPRINGS, TABLE = "contact/given", "contact/stiffness", "loads/1/amplitude/"  # members
ROWS = "contact/B/indices"
#: What is done to the members of a file, and what is said of it if its digest is right again.
EDITS = {
    "indices": (lambda _: {ROWS: np.full(11, 10**6)}, "indices must be"),
    "starts": (lambda _: {"K/indptr": np.array([0, 10**9])}, "indptr|index pointer"),
    "shape": (
        lambda _: {"T/shape": np.array([10**12, 21])}, "too few|indptr|index pointer"
    ),
    "no mass": (without("M"), "no .*M"),
    "no points": (without("P"), "no .*P"),
    "no T": (without("T"), ""),
    "no indices": (lambda _: {ROWS: None}, "has no 'contact/B/indices'"),
    "no springs": (lambda _: {SPRINGS: None}, ""),
    "no forces": (lambda _: {f"{TABLE}forces": None}, f"has no '{TABLE}forces'"),
    "no description": (lambda _: {"description": None}, ""),
    "no names": (lambda a: described(a, {"points": {"!tuple": []}}), "P: found shape"),
    "more": (lambda _: {"more": np.zeros(3)}, ""),
    "another limit": (scaled(GIVEN, 2.0), ""),
    "another shape": (lambda a: {GIVEN: a[GIVEN][np.newaxis]}, ""),
    "small floats": (lambda a: {SPRINGS: a[SPRINGS].astype(np.float32)}, ""),
    "nan": (scaled(GIVEN, np.nan), "must be finite and not negative"),
    "springs of nan": (scaled(SPRINGS, np.nan), "stiffness: must be positive"),
    "one spring": (lambda _: {SPRINGS: np.full(1, 1e9)}, "stiffness: found shape"),
    "negative": (scaled(GIVEN, -1.0), "must be finite and not negative"),
    "negative mass": (scaled("M/data", -1.0), "M: is not positive definite"),
    "negative stiffness": (scaled("K/data", -1.0), "K: is indefinite"),
    "negative damping": (scaled("C/data", -1.0), "C: is negative somewhere"),
    "infinite mass": (scaled("M/data", np.inf), "M: "),
    "halves": (scaled("contact/directions", 1.5), "must be 1 or 2"),
    "one number": (lambda a: {GIVEN: a[GIVEN][0]}, "must be 1 or 2"),
    "texts": (lambda _: {GIVEN: np.array(["a"] * 11)}, "real numbers"),
    "truth values": (lambda a: {GIVEN: a[GIVEN] > 0.0}, "real numbers"),
    "complex": (scaled("K/data", 1j), "real numbers"),
    "times": (lambda a: {f"{TABLE}times": a[f"{TABLE}times"][:-1]}, "Table|times"),
    "load": (lambda a: load_of(a, **{"!Harmonic": HARMONIC}), "frequency: found -2"),
    "no shape": (lambda a: load_of(a, **{"!os": {}}), "none of the package"),
}  # fmt: skip


def assert_refused(path, words):
    with pytest.raises(sj.InputError, match=f"cannot be read as a saved system: .*({words})"):
        sj.load(path)


@pytest.fixture
def saved(tmp_path):
    """File of a system, and its members."""
    system = bar(SHAPES[0], sj.Table(TIMES, np.sin(1e3 * TIMES)))
    path = sj.save(system, tmp_path / "system.npz")
    with np.load(path) as file:
        return path, dict(file)


@pytest.mark.parametrize("what", EDITS)
def test_an_edited_file_is_one_sentence(saved, what):
    """Also where what is left would make a system, such as one without springs."""
    path, arrays = saved
    edit, words = EDITS[what]
    edited = arrays | edit(arrays)
    rewrite(path, edited)
    assert_refused(path, SAVED)
    if words:
        rewrite(path, edited, summed=True)
        assert_refused(path, words)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda _: {GIVEN: np.array([None] * 11, dtype=object)}, "Object arrays"),
        (lambda a: described(a, kind="x"), "something else"),
        (lambda a: described(a, form=9), "form 9"),
    ],
)
def test_a_file_of_another_kind_is_one_sentence(saved, edit, words):
    path, arrays = saved
    rewrite(path, arrays | edit(arrays))
    assert_refused(path, words)


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
