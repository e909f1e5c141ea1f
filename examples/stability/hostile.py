"""Hostile files of matrices, meshes, tables and checkpoints: refused in a sentence, or run rightly.

    python examples/stability/hostile.py --out DIR [--count 200] [--seed 0]

Each file is damaged in one of five ways: its *indices* point outside, its *sizes* are false, its
values are of another *type*, it is *cut*, or any of its *bytes* are changed. The command `run`
reads it in a process of its own, which must not crash, end in a traceback, or take more than 60 s
or 2 GiB.

A damaged file that is run is judged by its results:

- *same*: they are those of the undamaged file; the damage did not matter;
- *another file*: they differ, and the damaged file is a proper one of other numbers, which no
  reader can tell from what was meant. Only three damages make such files: changed bytes of files
  that have no checksum (.mtx, .csv, .msh and uncompressed .mat), a .csv that is cut at the end of a
  row, and a .csv that is cut in its last number, of which a warning must be given. Their energy
  must balance as that of any run;
- *wrong in silence*: they differ otherwise.

A table lists all files. The exit status is 1 if a file made the command crash, end in a traceback,
take too long or too much memory, or give wrong results in silence; such files are kept in DIR.
"""

import contextlib
import io
import json
import multiprocessing
import random
import resource
import struct
import sys
import time
import zipfile
import zlib
from collections import Counter
from pathlib import Path
from shutil import copytree, rmtree
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from benchmarks import head, row
from scipy import sparse
from scipy.io import mmwrite, savemat

from skfem_joint import build_bar, cli, load_scene, run_scene
from skfem_joint.ground.array_files import npz_arrays
from skfem_joint.mesh import write_mesh
from skfem_joint.stepping.checkpoint import Checkpoints
from stability.launch import command_line
from stability.mutated import damaged

#: Unknowns of the system whose matrices are damaged.
N = 16
#: Whole numbers that an index or a size may become.
WILD = (-1, -(2**31), N, 2**20, 2**31 - 1)
HUGE = (10**6, 2**31 - 1, 10**12)
KINDS = [
    *(f"{form}.npz" for form in ("csr", "csc", "bsr", "coo", "dia", "dense")),
    *("packed.mat", "plain.mat", "coordinate.mtx", "array.mtx"),
    *("contact.csv", "force.csv", "mesh.msh", "checkpoint.npz"),
]
BY_MATRICES = """
[[joint]]
on = "lap"
pressure = 10.0
friction = 0.5
law = "coulomb"
[[load]]
on = "tip"
kind = "table"
file = "force.csv"
[time]
duration = 1.0
step = 0.005
"""
BY_MESH = """
[mesh]
file = "mesh.msh"
[material]
E = 200e9
density = 8000.0
[section]
width = 0.05
thickness = 0.01
[support]
fixed = ["end"]
[[joint]]
on = "joint"
pressure = 50e6
friction = 0.7
beta = 1e5
[[load]]
on = "tip"
kind = "harmonic"
amplitude = 50e3
frequency = 500.0
[time]
cycles = 6
steps_per_cycle = 40
"""


class KilledError(Exception):
    """End of a run in its middle, which leaves its checkpoint."""


class Case(NamedTuple):
    """A damaged file, and its place in the folder of its scene."""

    kind: str
    damage: str
    file: str
    content: bytes
    may_differ: bool = False  #: whether it may be another proper file


class Verdict(NamedTuple):
    """Outcome of a file."""

    case: Case
    status: int | None  #: exit status; a signal's number below zero; None: ended after 60 s
    outcome: str
    sentence: str
    seconds: float
    memory: float  #: MiB, the most that was in memory at a time

    @property
    def is_right(self):
        """Whether the file was refused, or run with right results."""
        return self.outcome in ("refused", "same", "another file")


# Undamaged files


def stiffness(form="csr"):
    """Chain of masses whose entries single and half precision hold exactly."""
    K = 1024.0 * (2.0 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
    return K if form == "dense" else sparse.csr_array(K).asformat(form)


def write_matrix(path, A):
    """Store a matrix in the form that the name and the ending of the file state."""
    if path.name == "dense.npz":
        np.savez(path, K=A)
    elif path.suffix == ".npz":
        sparse.save_npz(path, A)
    elif path.suffix == ".mat":
        savemat(path, {"K": A}, do_compression=path.name == "packed.mat")
    else:
        mmwrite(path, A, precision=17)


def form_of(kind):
    """Form of the matrix in a kind of file."""
    forms = {"packed": "csc", "plain": "csc", "coordinate": "coo", "array": "dense"}
    return forms.get(Path(kind).stem, Path(kind).stem)


def write_scene(folder, kind):
    """Write the undamaged scene that a kind of file belongs to."""
    folder.mkdir(parents=True)
    if kind in ("mesh.msh", "checkpoint.npz"):
        strips = [("joint", 0.1, 8), ("rest", 0.5, 12)]
        write_mesh(build_bar(strips, {"end": 0.0, "tip": 0.6}), folder / "mesh.msh")
        (folder / "scene.toml").write_text(BY_MESH, encoding="utf-8")
        return
    by_kind = kind if not kind.endswith(".csv") else "csr.npz"
    write_matrix(folder / by_kind, stiffness(form_of(by_kind)))
    sparse.save_npz(folder / "M.npz", sparse.eye_array(N, format="csr"))
    sparse.save_npz(folder / "C.npz", sparse.csr_array(stiffness() / 1024.0))
    np.savez(folder / "tip.npz", tip=np.eye(N)[-1])
    pairs = [f"{4 * i},,,{4 * i + 1},,,0,0,1,1.25\n" for i in range(3)]
    (folder / "contact.csv").write_text("".join(pairs))
    rows = [f"{0.1 * k:.3f},{20.0 * np.sin(2.0 * k):.6f}\n" for k in range(11)]
    (folder / "force.csv").write_text("time, force\n" + "".join(rows))
    tables = f'K = "{by_kind}"\nM = "M.npz"\nC = "C.npz"\npoints = {{ tip = "tip.npz" }}\n'
    tables += 'contact = { lap = "contact.csv" }\n'
    (folder / "scene.toml").write_text(f"[matrices]\n{tables}{BY_MATRICES}", encoding="utf-8")


def write_checkpoint(folder):
    """Run a scene to its middle, with checkpoints."""

    def kill(label, done, total):
        if label == "full model" and done >= total // 2:
            raise KilledError

    (folder / "out").mkdir()
    with contextlib.suppress(KilledError):
        run_scene(load_scene(folder / "scene.toml"), kill, Checkpoints(folder / "out", every=40))


# Damage


def cases(folder, kind, rng):
    """Endless sequence of damaged files of a kind."""
    file = "out/checkpoint_full.npz" if kind == "checkpoint.npz" else kind
    content = (folder / file).read_bytes()
    unsummed = kind.endswith((".csv", ".msh", ".mtx")) or kind == "plain.mat"
    special = SPECIAL.get(kind, _of_array if kind.endswith(".npz") else None)
    for number in range(sys.maxsize):
        how = ("special", "special", "special", "cut", "bytes")[number % 5]
        if how == "special" and special is not None:
            damage, data = special(content, rng, kind)
            other = damage == "bytes" and kind != "checkpoint.npz"  # which has a sum
            yield Case(kind, damage, file, data, other)
        elif how == "bytes":
            yield Case(kind, "bytes", file, damaged(content, rng), unsummed)
        else:
            data = content[: rng.randrange(len(content))]
            yield Case(kind, "cut", file, data, kind.endswith(".csv"))


def _of_array(content, rng, kind):
    """An array of an .npz file with other indices, another size or another type."""
    arrays = npz_arrays(io.BytesIO(content))
    how = rng.choice(["index", "size", "size", "type"])
    indices = [name for name in ("indices", "indptr", "row", "col", "offsets") if name in arrays]
    numbers = [name for name in arrays if name not in ("format", "_is_array", "notes")]
    if how == "index" and indices:
        name = rng.choice(indices)
        arrays[name][rng.randrange(arrays[name].size)] = rng.choice(WILD)
    elif how == "type":
        name = rng.choice(numbers)
        types = ["c16", "f2", "U8", "?", "O", "m8[s]", "u1"]
        # If the narrow type cannot hold a number, this is a proper file of other numbers.
        kept = arrays[name]
        arrays[name] = kept.astype(rng.choice(types))
        with contextlib.suppress(TypeError, ValueError):
            return ("type" if np.array_equal(arrays[name], kept) else "bytes"), _npz(arrays)
    elif "shape" in arrays and rng.random() < 0.5:
        arrays["shape"] = np.array(rng.choice([(h, h) for h in HUGE] + [(N, 2**40), (-N, N)]))
    else:
        return "size", _lying(arrays, rng.choice(numbers), rng)
    return ("index" if how == "index" and indices else "size"), _npz(arrays)


def _npz(arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def _lying(arrays, name, rng):
    """Archive in which an array's header states a larger size, or which unpacks to 1 GiB."""
    content, file = io.BytesIO(_npz(arrays)), io.BytesIO()
    bomb = rng.random() < 0.2
    how = zipfile.ZIP_DEFLATED if bomb else zipfile.ZIP_STORED
    with zipfile.ZipFile(content) as old, zipfile.ZipFile(file, "w", how) as new:
        for member in old.namelist():
            data = old.read(member)
            if member == f"{name}.npy":
                count = 2**27 if bomb else rng.choice(HUGE)
                text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({count},), }}"
                text = text.ljust(117) + "\n"
                data = b"\x93NUMPY\x01\x00" + struct.pack("<H", 118) + text.encode()
                data += bytes(8 * count if bomb else 64)
            new.writestr(member, data)
    return file.getvalue()


def _of_matlab(content, rng, kind):
    """A MATLAB file with another row index, other dimensions or other values."""
    plain = io.BytesIO()
    savemat(plain, {"K": stiffness("csc")})
    data = bytearray(plain.getvalue())
    how = rng.choice(["index", "size", "type"])
    if how == "type":
        K = stiffness("dense")
        others = [K * 1j, "text", {"K": K}, np.array([{}, "text"], dtype=object), K > 0.0]
        other = io.BytesIO()
        savemat(other, {"K": rng.choice(others)}, do_compression=kind == "packed.mat")
        return how, other.getvalue()
    part = "indices" if rng.random() < 0.6 else "indptr"
    indices = getattr(stiffness("csc"), part).astype("<i4").tobytes()
    at = data.index(indices) + 4 * rng.randrange(len(indices) // 4)
    if how == "size":  # dimensions, or how many bytes there are
        at = data.index(struct.pack("<ii", N, N)) + rng.choice([0, 4, -4, 12])
    data[at : at + 4] = struct.pack("<i", rng.choice(WILD))
    if kind == "packed.mat":
        packed = zlib.compress(bytes(data[128:]) + bytes(2**29 if rng.random() < 0.1 else 0))
        data = data[:128] + struct.pack("<II", 15, len(packed)) + packed
    return how, bytes(data)


def _of_text(content, rng, kind):
    """A MatrixMarket file or a mesh with other counts, indices or types."""
    lines = content.split(b"\n")
    how = rng.choice(["size", "index", "type"])
    if how == "type" and kind.endswith(".mtx"):
        words = [b"complex", b"pattern", b"text", b"integer", b"skew-symmetric"]
        word = rng.choice([old for old in (b"real", b"symmetric", b"general") if old in lines[0]])
        lines[0] = lines[0].replace(word, rng.choice(words))
    else:
        whole = [k for k, line in enumerate(lines) if line.replace(b" ", b"").isdigit()]
        at = rng.choice(whole[:4] if how == "size" else whole)
        words = lines[at].split(b" ")
        words[rng.randrange(len(words))] = str(rng.choice([*WILD, *HUGE])).encode()
        lines[at] = b" ".join(words)
    # Another node or place that exists makes a proper file of other numbers.
    return ("bytes" if how == "index" else how), b"\n".join(lines)


def _of_table(content, rng, kind):
    """A table of other words, or of very many lines."""
    lines = content.split(b"\n")
    at = rng.randrange(len(lines) - 1)
    how = rng.choice(["size", "type"])
    if how == "size":
        lines[at] = rng.choice([lines[at] * 1000, b"x," * 10**5, b"\n".join([lines[at]] * 10**5)])
    else:
        words = lines[at].split(b",")
        word = rng.choice([b"1j", b"text", b"\xff\xfe", b"0x10", b"1e999", b"\0", b"1_0"])
        words[rng.randrange(len(words))] = word
        lines[at] = b",".join(words)
    return "bytes", b"\n".join(lines)


SPECIAL = {
    **dict.fromkeys(("packed.mat", "plain.mat"), _of_matlab),
    **dict.fromkeys(("coordinate.mtx", "array.mtx", "mesh.msh"), _of_text),
    **dict.fromkeys(("contact.csv", "force.csv"), _of_table),
}


# Judging


def command(folder):
    """Run the scene of a folder with at most 8 GiB of addresses; messages go to a file there."""
    resource.setrlimit(resource.RLIMIT_AS, (8 * 2**30, 8 * 2**30))
    status = 1
    with (
        (folder / "said.txt").open("w", encoding="utf-8") as said,
        contextlib.redirect_stderr(said),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        arguments = ["run", str(folder / "scene.toml"), "--out", str(folder / "out"), "--resume"]
        status = cli.main(arguments)
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    (folder / "memory.txt").write_text(f"{used}", encoding="ascii")
    sys.exit(status)


def run_apart(context, folder):
    """Exit status of `command` (None: ended after 60 s), its messages, seconds, and MiB."""
    process, begin = context.Process(target=command, args=(folder,)), time.perf_counter()
    process.start()
    process.join(60.0)
    seconds, status = time.perf_counter() - begin, process.exitcode
    if status is None:
        process.kill()
        process.join()
    said, memory = folder / "said.txt", folder / "memory.txt"
    text = said.read_text(encoding="utf-8", errors="replace") if said.exists() else ""
    used = float(memory.read_text()) if memory.exists() else 0.0
    return status, text, seconds, used


def results(folder):
    """Arrays of the history, and the energy left over."""
    with np.load(folder / "out" / "history.npz", allow_pickle=False) as arrays:
        history = dict(arrays)
    summary = json.loads((folder / "out" / "summary.json").read_text(encoding="utf-8"))
    return history, summary["models"]["full"]["energy_balance_residual"]


def same(history, other):
    """Whether two histories are equal but for round-off."""
    if history.keys() != other.keys():
        return False
    pairs = [(history[name], other[name]) for name in history]
    return all(
        a.shape == b.shape and np.allclose(a, b, rtol=0.0, atol=1e-9 * np.abs(b).max(initial=0.0))
        if a.dtype.kind == "f"
        else np.array_equal(a, b)
        for a, b in pairs
    )


def judge(case, folder, context, whole):
    """Run a damaged file and judge the outcome."""
    (folder / case.file).write_bytes(case.content)
    status, said, seconds, memory = run_apart(context, folder)
    sentence = " ".join(said.split())
    outcome = "refused" if status in (2, 3) and sentence else "crashed"
    if status is None:
        outcome = "too slow"
    elif memory > 2048.0:
        outcome = "too much memory"
    elif status == 0:
        history, energy = results(folder)
        cut = case.damage == "cut" and not case.content.endswith(b"\n")
        if same(history, whole):
            outcome = "same"
        elif case.may_differ and energy <= 1e-6 and (not cut or "does not end" in said):
            outcome = "another file"
        else:
            outcome = "wrong in silence"
    return Verdict(case, status, outcome, sentence, seconds, memory)


def judged(kinds, count, seed, out):
    """Verdicts on ``count`` damaged files, the kinds in turn."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["skfem_joint.cli", "skfem_joint.study.study"])
    drawn, wholes = {}, {}
    for kind in kinds:
        base = out / "whole" / kind.replace(".", "_")
        write_scene(base, kind)
        copytree(base, base / "run")
        status, said, _, _ = run_apart(context, base / "run")
        if status != 0:
            raise RuntimeError(f"{kind}: undamaged, status {status}: {said}")
        wholes[kind] = results(base / "run")[0]
        rmtree(base / "run")
        if kind == "checkpoint.npz":
            write_checkpoint(base)
        drawn[kind] = cases(base, kind, random.Random(f"{seed} {kind}"))
    for number in range(count):
        kind = kinds[number % len(kinds)]
        folder = out / f"file_{number}"
        copytree(out / "whole" / kind.replace(".", "_"), folder)
        verdict = judge(next(drawn[kind]), folder, context, wholes[kind])
        if verdict.is_right:
            rmtree(folder)
        yield number, verdict
    rmtree(out / "whole")


def main(arguments=None):
    """Judge damaged files; returns 1 if any of them breaks something."""
    parser = command_line(__doc__, count=200, seed=0)
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=KINDS)
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    head("file", "kind", "damage", "status", "outcome", "s", "MiB", "sentence")
    outcomes, broken, slowest, largest = Counter(), 0, 0.0, 0.0
    for number, verdict in judged(options.kinds, options.count, options.seed, options.out):
        case, sentence = verdict.case, verdict.sentence.replace("|", "/")
        figures = f"{verdict.seconds:.1f}", f"{verdict.memory:.0f}", sentence[-160:]
        row(number, case.kind, case.damage, verdict.status, verdict.outcome, *figures)
        outcomes[verdict.outcome] += 1
        broken += not verdict.is_right
        slowest, largest = max(slowest, verdict.seconds), max(largest, verdict.memory)
    counts = ", ".join(f"{count} {word}" for word, count in sorted(outcomes.items()))
    print(f"\n{options.count} files: {counts}; {broken} broken.")
    print(f"At most {slowest:.1f} s and {largest:.0f} MiB.")
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main())
