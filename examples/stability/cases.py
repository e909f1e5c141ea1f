"""The matrix of stiff and extreme cases: bars, then plates."""

from functools import partial
from math import inf, pi
from typing import Any

from stability.problem import TWO, UNITS, Case, vary

#: Easy cases.
BAR = Case()
PLATE = Case(bodies="base", elements=(8, 2), direction="oblique", steps=50, periods=1)
bar, plate = partial(vary, base=BAR), partial(vary, base=PLATE)
#: Laws of bars, and steps per period; those that the explicit method needs up to beta = 1e3.
BETAS = [*(10.0**k for k in range(2, 13)), inf]
STEPS, MANY = [10, 30, 100, 300, 1000, 10_000], 60_000
#: Spectral radii of the scheme, for bars and for plates.
RADII, PLATE_RADII, ENDS = [0.0, 0.5, 0.8, 1.0], [0.0, 0.5, 1.0], [0.0, 1.0]
#: Gentle, usual and stiffest laws.
FEW, STIFF, PAIR, CORNER = [1e2, 1e5, 1e12, inf], [1e2, 1e5, 1e12], [1e5, inf], [1e2, 1e12, inf]
PLATE_BETAS, FEW_PLATE, LAST = [1e3, 1e5, 1e7, 1e9, inf], [1e3, 1e5, 1e9, inf], [1e9, inf]
FAR, FORCES, FLAT, JUMP = [1e-6, 1e6], [1e-12, 1e12], [0.01, 100.0], [0.5 * pi]
PULSES = ["triangle", "half sine", "versine", "rectangle", "ramp"]
REDUCED, OTHER_UNITS, KINDS = ["reduced", "hyper-reduced"], [*UNITS][1:], ["triangle", BAR.kind]
#: Cases of bars and of plates on each axis of a quick matrix.
QUICK_BARS, QUICK_PLATES = 3, 1


def _schemes() -> list[Case]:
    """Every scheme and model over beta and steps per period."""
    small: Any = {"elements": (20,), "periods": 2}
    explicit: Any = {"elements": (20,), "periods": 1, "solver": "explicit"}
    cases = [
        *bar("scheme", **small, rho=RADII, beta=BETAS, steps=STEPS),
        *bar("explicit", **explicit, beta=BETAS[:-1], steps=STEPS),
        *bar("explicit", **explicit, beta=BETAS[:2], steps=[MANY]),
        *bar("explicit", **explicit, must_refuse=True, beta=[inf], steps=STEPS),
    ]
    for model in REDUCED:
        few: Any = {**small, "model": model, "modes": 5}
        cases += bar(model, **few, beta=BETAS[:-1], steps=STEPS[:5])
        cases += bar(model, **few, must_refuse=True, beta=[inf], steps=STEPS[:5])
    return cases


def _bars() -> list[Case]:
    """One thing at a time, to its ends."""
    linear: Any = {"friction": 0.0, "force": 1e3}
    ringing: Any = {"damping": 0.0, "frequency": 5000.0, "periods": 10}
    slow: Any = {"elements": (100,), "frequency": 0.1, "periods": 2, "steps": 400}
    long: Any = {"elements": (4,), "steps": 10, "periods": 100_000, "beta": inf}
    times = [0.01, 0.3, 0.9, 3.0, 10.0, 50.0]
    counts = [(n,) for n in (1, 2, 3, 10, 100, 800, 5000, 20_000)]
    on: Any = {"axis": "switched on", "elements": (20,)}
    # From micrometres to kilometres; the frequency keeps its share of the resonance.
    sizes = [
        case
        for size in (1e-6, 1e-3, 1e3)
        for case in bar(
            "size", length=[size], frequency=250.0 / size, damping=4e-5 * size, beta=FEW
        )
    ]
    return [
        *bar("frequency", frequency=[0.1, 1.0, 10.0, 1e2, 1e4, 5e4], beta=PAIR, rho=ENDS),
        *bar("slow", **slow, share=[0.1, 0.5, 0.9, 1.0], beta=[1e12, inf], rho=ENDS),
        *bar("load", share=[0.01, 0.1, 0.5, 0.99, 0.999, 1.0, 1.2], beta=FEW),
        *bar("elements", periods=1, elements=counts, beta=FEW),
        *bar("grading", grading=[10.0, 1e2, 1e3, 1e4], beta=FEW),
        *bar("damping", damping=[0.0, 1e-7, 1e-4, 1e-3], beta=FEW),
        *bar("pressure", pressed=["one node", "halves", "alternating"], beta=FEW),
        *bar("no friction", force=1e3, friction=[0.0], rho=RADII),
        *bar("no friction", force=1e3, pressure=[0.0], rho=RADII),
        *bar("stiffness jump", stiffness_ratio=FAR, beta=FEW),
        *bar("density jump", density_ratio=FAR, beta=FEW),
        *bar("pulse", periods=2, load=PULSES, duration=times, beta=PAIR),
        *bar("no load", force=[0.0], beta=FEW, rho=ENDS),
        *bar(**on, phase=JUMP, steps=[30, 100, 1000], rho=RADII),
        *bar(**on, phase=JUMP, frequency=[0.1, 5e4], rho=RADII),
        *bar(**on, phase=JUMP, share=[0.1, 0.3, 0.5], steps=[56, 200, 1000], beta=FEW),
        *bar(**on, load=["rectangle"], duration=[1000.0], steps=[30, 100, 1000], rho=RADII),
        *bar("force", force=FORCES, beta=FEW),
        *bar("force", pressure=[1e-10, 1e14], beta=FEW),
        *sizes,
        *bar("units", units=OTHER_UNITS, beta=PAIR, rho=ENDS),
        *bar("units", elements=(400,), units=OTHER_UNITS, beta=PAIR),
        *bar("resonance", **ringing, **linear, steps=[100, 1000], elements=[(1,), (40,)]),
        *bar("resonance", **ringing, steps=200, share=[0.5, 1.2], beta=FEW),
        *bar("drift", **long, share=[0.9, 1.2]),
        *bar("steps", steps=[1, 2, 4, 8], beta=PAIR, rho=ENDS),
    ]


def _models() -> list[Case]:
    """Explicit steps around the stable one; modes of all numbers and scales; the corners."""
    small: Any = {"elements": (20,), "periods": 2}
    tiny: Any = {"elements": (5,), "periods": 1, "solver": "explicit", "frequency": 5000.0}
    damping: Any = {"damping": [0.0, 1e-5]}
    few: Any = {**small, "model": "reduced", "modes": 5, "beta": STIFF}
    counts, share = [1, 2, 3, 5, 10, None], [0.01, 0.999, 1.2]
    ends: Any = {"rho": ENDS, "damping": [0.0, 1e-3]}
    uneven: Any = {"grading": 1e4, "pressed": "alternating", "beta": CORNER}
    long: Any = {"elements": (2000,), "periods": 1, "grading": [1e4], "beta": [1e12, inf]}
    speck: Any = {"length": 1e-6, "frequency": 2.5e8, "damping": 0.0}
    return [
        *bar("explicit step", **tiny, step_factor=[0.5, 0.99], beta=[1e2, 3e2], **damping),
        *bar(
            "explicit step",
            **tiny,
            must_refuse=True,
            step_factor=[1.01, 2.0],
            beta=[1e2, 3e2, 1e5],
            **damping,
        ),
        *bar("modes", **small, model=REDUCED[:1], modes=counts, beta=STIFF),
        *bar("modes", **small, model=REDUCED[1:], modes=counts, beta=STIFF),
        *bar("mode scales", mode_scales=[3.0, 6.0, 12.0], **few),
        *bar("dependent modes", dependent=["raw", "dropped"], **few),
        *bar("corner", elements=(20,), beta=CORNER, frequency=[0.1, 5e4], share=share, **ends),
        *bar("corner", **uneven, stiffness_ratio=FAR, steps=[10, 1000], rho=ENDS),
        *bar("corner", **long, steps=[10, 100], rho=ENDS),
        *bar("corner", **speck, force=FORCES, beta=FEW),
    ]


def _plates() -> list[Case]:
    """The schemes, then one thing at a time, to its ends."""
    linear: Any = {"friction": 0.0, "force": 1e3}
    flat: Any = {"poisson": 0.0, "direction": "along", "rho": 1.0}
    step: Any = {"load": ["rectangle"], "duration": 1000.0, "steps": 200}
    return [
        *plate("plate scheme", rho=PLATE_RADII, beta=PLATE_BETAS, steps=[10, 30, 100]),
        *plate("plate scheme", rho=[1.0], beta=PLATE_BETAS, steps=[300]),
        *plate("plate load", share=[1e-6, 0.5, 1.0, 2.0], beta=FEW_PLATE),
        *plate("plate load", direction=["along", "across"], share=[0.9, 2.0], beta=PAIR),
        *plate("plate pressure", pressure=[1.0, 1e12], beta=PAIR),
        *plate("plate pressure", pressure=[1.0, 1e12], force=[1e3], beta=PAIR),
        *plate("plate pressure", pressed=["one node", "alternating"], beta=PAIR),
        *plate("plate frequency", frequency=[0.1, 1e2, 1e4, 1e6], beta=PAIR, rho=ENDS),
        *plate("plate steps", steps=[2, 4], beta=PAIR, must_refuse=[True]),
        *plate("plate steps", steps=[10, 500], periods=[2], beta=PAIR),
        *plate("plate damping", damping=[0.0, 1e-3], beta=FEW_PLATE),
        *plate("plate Poisson", poisson=[0.0, 0.49], beta=PAIR),
        *plate("plate Poisson", plane="strain", poisson=[0.3, 0.499], beta=PAIR),
        *plate("plate Poisson", must_refuse=True, poisson=[0.5], plane=["strain"]),
        *plate("plate elements", kind=KINDS, order=[1, 2], beta=PAIR),
        *plate("plate elements", elements=(16, 4), part=[0.5, 1.0], beta=FEW_PLATE),
        *plate("plate aspect", aspect=FLAT, kind=KINDS, beta=PAIR),
        *plate("plate aspect", aspect=FLAT, order=[2], beta=PAIR),
        *plate("plate material", stiffness=FAR, beta=PAIR),
        *plate("plate material", density=FAR, beta=PAIR),
        *plate("plate no friction", **linear, rho=PLATE_RADII),
        *plate("plate no friction", **linear, damping=[0.0], direction=["along", "across"]),
        *plate("plate one joint", second_friction=[0.0], beta=FEW_PLATE),
        *plate("plate one joint", second_friction=[0.0], share=[2.0], beta=PAIR),
        *plate("plate switched on", phase=JUMP, steps=[50, 200], beta=PAIR, rho=ENDS),
        *plate("plate switched on", phase=JUMP, share=[0.1, 0.3, 0.5], steps=[100], beta=PAIR),
        *plate("plate switched on", **step, damping=[0.0, 1e-5], beta=PAIR),
        *plate("plate pulse", load=["triangle", "rectangle"], duration=[0.3, 10.0], beta=PAIR),
        *plate("plate turned", turned=[37.0, 90.0], beta=FEW_PLATE),
        *plate("plate units", units=OTHER_UNITS, beta=PAIR),
        *plate("plate as bar", **flat, beta=FEW_PLATE, share=[0.9, 1.2]),
    ]


def _bodies() -> list[Case]:
    """Two plates, plates that friction alone holds, reduced plates, and the corners."""
    two = [*TWO]
    loose: Any = {"axis": "held by friction", "held": False}
    corner: Any = {"axis": "plate corner", "damping": 0.0}
    thin: Any = {**corner, "bodies": "lap of other nodes", "stiffness_ratio": 1e-6}
    large: Any = {**corner, "held": False, "elements": (16, 4), "steps": 100}
    cases = [
        *plate("plate bodies", bodies=["edge", *TWO], beta=FEW_PLATE),
        *plate("plate bodies", bodies=two, direction=["across"], beta=PAIR),
        *plate("plate bodies", bodies=two, share=[2.0], rho=[0.5], beta=PAIR),
        *plate("plate bodies", order=2, bodies=two, beta=[inf]),
        *plate("soft and stiff", bodies=two, stiffness_ratio=FAR, beta=PAIR),
        *plate("light and heavy", bodies=["lap"], density_ratio=FAR, beta=PAIR),
        *plate(**loose, share=[1e-6, 0.9, 2.0], beta=FEW_PLATE),
        *plate(**loose, direction=["across"], share=[0.5, 2.0], beta=PAIR),
        *plate(**loose, steps=200, phase=JUMP, share=[0.5, 2.0], beta=PAIR),
        *plate(**loose, friction=0.0, force=1e3, must_refuse=True, beta=PAIR),
        *plate(**loose, must_refuse=True, bodies=two),
    ]
    for model in REDUCED:
        few: Any = {"axis": "plate modes", "periods": 2, "modes": 6, "model": [model]}
        cases += plate(**few, beta=[1e3, 1e5, 1e9, 1e12])
        cases += plate(**few, bodies="lap", beta=[1e3, 1e9])
        cases += plate(**few, must_refuse=True, beta=[inf])
    both, fast = ["all", "alternating"], [0.1, 1e5]
    return [
        *cases,
        *plate("plate modes", periods=2, model=REDUCED[:1], modes=[1, 2, None], beta=[1e5, 1e9]),
        *plate(**corner, poisson=0.49, aspect=FLAT, share=[0.999, 2.0], rho=ENDS, beta=LAST),
        *plate(**thin, frequency=fast, pressed=both, beta=LAST),
        *plate(**large, pressed=["alternating"], frequency=fast, beta=LAST),
    ]


def matrix() -> list[Case]:
    """All cases."""
    return [*_schemes(), *_bars(), *_models(), *_plates(), *_bodies()]


def quick_matrix() -> list[Case]:
    """A few cases of each axis, for a look and for tests."""
    few: dict[str, list[Case]] = {}
    for case in matrix():
        if case.steps * case.periods <= 1000 and case.elements[0] <= 1000:
            few.setdefault(case.axis, []).append(case)

    def stride(cases: list[Case]) -> int:
        return max(1, (len(cases) - 1) // (QUICK_PLATES if cases[0].is_plate else QUICK_BARS))

    return [case for cases in few.values() for case in cases[:: stride(cases)]]
