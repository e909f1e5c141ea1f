"""Runs that are killed go on from their checkpoints to the same result, to the bit."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stepping_systems import STEPPERS, LapJoint, differing, of_stepper, oscillator

import skfem_joint as sj
from skfem_joint.stepping.checkpoint import Checkpoint, fingerprint
from skfem_joint.stepping.schemes import generalized_alpha

JOINT = LapJoint(elements=30)
# Jumps off the grid of steps: parts of steps, each with a matrix of its own.
JUMP = sj.Rectangle(62e3, 3.37e-4, 1.13e-4)
KINDS = [(kind, None) for kind in STEPPERS] + [("chain", JUMP), ("contact Coulomb", JUMP)]
TIMING: dict[str, Any] = {
    "step": 5e-6,
    "n_steps": 120,
    "cycle_steps": 10,
    "save": sj.Save(every=3, fields=True, fields_every=7),
    "scheme": generalized_alpha(0.8),
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


@pytest.mark.parametrize(("kind", "load"), KINDS)
@pytest.mark.parametrize("killed", [10, 70])
def test_a_run_taken_up_again_is_the_same_to_the_bit(kind, load, killed, tmp_path):
    system, path = of_stepper(kind, load), tmp_path / "run.npz"
    whole = sj.integrate(system, **TIMING)
    with pytest.raises(KilledError):
        sj.integrate(
            system, **TIMING, progress=kill_at(killed), checkpoint=Checkpoint(path, "a", every=20)
        )
    ends: list[int] = []
    run = sj.integrate(
        system,
        **TIMING,
        progress=lambda done, total: ends.append(done),
        checkpoint=Checkpoint(path, "a", every=20, resume=True),
    )
    saved = killed // 20 * 20
    assert saved < ends[0] <= saved + 10
    assert differing(whole, run) == []
    again = sj.integrate(
        system, **TIMING, progress=never, checkpoint=Checkpoint(path, "a", resume=True)
    )
    assert differing(whole, again) == []
    assert again.wall_s == run.wall_s > 0.0


def test_what_is_integrated_must_be_the_same(tmp_path):
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=100)
    system = JOINT.system
    sj.integrate(system, **TIMING, checkpoint=checkpoint)
    before = checkpoint.path.read_bytes()
    changes: list[tuple[sj.System, dict[str, Any]]] = [
        (replace(system, beta=np.nextafter(system.beta, 0.0)), {}),
        (replace(JOINT, force=63e3 + 1.0).system, {}),
        (system, {"step": 5.1e-6}),
        (system, {"n_steps": 121}),
        (system, {"cycle_steps": None}),
        (system, {"save": sj.Save()}),
        (system, {"scheme": generalized_alpha(0.9)}),
        (system, {"tolerance": 1e-12}),
        (system, {"initial": (np.zeros(30), np.full(30, 1e-9))}),
    ]
    for changed, timing in changes:
        with pytest.raises(sj.InputError, match=r"run\.npz: the model .* differs"):
            sj.integrate(changed, **(TIMING | timing), checkpoint=replace(checkpoint, resume=True))
    with pytest.raises(sj.InputError, match="another scene or mesh"):
        sj.integrate(system, **TIMING, checkpoint=replace(checkpoint, origin="b", resume=True))
    assert checkpoint.path.read_bytes() == before


def test_another_version_is_refused(tmp_path, monkeypatch):
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=100, resume=True)
    sj.integrate(JOINT.system, **TIMING, checkpoint=checkpoint)
    monkeypatch.setattr("skfem_joint.stepping.checkpoint.__version__", "99.0")
    with pytest.raises(sj.InputError, match=r"written by version .*, this is 99\.0"):
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
    with pytest.raises(sj.InputError, match=r"skfem_joint\.loads"):
        sj.integrate(plain, step=0.01, n_steps=10, checkpoint=Checkpoint(tmp_path / "run.npz", "a"))


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(tmp_path, monkeypatch):
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=100)
    checkpoint.save({"stepper": {"rows": np.arange(3)}}, "b", 100, 1.0)

    def half(file, **_):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("skfem_joint.stepping.checkpoint.np.savez", half)
    with pytest.raises(sj.InputError, match="No space left"):
        checkpoint.save({"stepper": {"rows": np.arange(4)}}, "b", 200, 2.0)
    loaded = replace(checkpoint, resume=True).load("b")
    assert loaded[1:] == (100, 1.0)
    assert loaded[0]["stepper"]["rows"].size == 3
    assert os.listdir(tmp_path) == ["run.npz"]
