"""Draw architecture.svg: `python docs/contributing/draw_architecture.py`."""

from html import escape
from pathlib import Path

WIDTH, HEIGHT = 1000, 955
INK, PALE = "#22303c", "#5b6873"
FILL = {"pass": "#e8eef5", "system": "#fdf0d5", "map": "#ffffff", "folder": "#eef2ea"}

#: Passes of a scene: name, what it returns, folder.
PASSES = (
    ("read", "Scene", "scene"),
    ("structure", "Structure", "structure"),
    ("system", "System", "structure"),
    ("describe", "Description", "study"),
    ("choose", "Choice", "study"),
    ("models", "Run", "runs"),
    ("estimate", "Estimate", "accuracy"),
    ("summarise", "summary", "output"),
    ("write", "files", "output"),
)
#: Folders in the order in which they may be imported, with what is in them.
FOLDERS = (
    ("ground", "errors, files, arrays, loads, progress"),
    ("matrix_files", "K and M of other programs"),
    ("linalg", "factors, Schur complements, bands"),
    ("system", "System, Contact, slips, modes"),
    ("mesh", "named meshes: read, check, build"),
    ("body", "mass, stiffness, stress"),
    ("joint", "pressure, preload, slip rows, limits"),
    ("structure", "Structure, MatrixModel, loads"),
    ("minimise", "law of friction, step problem"),
    ("stepping", "schemes, time loop, energy"),
    ("slow", "quasi-static levels, their derivatives"),
    ("steady", "the state that a period brings back"),
    ("runs", "integrate, quasi_static"),
    ("reduction", "POD, static path, condensation"),
    ("scene", "tables of a scene, messages"),
    ("results", "slip, stress, active region, modes"),
    ("accuracy", "estimated errors: a ladder of models"),
    ("vibration", "backbone, ring-down, response"),
    ("harmonic", "nonlinear modes"),
    ("fitting", "measured curves, fit"),
    ("study", "models of a scene, sweeps"),
    ("output", "tables, VTK, pictures, preview"),
    ("cli", "commands"),
)


def box(x: float, y: float, wide: float, tall: float, kind: str) -> str:
    """Rectangle of a kind."""
    return (
        f'<rect x="{x}" y="{y}" width="{wide}" height="{tall}" rx="6" fill="{FILL[kind]}" '
        f'stroke="{INK}" stroke-width="1.2"/>'
    )


def text(x: float, y: float, words: str, size: float = 14, colour: str = INK, **more: str) -> str:
    """Line of text around a place."""
    style = {"text-anchor": "middle"} | {k.replace("_", "-"): v for k, v in more.items()}
    given = " ".join(f'{key}="{value}"' for key, value in style.items())
    return (
        f'<text x="{x}" y="{y}" font-size="{size}" fill="{colour}" {given}>{escape(words)}</text>'
    )


def code(x: float, y: float, words: str, size: float = 12, **more: str) -> str:
    """Line of code around a place."""
    return text(x, y, words, size, PALE, font_family="monospace", **more)


def arrow(path: str) -> str:
    """Line with a tip along a path."""
    return (
        f'<path d="{path}" fill="none" stroke="{INK}" stroke-width="1.6" marker-end="url(#tip)"/>'
    )


def heading(y: float, words: str) -> str:
    """Heading of a part of the picture."""
    return text(20, y, words, 16, font_weight="bold", text_anchor="start")


def passes() -> list[str]:
    """Draw the way of a scene, from the left to the right."""
    parts = [heading(32, "The way of a scene: each pass takes results and returns one")]
    wide, gap = 92, 16.5
    for number, (name, result, folder) in enumerate(PASSES):
        x = 20 + number * (wide + gap)
        middle = x + wide / 2
        parts += [box(x, 52, wide, 62, "pass"), text(middle, 74, name, 14, font_weight="bold")]
        parts += [text(middle, 92, result, 12), code(middle, 107, folder, 11)]
        if number:
            parts.append(arrow(f"M{x - gap} 83 H{x - 3}"))
    return parts


def system() -> list[str]:
    """Draw the one type of all models, what makes it, maps it and takes it."""
    parts = [heading(164, "One type for all models: maps take a System and return a System")]
    sources = (
        ("mesh with names", "Structure(...).system(loads)"),
        ("own scikit-fem basis", "contact(basis, ...)"),
        ("M, K of another program", "System.from_matrices"),
    )
    for number, (name, call) in enumerate(sources):
        y = 186 + 62 * number
        parts += [box(20, y, 228, 50, "map"), text(134, y + 20, name), code(134, y + 38, call)]
        parts.append(arrow(f"M248 {y + 25} C285 {y + 25} 285 273 317 273"))
    parts += [
        box(320, 232, 360, 82, "system"),
        text(500, 256, "System", 17, font_weight="bold"),
        text(500, 280, "M a + C v + K u + Bᵀ (w ∘ σ(B v)) = f(t)", 15),
        text(500, 301, "full, condensed and reduced", 12, PALE),
        arrow("M410 232 C410 172 590 172 590 229"),
        box(352, 176, 296, 26, "map"),
        code(500, 194, "reduce · condense · project"),
        arrow("M680 273 H727"),
    ]
    takers = (
        ("motion over time", "integrate → Run"),
        ("damping curves", "backbone, ring_down"),
        ("steady vibration", "response"),
    )
    for number, (name, call) in enumerate(takers):
        y = 186 + 62 * number
        parts += [box(730, y, 250, 50, "map"), text(855, y + 20, name), code(855, y + 38, call)]
    parts += [
        box(320, 332, 360, 46, "map"),
        text(500, 351, "each step: one convex minimisation"),
        code(500, 369, "½ vᵀHv − gᵀv + Σ w ψ(|Bv|)", 12),
    ]
    return parts


def folders() -> list[str]:
    """Draw the folders: a module imports from its own and from those before it."""
    parts = [heading(428, "Folders: a module imports from its own and from those before it")]
    wide, tall, columns = 224, 62, 4
    for number, (name, words) in enumerate(FOLDERS):
        row, column = divmod(number, columns)
        x, y = 20 + column * (wide + 21.5), 450 + row * 84
        parts += [box(x, y, wide, tall, "folder")]
        parts += [text(x + wide / 2, y + 26, name, 15, font_weight="bold")]
        parts += [text(x + wide / 2, y + 47, words, 11.5, PALE)]
        if column:
            parts.append(arrow(f"M{x - 21.5} {y + tall / 2} H{x - 3}"))
        elif row:
            turn = y - 11
            end = 20 + 3 * (wide + 21.5) + wide / 2
            parts.append(arrow(f"M{end} {y - 22} V{turn} H{x + wide / 2} V{y - 3}"))
    return parts


def picture() -> str:
    """Text of the picture."""
    tip = (
        '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" '
        f'markerHeight="7" orient="auto"><path d="M0 0 L10 5 L0 10 z" fill="{INK}"/></marker>'
        "</defs>"
    )
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        'font-family="Helvetica, Arial, DejaVu Sans, sans-serif">',
        tip,
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
        *passes(),
        *system(),
        *folders(),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    Path(__file__).with_name("architecture.svg").write_text(picture(), encoding="utf-8")
