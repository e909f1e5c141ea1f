"""Which cards of Abaqus and CalculiX files are read, passed over or refused, and why."""

from __future__ import annotations

from collections.abc import Iterable

from skfem_joint.ground.errors import listed
from skfem_joint.mesh.decks.cards import Card

#: Options of the cards that are read; others change what a card means.
READ = {
    "HEADING": set[str](),
    "NODE": {"NSET"},
    "ELEMENT": {"TYPE", "ELSET"},
    "NSET": {"NSET", "GENERATE", "UNSORTED", "INTERNAL", "INSTANCE", "ELSET"},
    "ELSET": {"ELSET", "GENERATE", "UNSORTED", "INTERNAL", "INSTANCE"},
    "SURFACE": {"NAME", "TYPE", "INTERNAL"},
    "PART": {"NAME"},
    "END PART": set[str](),
    "INSTANCE": {"NAME", "PART"},
    "END INSTANCE": set[str](),
    "ASSEMBLY": {"NAME"},
    "END ASSEMBLY": set[str](),
}
#: Cards that are passed over, by what they are about; after the colon, who says it instead.
PASSED = {
    "materials, which [material] says": """
        MATERIAL, ELASTIC, DENSITY, PLASTIC, EXPANSION, CONDUCTIVITY, SPECIFIC HEAT, DAMPING, CREEP,
        CYCLIC HARDENING, DEFORMATION PLASTICITY, DEPVAR, HYPERELASTIC, HYPERFOAM, USER MATERIAL,
        ELECTRICAL CONDUCTIVITY, MAGNETIC PERMEABILITY, SPECIFIC GAS CONSTANT, FLUID CONSTANTS,
        LATENT HEAT, RATE DEPENDENT, POTENTIAL, VISCOELASTIC, VISCOUS, ANNEAL TEMPERATURE,
        DAMAGE INITIATION, DAMAGE EVOLUTION, PHYSICAL CONSTANTS, VALUES AT INFINITY,
        USER OUTPUT VARIABLES
    """,
    "sections, which [section] says": """
        SOLID SECTION, BEAM SECTION, BEAM GENERAL SECTION, ORIENTATION, DISTRIBUTION,
        DISTRIBUTION TABLE, SECTION CONTROLS,
        TRANSVERSE SHEAR, TRANSVERSE SHEAR STIFFNESS, HOURGLASS STIFFNESS
    """,
    "contact and friction, which [[joint]] says": """
        SURFACE INTERACTION, SURFACE BEHAVIOR, FRICTION, CHANGE FRICTION, CONTACT PAIR, CONTACT,
        CONTACT INCLUSIONS, CONTACT EXCLUSIONS, CONTACT PROPERTY ASSIGNMENT, CONTACT FORMULATION,
        CONTACT INITIALIZATION ASSIGNMENT, CONTACT INITIALIZATION DATA, CONTACT INTERFERENCE,
        CONTACT CONTROLS, CONTACT CONTROLS ASSIGNMENT, CONTACT DAMPING, CONTACT STABILIZATION,
        CONTACT CLEARANCE, CONTACT CLEARANCE ASSIGNMENT, SURFACE PROPERTY ASSIGNMENT, CLEARANCE,
        GAP CONDUCTANCE, GAP HEAT GENERATION
    """,
    "supports, loads and states at the start, which [support], [[load]] and [[bolt]] say": """
        BOUNDARY, CLOAD, DLOAD, DSLOAD, AMPLITUDE, INITIAL CONDITIONS, TEMPERATURE, TIME POINTS,
        BASE MOTION, FILM, RADIATE, SFILM, SRADIATE
    """,
    "output and settings of the program": """
        PREPRINT, RESTART, FILTER, NODE FILE, EL FILE, NODE PRINT, EL PRINT, NODE OUTPUT,
        ELEMENT OUTPUT, ENERGY OUTPUT, CONTACT OUTPUT, OUTPUT, CONTACT FILE, CONTACT PRINT, PRINT,
        SECTION PRINT, FILE FORMAT, MONITOR
    """,
}
#: Letters that an abbreviated option has at least.
_SHORTEST = 3
#: What to do about cards that are refused.
_JOINED = (
    "it joins parts of the model, which is not read: join the bodies in the mesh, by shared nodes, "
    "or say a joint that sticks as [[joint]], and take the card out"
)
_STIFF = (
    "it makes parts of the model rigid or moves them by one node, which is not read: hold or load "
    "the surface itself in [support] or [[load]], and take the card out"
)
_BOLT = (
    "it stretches a bolt, which is not read: say it as [[bolt]], with head and nut, the surfaces "
    "under them, and force, N; leave out the shank or the cut in it"
)
_THIN = "shells and membranes are not read: mesh the body as a solid"
_MADE = "it makes nodes or elements: save the file with all of them written out"
_TURNED = "it gives coordinates or directions in another system: save the file without it"
_CHANGED = "it takes elements out or puts them in: save the file with those that count"
_MASS = "it adds springs or masses to nodes, which is not read: take it and its elements out"
REFUSED = {
    **dict.fromkeys(
        ("TIE", "MPC", "EQUATION", "NETWORK MPC", "FASTENER", "EMBEDDED ELEMENT"), _JOINED
    ),
    **dict.fromkeys(("CYCLIC SYMMETRY MODEL", "SHELL TO SOLID COUPLING"), _JOINED),
    **dict.fromkeys(("COUPLING", "KINEMATIC", "DISTRIBUTING", "RIGID BODY"), _STIFF),
    **dict.fromkeys(("KINEMATIC COUPLING", "DISTRIBUTING COUPLING"), _STIFF),
    **dict.fromkeys(("SHELL SECTION", "SHELL GENERAL SECTION", "MEMBRANE SECTION"), _THIN),
    "PRE-TENSION SECTION": _BOLT,
    **dict.fromkeys(("SYSTEM", "TRANSFORM"), _TURNED),
    **dict.fromkeys(("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY"), _MADE),
    "MODEL CHANGE": _CHANGED,
    "IMPERFECTION": "it moves nodes: save the file with the nodes where they are to be",
    "PARAMETER": "it gives names to numbers: save the file with the numbers themselves",
    **dict.fromkeys(("MASS", "ROTARY INERTIA", "NONSTRUCTURAL MASS"), _MASS),
    **dict.fromkeys(("SPRING", "DASHPOT", "GAP", "CONNECTOR SECTION"), _MASS),
}


def _plain(keyword: str) -> str:
    """Keyword without blanks, which do not distinguish cards."""
    return keyword.replace(" ", "")


_READ = {_plain(keyword): keyword for keyword in READ}
_PASSED = {
    _plain(keyword): (keyword.strip(), why)
    for why, text in PASSED.items()
    for keyword in " ".join(text.split()).split(",")
}
_REFUSED = {_plain(keyword): why for keyword, why in REFUSED.items()}


def sorted_out(cards: Iterable[Card]) -> tuple[list[tuple[str, Card]], list[str]]:
    """Cards that are read, with their keywords, and notes on those that are passed over.

    Steps are passed over as a whole. ValueError for a card that is refused or not known, and for a
    step that does not end.
    """
    read, passed = list[tuple[str, Card]](), dict[str, dict[str, None]]()
    materials, adjusted = dict[str, None](), list[str]()
    step: Card | None = None
    for card in cards:
        plain = _plain(card.keyword)
        if plain in _REFUSED:
            card.refuse(_REFUSED[plain])
        if plain == "STEP" or step is not None:
            if plain == "STEP" and step is not None:
                card.refuse(f"the step of line {step.line} has not ended: write *END STEP before")
            if plain in ("STEP", "ENDSTEP"):
                step = card if plain == "STEP" else None
            passed.setdefault("steps, which the tables of the scene say", {})[card.keyword] = None
        elif plain in _READ:
            keyword = _READ[plain]
            _spell_out(card, READ[keyword])
            if unknown := [option for option in card.options if option not in READ[keyword]]:
                own = ", ".join(sorted(READ[keyword])) or "none"
                card.refuse(
                    f"option {unknown[0][:40]!r} is not read, allowed are, each once: {own}; save "
                    "the file without it (a line that ends with a comma goes on in the next)"
                )
            read.append((keyword, card))
        elif plain in _PASSED:
            keyword, why = _PASSED[plain]
            passed.setdefault(why, {})[keyword] = None
            if keyword == "MATERIAL" and "NAME" in card.options:
                materials[card.name("NAME")] = None
            if keyword == "CONTACT PAIR" and any(o.startswith("ADJ") for o in card.options):
                adjusted.append(str(card.line))
        else:
            card.refuse(
                "a card that is not known: is it spelt right? Take it out if it changes neither "
                "mesh nor stiffness nor mass"
            )
    if step is not None:
        step.refuse("has no *END STEP: the file is cut")
    groups = [f"{why} ({', '.join(f'*{name}' for name in own)})" for why, own in passed.items()]
    notes = [f"passed over are {'; '.join(groups)}"] if groups else []
    if adjusted:
        notes.append(
            "ADJUST of *CONTACT PAIR, which moves nodes onto the other surface before the first "
            f"step, is not done (line {', '.join(adjusted)}): nodes stay where the file has them, "
            "and gaps are those of the mesh. Save the file with the nodes where they are to be"
        )
    if len(materials) > 1:
        notes.append(
            f"it has {len(materials)} materials, {listed(materials)}: [material] holds for all "
            "elements but those of the regions that [material.regions.NAME] names"
        )
    return read, notes


def _spell_out(card: Card, allowed: set[str]) -> None:
    """Write abbreviated options of a card in full, where one option alone begins so."""
    for option in [option for option in card.options if option not in allowed]:
        whole = [name for name in allowed if name.startswith(option)]
        if len(option) >= _SHORTEST and len(whole) == 1 and whole[0] not in card.options:
            card.options[whole[0]] = card.options.pop(option)
