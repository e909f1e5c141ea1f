"""Runs that are killed go on from their checkpoints to the same result, to the bit."""

import json
import os
import resource
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from opening_blocks import SIZE, block, loads
from stepping_systems import STEPPERS, LapJoint, differing, of_stepper, oscillator

import skfem_joint as sj
from skfem_joint import cli
from skfem_joint.minimise import touching
from skfem_joint.scene.shipped import write_shipped
from skfem_joint.stepping.checkpoint import Checkpoint, Checkpoints, fingerprint

JOINT = LapJoint(elements=30)
TIMING: dict[str, Any] = {
    "step": 5e-6,
    "n_steps": 120,
    "cycle_steps": 10,
    "save": sj.Save(every=3, fields=True, fields_every=7, slips=True),
    "scheme": sj.generalized_alpha(0.8),
}


def on_springs(kind: str) -> sj.System:
    """One of the steppers' systems, on springs that stretch by 1 µm under the limits."""
    system = of_stepper(kind)
    return system.with_contact(stiffness=1e6 * system.contact.w)


def opening(**joint: Any) -> sj.System:
    return block(**joint).system(loads(up=230e3))


def wide() -> sj.System:
    """Block with so many points that those that are apart are left out of a step."""
    sides = {"base": "bottom", "top": "top", "left": "left", "right": "right"}
    mesh = sj.build_plate([("block", SIZE, 80)], SIZE, 2, boundaries=sides)
    return replace(block(), mesh=mesh).system(loads(up=230e3))


# Jumps off the grid of steps: parts of steps, each with a matrix of its own.
JUMP = sj.Rectangle(62e3, 3.37e-4, 1.13e-4)
CONSTANT: dict[str, Callable[[], sj.System]] = {
    **{kind: lambda kind=kind: of_stepper(kind) for kind in STEPPERS},
    **{f"{kind} on springs": lambda kind=kind: on_springs(kind) for kind in ("chain", "contact")},
    **{f"{kind} jump": lambda kind=kind: of_stepper(kind, JUMP) for kind in ("chain", "contact")},
}
OPENING: dict[str, Callable[[], sj.System]] = {
    "opens": opening,
    "opens condensed": lambda: sj.condense(opening()),
    "opens on springs": lambda: opening(tangential_stiffness=2e13),
    "opens far apart": wide,
    "opens, moving points alone": wide,
}


class KilledError(Exception):
    """Ends a run as a kill would: nothing of it is left but its files."""


def kill_at(step: int) -> Callable[[int, int], None]:
    def progress(done: int, total: int) -> None:
        if done >= step:
            raise KilledError

    return progress


def never(done: int, total: int) -> None:
    raise AssertionError(f"integrated {done} of {total} steps again")


@pytest.mark.parametrize(
    ("kind", "killed"), [("chain", 10), *((kind, 70) for kind in [*CONSTANT, *OPENING])]
)
def test_a_run_taken_up_again_is_the_same_to_the_bit(kind, killed, tmp_path, request):
    opens = kind in OPENING
    if kind.endswith("moving points alone"):
        request.getfixturevalue("few_may_move")
    system = (OPENING if opens else CONSTANT)[kind]()
    timing = TIMING | {"step": 1.0 / 60e3 if opens else TIMING["step"]}
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=20)
    whole = sj.integrate(system, **timing)
    assert whole.opened.any() == opens
    if kind == "opens far apart":
        assert np.count_nonzero(whole.opened) > touching.FEWEST
    with pytest.raises(KilledError):
        sj.integrate(system, **timing, progress=kill_at(killed), checkpoint=checkpoint)
    checkpoint, ends = replace(checkpoint, resume=True), []
    run = sj.integrate(
        system, **timing, progress=lambda done, total: ends.append(done), checkpoint=checkpoint
    )
    saved = killed // 20 * 20
    assert saved < ends[0] <= saved + 10
    assert differing(whole, run) == []
    again = sj.integrate(system, **timing, progress=never, checkpoint=checkpoint)
    assert differing(whole, again) == []
    assert again.wall_s == run.wall_s > 0.0


def test_what_is_integrated_must_be_the_same(tmp_path):
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=100)
    system = JOINT.system
    sj.integrate(system, **TIMING, checkpoint=checkpoint)
    before = checkpoint.path.read_bytes()
    changes: list[tuple[sj.System, dict[str, Any]]] = [
        (system.with_contact(beta=np.nextafter(system.contact.beta, 0.0)), {}),
        (replace(JOINT, force=63e3 + 1.0).system, {}),
        (system, {"step": 5.1e-6}),
        (system, {"n_steps": 121}),
        (system, {"cycle_steps": None}),
        (system, {"save": sj.Save()}),
        (system, {"scheme": sj.generalized_alpha(0.9)}),
        (system, {"tolerance": 1e-12}),
        (system, {"initial": (np.zeros(30), np.full(30, 1e-9))}),
    ]
    for changed, timing in changes:
        with pytest.raises(sj.InputError, match=r"run\.npz: the model .* differs"):
            sj.integrate(changed, **(TIMING | timing), checkpoint=replace(checkpoint, resume=True))
    with pytest.raises(sj.InputError, match="another scene or mesh"):
        sj.integrate(system, **TIMING, checkpoint=replace(checkpoint, origin="b", resume=True))
    assert checkpoint.path.read_bytes() == before


def test_another_version_is_refused(tmp_path):
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=100, resume=True)
    sj.integrate(JOINT.system, **TIMING, checkpoint=checkpoint)
    with np.load(checkpoint.path) as stored:
        arrays = dict(stored)
    notes = json.loads(str(arrays["notes"])) | {"version": "99.0"}
    np.savez(checkpoint.path, **arrays | {"notes": np.array(json.dumps(notes))})
    with pytest.raises(sj.InputError, match=r"written by version 99\.0, this is"):
        sj.integrate(JOINT.system, **TIMING, checkpoint=checkpoint)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["chain", "dense", "contact"])
def test_a_damaged_checkpoint_is_refused_or_is_the_whole_one(name, seed, tmp_path):
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=100, resume=True)
    system = replace(JOINT, elements=4).system if name == "chain" else of_stepper(name)
    timing = TIMING | {"n_steps": 30}
    whole = sj.integrate(system, **timing, checkpoint=checkpoint)
    data, rng = checkpoint.path.read_bytes(), np.random.default_rng(seed)
    damaged = [data[: rng.integers(len(data))] for _ in range(10)] + [b""]
    for _ in range(40):
        copy = bytearray(data)
        for place in rng.integers(len(data), size=rng.integers(1, 4)):
            copy[place] = rng.integers(256)
        damaged.append(bytes(copy))
    messages = []
    for content in damaged:
        checkpoint.path.write_bytes(content)
        try:
            run = sj.integrate(system, **timing, checkpoint=checkpoint)
        except sj.InputError as error:
            messages.append(str(error))
        else:
            assert differing(whole, run) == []
    assert len(messages) > 25
    assert all(message.startswith(str(checkpoint.path)) for message in messages)


def test_objects_in_a_checkpoint_are_not_loaded(tmp_path):
    class Trap:
        def __reduce__(self):
            return (Path.write_text, (tmp_path / "sprung", "code ran"))

    path = tmp_path / "run.npz"
    np.savez(path, notes=np.array([Trap()], dtype=object))
    with pytest.raises(sj.InputError, match="cannot be read as a checkpoint"):
        Checkpoint(path, "a", resume=True).load("b")
    assert not (tmp_path / "sprung").exists()


def test_fingerprints_tell_apart_what_differs_and_nothing_else():
    table = sj.Table([0.0, 1.0], [0.0, 1.0])
    same = fingerprint(JOINT.system, table, {"a": 1.0}, [None, True, "text"])
    assert fingerprint(JOINT.system, table, {"a": 1.0}, (None, True, "text")) != same
    assert fingerprint(replace(JOINT).system, table, {"a": 1.0}, [None, True, "text"]) == same
    parts: list[Any] = [0, 0.0, -0.0, False, None, "", "0", [], [0], [[0]], [0, 0], {}, {"": 0},
                        np.zeros(1), np.zeros(2), np.zeros((1, 1)), np.zeros(1, int), table,
                        sj.Table([0.0, 1.0], [0.0, 2.0]), ["ab", "c"], ["a", "bc"]]  # fmt: skip
    assert len({fingerprint(part) for part in parts}) == len(parts)


def test_plain_functions_of_time_cannot_be_saved_and_are_refused_with_advice(tmp_path):
    system = oscillator(sj.Harmonic(1.0, 1.0))
    (load,) = system.loads
    plain = replace(system, loads=(replace(load, amplitude=np.sin),))
    with pytest.raises(sj.InputError, match=r"sj\.Harmonic and sj\.Table"):
        sj.integrate(plain, step=0.01, n_steps=10, checkpoint=Checkpoint(tmp_path / "run.npz", "a"))


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(tmp_path):
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=100)
    checkpoint.save({"stepper": {"rows": np.arange(3)}}, "b", 100, 1.0)

    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))  # bytes
        with pytest.raises(sj.InputError, match="File too large"):
            checkpoint.save({"stepper": {"rows": np.arange(10_000)}}, "b", 200, 2.0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)
    loaded = replace(checkpoint, resume=True).load("b")
    assert loaded[1:] == (100, 1.0)
    assert loaded[0]["stepper"]["rows"].size == 3
    assert os.listdir(tmp_path) == ["run.npz"]


#: What a forged checkpoint has in place of one array, by its part and name; None: it has none.
ARRAYS: list[tuple[str, Callable[[Any], Any]]] = [
    ("recorder/peak", lambda a: None),
    ("stepper/more", lambda a: np.zeros(3)),
    ("other/more", lambda a: np.zeros(3)),
    ("stepper/state", lambda a: a[..., :-1]),
    ("recorder/u", lambda a: a[..., :-1]),
    *((f"recorder/{name}", lambda a: a - 1) for name in ("rows", "field_rows", "cycles")),
    *((f"recorder/{name}", lambda a: a + 10**9) for name in ("rows", "field_rows", "cycles")),
    ("stepper/state", lambda a: np.where(np.arange(a.size).reshape(a.shape) == 0, np.nan, a)),
    ("recorder/friction_work", lambda a: a + np.inf),
    ("recorder/friction_work", lambda a: a.astype(np.float32)),
    ("stepper/counts", lambda a: a.astype(str)),
    ("stepper/steps", lambda a: a[:, :4]),
]


@pytest.fixture(scope="module", params=["chain", "dense", "contact", "linear"])
def saved(request, tmp_path_factory):
    """System and its checkpoint after 40 steps."""
    system = of_stepper(request.param)
    path = tmp_path_factory.mktemp("saved") / "run.npz"
    checkpoint = Checkpoint(path, "a", every=20, resume=True)
    with pytest.raises(KilledError):
        sj.integrate(system, **TIMING, progress=kill_at(40), checkpoint=checkpoint)
    return system, checkpoint


def resave(checkpoint: Checkpoint, path: Path, name: str, make: Any, steps: Any = None) -> Any:
    """Checkpoint of a valid sum with another array, and perhaps another number of steps."""
    with np.load(checkpoint.path) as arrays:
        run = json.loads(str(arrays["notes"]))["run"]
    parts, done, elapsed = checkpoint.load(run)
    part, key = name.split("/")
    array = make(parts.setdefault(part, {}).pop(key, None))
    if array is not None:
        parts[part][key] = np.asarray(array)
    forged = replace(checkpoint, path=path)
    forged.save(parts, run, done if steps is None else steps, elapsed)
    return forged


@pytest.mark.parametrize(
    ("name", "make", "steps"),
    [
        *((*array, None) for array in ARRAYS),
        *(("recorder/u", lambda a: a, steps) for steps in (10**9, 42, 39, 0, -5)),
    ],
)
def test_a_forged_checkpoint_of_a_valid_sum_is_refused(name, make, steps, saved, tmp_path):
    """Sizes, types and places must be those that the run would have saved."""
    system, checkpoint = saved
    forged = resave(checkpoint, tmp_path / "run.npz", name, make, steps)
    with pytest.raises(sj.InputError, match=r"run\.npz: cannot be read as a checkpoint"):
        sj.integrate(system, **TIMING, checkpoint=forged)


@pytest.mark.parametrize("middle", [-1, 10**12])
def test_a_forged_place_in_a_chain_is_refused_before_compiled_code_goes_there(middle, tmp_path):
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=20, resume=True)
    system = of_stepper("chain")
    sj.integrate(system, **TIMING, checkpoint=checkpoint)
    resave(checkpoint, checkpoint.path, "stepper/middle_0", lambda a: np.full_like(a, middle))
    with pytest.raises(sj.InputError, match=r"cannot be read as a checkpoint.*middle"):
        sj.integrate(system, **TIMING, checkpoint=checkpoint)


def test_arrays_exchanged_without_the_sum_of_all_are_refused(tmp_path):
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=20, resume=True)
    sj.integrate(JOINT.system, **TIMING, checkpoint=checkpoint)
    with np.load(checkpoint.path) as stored:
        arrays = dict(stored)
    arrays["stepper/state"] = 1.001 * arrays["stepper/state"]
    np.savez(checkpoint.path, **arrays)
    with pytest.raises(sj.InputError, match="its arrays are not those that were written"):
        sj.integrate(JOINT.system, **TIMING, checkpoint=checkpoint)


def test_the_folder_of_checkpoints_is_made_or_refused_at_once(tmp_path):
    saved = Checkpoints(tmp_path / "new" / "folder", every=10)
    assert saved.folder.is_dir()
    (tmp_path / "file").write_text("")
    with pytest.raises(sj.InputError, match=r"file/folder: cannot be made .*choose another folder"):
        Checkpoints(tmp_path / "file" / "folder", every=10)
    assert Checkpoints(str(tmp_path), every=10).files() == []


@pytest.mark.parametrize("option", ["--checkpoint-every 5", "--resume"])
def test_a_search_for_steady_vibration_has_no_checkpoints_and_keeps_earlier_results(
    option, tmp_path, capsys
):
    path, out = write_shipped("structure_harmonic", tmp_path)[0], tmp_path / "out"
    text = path.read_text(encoding="utf-8").replace("cycles = 12", "until = 'steady'")
    path.write_text(text, encoding="utf-8")
    out.mkdir()
    (out / "summary.json").write_text('{"program": "skfem-joint"}', encoding="utf-8")
    assert cli.main(["run", str(path), "--out", str(out), *option.split()]) == 2
    assert "time.until = 'steady' has no checkpoints" in capsys.readouterr().err
    assert (out / "summary.json").exists()
