"""Make the claims of the verification pages anew: run their commands, write tables and pictures.

    python docs/verification/measure.py                    all of them
    python docs/verification/measure.py --list             names, durations and commands
    python docs/verification/measure.py paper steady       some of them
    python docs/verification/measure.py --quick            those that take about a minute or less
    python docs/verification/measure.py --short --out DIR  short forms, to see that they run

The commands run one after another in processes of their own, with BLAS on one thread. Each writes
its tables into ``measured/`` and its pictures into ``pictures/`` beside this file, or below
``--out``; the pages include them, so that no measured number is typed into prose. A table says
when, by which command and version, and on what machine it was made. ``--keep DIR`` keeps
all that the commands print and write. The exit status is 1 if a command failed; its tables stay as
they were. Claims that are times want a machine that does nothing else.
"""

import argparse
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import NamedTuple

from skfem_joint import __version__
from skfem_joint.ground.files import replacing

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
#: Bytes above which a picture is brought to 256 colours.
LARGEST = 200_000
#: Seconds up to which a claim is quick.
QUICK = 80.0
#: What each table ends with; also read by tests.
MADE = re.compile(r"^\*Made on (\d{4}-\d\d-\d\d) .*by `([^`]+)`.*\*$", re.MULTILINE)


# %% What of a command's results a page shows


def printed(out, said):
    """All that it printed."""
    return said


def as_text(out, said):
    """All that it printed, as it stands, but for where it wrote files."""
    lines = [line for line in said.splitlines() if not line.startswith("wrote ")]
    return "```text\n{}\n```".format("\n".join(lines).strip())


def listed(pattern):
    """Lines of what it printed that match a pattern, as a list."""

    def shown(out, said):
        return "\n".join(f"- {line}" for line in said.splitlines() if re.search(pattern, line))

    return shown


def lines(pattern):
    """Lines of what it printed that match a pattern, as they stand; "None." if none does."""

    def shown(out, said):
        found = [line for line in said.splitlines() if re.search(pattern, line)]
        text = "\n".join(f"\n{line}" if line.startswith("Seeds") else line for line in found)
        return text or "None."

    return shown


def section(file, *titles):
    """Sections of a page that it wrote."""

    def shown(out, said):
        parts = re.split(r"(?m)^## ", (out / file).read_text(encoding="utf-8"))[1:]
        sections = {part.partition("\n")[0]: part.partition("\n")[2].strip() for part in parts}
        return "\n\n".join(f"## {title}\n\n{sections[title]}" for title in titles)

    return shown


def whole(file):
    """A page that it wrote, without its title."""
    return lambda out, said: (out / file).read_text(encoding="utf-8").partition("\n\n")[2]


def items(*names):
    """Tables and notes of items of the reproduced paper, without links to files."""

    def shown(out, said):
        text = (out / "reproduction.md").read_text(encoding="utf-8")
        chosen = [part for part in re.split(r"(?m)^## ", text) if part.startswith(names)]
        blocks = "\n\n".join(f"## {part.strip()}" for part in chosen).split("\n\n")
        links = "![", "Curves: ", "For ParaView: ", "No files for ParaView"
        return "\n\n".join(block for block in blocks if not block.startswith(links))

    return shown


# %% What is claimed


class Claim(NamedTuple):
    """Figures of the site that one command gives.

    ``command`` starts below the folder of the repository, ``{out}`` in it is a folder for results.
    ``seconds`` is about what it takes on two cores; ``timed`` claims have run times in them.
    ``tables`` and ``pictures`` say what of the results is shown, by the names of the files beside
    this one. ``short`` is added to the command for its short form, or is that form as a whole.
    """

    command: str
    seconds: float
    tables: dict[str, Callable[[Path, str], str]]
    pictures: Mapping[str, str] = MappingProxyType({})
    short: str = "--quick"
    timed: bool = False


PAPER = {
    "paper": whole("summary.md"),
    "paper-joint": items("Fig. 2", "Fig. 3", "Fig. 4"),
    "paper-modes": items("Table 1", "Section 7.5"),
    "paper-active-length": items("Fig. 6", "Table 2"),
    "paper-case-I": items("Table 3", "Table 4"),
    "paper-cases": items("Table 5"),
    "paper-number-of-modes": items("Accuracy"),
    "paper-impulse": items("Fig. 10", "Section 7.2"),
    "paper-structure": items("Section 7.3"),
    "paper-structure-impulse": items("Section 7.4"),
}
#: Pictures of the reproduction that pages show.
SHOWN = ("fig2b", "fig4", "fig5", "fig6", "fig7", "fig8", "fig9", "fig10", "fig12", "fig13")
SHOWN += ("fig15_sensitivity", "fig16", "fig19", "fig21", "fig21_envelope", "fig22")
BENCHMARKS = "python examples/benchmarks"
STABILITY = "python examples/stability"
ESTIMATES = f"{BENCHMARKS}/estimates.py"
CLAIMS = {
    "paper": Claim(
        "python examples/paper/reproduce.py --out {out}",
        75,
        PAPER,
        {f"paper-{name}": f"pictures/{name}.png" for name in SHOWN},
        timed=True,  # section 7.5
    ),
    "two-plates": Claim(
        "python examples/two_plates.py",
        60,
        {"two-plates": as_text},
        {"two_plates": "two_plates.png"},
        short="",
    ),
    "brake-reuss": Claim("python examples/brake_reuss.py", 30, {"brake-reuss": as_text}, short=""),
    "brake-reuss-opening": Claim(
        f"{BENCHMARKS}/brake_reuss.py", 150, {"brake-reuss-opening": printed}, timed=True
    ),
    "stability": Claim(
        f"{STABILITY}/run.py --out {{out}}",
        150,
        {"stability": whole("stability.md")},
        {"stability": "stability.png"},
    ),
    "hostile": Claim(
        f"{STABILITY}/hostile.py --out {{out}}",
        300,
        {"hostile": listed("files: |At most")},
        short="--count 5",
    ),
    "mutated": Claim(
        f"{STABILITY}/mutated.py --count 200 --out {{out}}",
        120,
        {"mutated": listed("")},
        short="--count 6",
    ),
    "pairs": Claim(
        f"{STABILITY}/pairs.py", 1800, {"pairs": listed("amplitudes")}, short="--count 1"
    ),
    "estimates": Claim(
        f"{ESTIMATES} all --seed 2029 --count 40 --jobs 2",
        2300,
        {
            "estimates": lines(r"^\| |^Seeds "),
            "estimates-loads": lines(r"^- .*, by "),
            "estimates-cases": lines("^- (stated|refused)"),
        },
        short=f"{ESTIMATES} bars matrices --seed 3 --count 1",
    ),
    "estimates-opening": Claim(
        f"{ESTIMATES} laps-opening --seed 2029 --count 28 --jobs 2",
        900,
        {
            "estimates-opening": lines(r"^\| |^Seeds "),
            "estimates-opening-cases": lines("^- (stated|refused)"),
        },
        short=f"{ESTIMATES} laps-opening --seed 3 --count 1",
    ),
    "estimates-clock": Claim(
        f"{ESTIMATES} all --seed clock --count 8 --jobs 1",
        1600,
        {"estimates-clock": lines(r"^\| (class|---|plates-bolted|all) |^Seeds ")},
        short=f"{ESTIMATES} bars plates-bolted --seed clock --count 1",
    ),
    "estimates-mesh": Claim(
        f"{ESTIMATES} plates-side two-bodies plates bars --seed 7 --count 10 --model mesh",
        1200,
        {"estimates-mesh": lines(r"^\| |^Seeds ")},
        short=f"{ESTIMATES} bars --seed 7 --count 1 --model mesh",
    ),
    "estimates-accuracy": Claim(
        f"{ESTIMATES} plates-bolted --model accuracy --seed 2029 --count 20 --jobs 1",
        1300,
        {
            "estimates-accuracy": lines(r"^\| |^Seeds "),
            "estimates-missed": lines("^- (missed|refused)"),
        },
        short=f"{ESTIMATES} plates-bolted --seed 3 --count 1 --model accuracy",
    ),
    "reduction": Claim(
        f"{BENCHMARKS}/reduction.py", 240, {"reduction": printed}, short="bending", timed=True
    ),
    "error-time": Claim(
        f"{BENCHMARKS}/ready_made.py examples/lap_joint_reference.toml --out {{out}}",
        130,
        {
            "error-time": section(
                "error-time.md",
                "How well the reference is known",
                "Which model to use",
                "Speed ratios of this run",
            )
        },
        {"error_time": "error-time.png", "total_time": "total-time.png"},
        timed=True,
    ),
    "plates": Claim(f"{BENCHMARKS}/plates.py", 200, {"plates": printed}, timed=True),
    "first-run": Claim(
        f"{BENCHMARKS}/first_run.py --rounds 1",
        200,
        {"first-run": printed},
        short=f"{BENCHMARKS}/first_run.py --quick",
        timed=True,
    ),
    "growth": Claim(f"{BENCHMARKS}/growth.py", 100, {"growth": printed}, timed=True),
    "sweep": Claim(f"{BENCHMARKS}/sweep.py", 200, {"sweep": printed}, timed=True),
    "elements": Claim(
        f"{BENCHMARKS}/elements.py cantilever preload opens lap --out {{out}}",
        400,
        {"elements": printed},
        {"elements": "elements.png"},
        short=f"{BENCHMARKS}/elements.py cantilever --kind triangles quadrilaterals --out {{out}}",
        timed=True,
    ),
    "bricks": Claim(f"{BENCHMARKS}/bricks.py", 30, {"bricks": printed}),
    "condensed-points": Claim(
        f"{BENCHMARKS}/condensed_points.py lap side",
        500,
        {"condensed-points": printed},
        short=f"{BENCHMARKS}/condensed_points.py side --quick",
        timed=True,
    ),
    "decks": Claim(f"{BENCHMARKS}/decks.py", 60, {"decks": printed}),
    "solids": Claim(f"{BENCHMARKS}/solids.py", 260, {"solids": printed}, timed=True),
    "large": Claim(f"{BENCHMARKS}/large.py", 120, {"large": printed}, timed=True),
    "contact-points": Claim(
        f"{BENCHMARKS}/contact_points.py", 240, {"contact-points": printed}, timed=True
    ),
    "contact-point-steps": Claim(
        f"{BENCHMARKS}/contact_points.py steps --out {{out}}",
        900,
        {"contact-point-steps": printed},
        {"contact_points": "contact_points.png"},
        short="--to 104",
        timed=True,
    ),
    "ranges": Claim(
        f"{BENCHMARKS}/ranges.py --seed 79",
        1500,
        {"ranges": printed},
        short=f"{BENCHMARKS}/ranges.py --quick",
        timed=True,
    ),
    "steady": Claim(
        f"{BENCHMARKS}/steady.py backbones responses light published",
        600,
        {"steady": printed},
        timed=True,
    ),
    "steady-others": Claim(
        f"{BENCHMARKS}/steady.py sundials balances", 600, {"steady-others": printed}, timed=True
    ),
    "response": Claim(
        f"{BENCHMARKS}/response.py reduced --workers 2", 60, {"response": printed}, timed=True
    ),
    "response-condensed": Claim(
        f"{BENCHMARKS}/response.py condensed --workers 2",
        500,
        {"response-condensed": printed},
        short=f"{BENCHMARKS}/response.py condensed --quick",
        timed=True,
    ),
    "peaks": Claim(f"{BENCHMARKS}/peaks.py", 90, {"peaks": printed}),
    "nonlinear-beam": Claim(
        f"{BENCHMARKS}/nonlinear_modes.py beam", 10, {"nonlinear-beam": printed}, timed=True
    ),
    "nonlinear-estimates": Claim(
        f"{BENCHMARKS}/nonlinear_modes.py estimates",
        400,
        {"nonlinear-estimates": printed},
        short=f"{BENCHMARKS}/nonlinear_modes.py estimates 200 1",
    ),
    "nonlinear-bar": Claim(
        f"{BENCHMARKS}/nonlinear_modes.py bar", 60, {"nonlinear-bar": printed}, timed=True
    ),
    "nonlinear-lap": Claim(
        f"{BENCHMARKS}/nonlinear_modes.py lap",
        400,
        {"nonlinear-lap": printed},
        short=f"{BENCHMARKS}/nonlinear_modes.py beam",
        timed=True,
    ),
    "nonlinear-brake-reuss": Claim(
        f"{BENCHMARKS}/nonlinear_modes.py brake_reuss",
        200,
        {"nonlinear-brake-reuss": printed},
        short=f"{BENCHMARKS}/nonlinear_modes.py beam",
        timed=True,
    ),
    "responses-lap": Claim(
        f"{BENCHMARKS}/harmonic_response.py plates", 200, {"responses-lap": printed}, timed=True
    ),
    "responses-fold": Claim(
        f"{BENCHMARKS}/harmonic_response.py fold", 10, {"responses-fold": printed}
    ),
    "responses-random": Claim(
        f"{BENCHMARKS}/harmonic_response.py random --systems 40",
        300,
        {"responses-random": lines(r"^Of \d+ points")},
        timed=True,
    ),
    "random": Claim(f"{BENCHMARKS}/noise.py", 600, {"random": printed}, timed=True),
    "random-plate": Claim(f"{BENCHMARKS}/noise.py plate", 300, {"random-plate": printed}),
    "laws": Claim(f"{BENCHMARKS}/laws.py", 30, {"laws": printed}),
    "fit-gradients": Claim(
        f"{BENCHMARKS}/fits.py gradients", 300, {"fit-gradients": printed}, timed=True
    ),
    "fit-coverage": Claim(f"{BENCHMARKS}/fits.py coverage", 300, {"fit-coverage": printed}),
    "fit-solid": Claim(f"{BENCHMARKS}/fits.py solid", 200, {"fit-solid": printed}, timed=True),
    "measured-beam": Claim(
        "python examples/measured_beam.py", 800, {"measured-beam": as_text}, short="--short"
    ),
    "bowed-beam": Claim(
        f"{BENCHMARKS}/bowed_beam.py",
        500,
        {"bowed-beam": printed},
        {"bowed_beam": "bowed_beam.png"},
    ),
    "contact-block": Claim(f"{BENCHMARKS}/contact.py block", 10, {"contact-block": printed}),
    "contact-wall": Claim(f"{BENCHMARKS}/contact.py wall", 10, {"contact-wall": printed}),
    "contact-alike": Claim(f"{BENCHMARKS}/contact.py alike", 30, {"contact-alike": printed}),
    "contact-slider": Claim(f"{BENCHMARKS}/slider.py", 30, {"contact-slider": printed}),
    "contact-washer": Claim(f"{BENCHMARKS}/washer.py", 20, {"contact-washer": printed}),
    "contact-loops": Claim(
        f"{BENCHMARKS}/contact.py loops", 900, {"contact-loops": printed}, timed=True
    ),
    "calculix": Claim(f"{BENCHMARKS}/calculix.py 0.6 --workers 2", 2000, {"calculix": printed}),
    "contact-reduced": Claim(
        f"{BENCHMARKS}/contact.py reduced", 600, {"contact-reduced": printed}, timed=True
    ),
}


# %% How they are run


def is_busy():
    """Whether more ran in the last minute than there are cores for."""
    return hasattr(os, "getloadavg") and os.getloadavg()[0] > (os.cpu_count() or 1) + 0.5


def machine(busy):
    """Cores, processor, and versions of what computes."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "numba"))
    kind, python = platform.machine() or "unknown processor", platform.python_version()
    cores = f"{os.cpu_count()} {'busy ' * busy}cores"
    return f"{cores} ({kind}; Python {python}, {packages}; BLAS on one thread)"


def run(command, out, log):
    """Run a command in ``out``; returns what it printed and its time (s). It may fail."""
    words = [word.replace("{out}", str(out)) for word in command.split()]
    words = [str(ROOT / word) if word.startswith("examples/") else word for word in words]
    names = "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"
    begin = time.perf_counter()
    with (log / "stderr.txt").open("w", encoding="utf-8") as errors:
        done = subprocess.run(
            [sys.executable, *words[1:]],
            cwd=out,
            env=os.environ | dict.fromkeys(names, "1") | {"PYTHONIOENCODING": "utf-8"},
            stdout=subprocess.PIPE,
            stderr=errors,
            encoding="utf-8",
            check=False,
        )
    seconds = time.perf_counter() - begin
    (log / "stdout.txt").write_text(done.stdout, encoding="utf-8")
    if done.returncode:
        said = (log / "stderr.txt").read_text(encoding="utf-8").strip().splitlines()[-1:]
        raise RuntimeError(f"status {done.returncode}: {' '.join(said)}")
    return done.stdout, seconds


def copy_picture(source, target):
    """Copy a picture; with 256 colours if it is large."""
    from PIL import Image

    with Image.open(source) as picture, replacing(target) as temporary:
        plain = picture.convert("RGB")
        plain.save(temporary, "PNG", optimize=True)
        if temporary.stat().st_size > LARGEST:
            few = {"method": Image.Quantize.MAXCOVERAGE, "dither": Image.Dither.NONE}
            plain.quantize(256, **few).save(temporary, "PNG", optimize=True)


def measure(claim, command, folder, kept, busy):
    """Run a claim's command; write its tables and pictures below ``folder``. Returns seconds.

    ``busy`` tells whether the machine is.
    """
    out = kept / "files"
    if busy and claim.timed:
        print(
            "  the machine is busy: these run times are not those of an idle one", file=sys.stderr
        )
    out.mkdir(parents=True, exist_ok=True)
    said, seconds = run(command, out, kept)
    shown = command.replace("{out}", "out")
    made = f"*Made on {datetime.now(UTC):%Y-%m-%d} with version {__version__} by `{shown}` "
    made += f"in {seconds:.0f} s on {machine(busy)}.*"
    for name, table in claim.tables.items():
        with replacing(folder / "measured" / f"{name}.md") as temporary:
            temporary.write_text(f"{table(out, said).strip()}\n\n{made}\n", encoding="utf-8")
    for name, file in claim.pictures.items():
        copy_picture(out / file, folder / "pictures" / f"{name}.png")
    return seconds


def short_form(claim):
    """Command of a claim in its short form; of options that are repeated the last counts."""
    if claim.short.startswith("python"):
        return claim.short
    return f"{claim.command} {claim.short}".strip()


def listing(claims):
    """Text that says what would run, and how long it takes on two cores."""
    lines = []
    for name, claim in claims.items():
        kind = "times" if claim.timed else ""
        lines.append(
            f"{name:18} {claim.seconds:5.0f} s  {kind:6} {claim.command.format(out='out')}"
        )
    total = sum(claim.seconds for claim in claims.values())
    return "\n".join([*lines, f"about {total / 60:.0f} minutes in all"])


def main(arguments=None, claims=CLAIMS):
    """Make claims anew; returns 1 if a command failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(claims))
    parser.add_argument("--list", action="store_true", help="say what would run, and how long")
    parser.add_argument("--quick", action="store_true", help="only what takes a minute or so")
    parser.add_argument("--short", action="store_true", help="short forms; needs --out")
    parser.add_argument("--out", type=Path, default=HERE, help="for tables and pictures")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the results of the commands")
    options = parser.parse_args(arguments)
    if unknown := [name for name in options.names if name not in claims]:
        parser.error(f"no claim is called {', '.join(unknown)}; there are: {', '.join(claims)}")
    if options.short and options.out.resolve() == HERE:
        parser.error("--short writes no tables of the site: give --out DIR")
    chosen = {name: claims[name] for name in options.names or claims}
    if options.quick:
        chosen = {name: claim for name, claim in chosen.items() if claim.seconds <= QUICK}
    if options.list:
        print(listing(chosen))
        return 0
    failed = []
    for folder in ("measured", "pictures"):
        (options.out / folder).mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as temporary:
        for name, claim in chosen.items():
            command = short_form(claim) if options.short else claim.command
            print(f"{name}: {command.format(out='out')} (about {claim.seconds:.0f} s)", flush=True)
            kept = (options.keep or Path(temporary)).resolve() / name
            try:
                seconds = measure(claim, command, options.out.resolve(), kept, is_busy())
                print(f"{name}: made in {seconds:.0f} s", flush=True)
            except (RuntimeError, OSError, KeyError) as error:
                failed.append(name)
                print(f"{name}: {error}", file=sys.stderr, flush=True)
    if not options.short:
        with replacing(options.out / "measured" / "list.md") as temporary:
            temporary.write_text(f"```text\n{listing(claims)}\n```\n", encoding="utf-8")
    if failed:
        print(f"not made: {', '.join(failed)}", file=sys.stderr)
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
