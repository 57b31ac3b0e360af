"""Default coats of the three types of eye that ocularists tell apart: smeared, dit-dot and detail
[L03 Sections 2.3, 3.2, Fig. 10].

A rule and a seed, no eye's copy: back and forth between stroma, collarette, limbus and sphincter,
crisp coats between cloudy ones, each round from shadows to lights.
"""

import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from irisjax.numerics.checks import check_known, check_whole

EYE_TYPES = ("smeared", "dit-dot", "detail")
"""Types of eye, from the least to the most detail."""
HEIGHT_STEP = 0.006
"""Height of a coat above the one before it, mm."""
_SEEDS = 2**31


class CoatRecipe(NamedTuple):
    """A coat of paint as a recipe has it, all plain data.

    Attributes:
        component: Name of the component, for `irisjax.ocularist.components.component`.
        parameters: Its parameters.
        first, second: Names of two paints.
        share: Share of the second paint in their mixture, 0 to 1.
        opacity: Factor on the component's map, 0 to 1.
        seed: Seed of the key that draws the map.
        height: Height above the base, mm.
    """

    component: str
    parameters: Mapping[str, Any]
    first: str
    second: str
    share: float
    opacity: float
    seed: int
    height: float


def coats(kind: str, colour: str, *, seed: int) -> tuple[CoatRecipe, ...]:
    """Default coats of a type and colour of eye, the bottom one, the opaque base, first.

    12 coats for a brown eye and 50 for a blue one, as in the paper's figure, and 30 for a green
    one. Equal seeds give equal coats.

    Raises:
        ValueError: For an unknown type or colour, or a seed that is negative or not whole.
    """
    check_known("type of eye", kind, EYE_TYPES)
    check_known("colour of eye", colour, EYE_COLOURS)
    check_whole("seed", seed, 0)
    rng = np.random.default_rng([seed, EYE_TYPES.index(kind), EYE_COLOURS.index(colour)])
    paints = _PAINTS[colour]
    rounds = paints["count"] - 1 - len(_CLOSING)
    parts = [_ROUND[i % len(_ROUND)] for i in range(rounds)] + list(_CLOSING)
    thin = (12 / paints["count"]) ** 0.35  # the more coats, the thinner each
    one, other, share = paints["base"][0]
    out = [CoatRecipe("base", {}, one, other, share, 1.0, int(rng.integers(_SEEDS)), 0.0)]
    for i, part in enumerate(parts):
        # Each round from shadows to lights, the later ones lighter: there are shadows at any depth.
        step = 2 if i >= rounds else (i % len(_ROUND)) // 2 % 3
        lit = 0.5 * i / len(parts) + 0.25 * step + rng.uniform(-0.1, 0.1)
        tone = "dark" if lit < 0.35 else "middle" if lit < 0.65 else "light"
        name, parameters, use, opacity = _coat(rng, kind, part, tone)
        mixtures = paints[use]
        one, other, share, strength = [*mixtures[(i // len(_ROUND) + i) % len(mixtures)], 1.0][:4]
        opacity *= strength * (thin if i < rounds else thin**0.5)
        seed, height = int(rng.integers(_SEEDS)), round((i + 1) * HEIGHT_STEP, 6)
        out.append(CoatRecipe(name, parameters, one, other, share, round(opacity, 3), seed, height))
    return tuple(out)


# By colour: the number of coats, and by their use mixtures of two paints (first, second, share of
# the second and, unless it is 1, a factor on the opacity of coats of it).
_PAINTS: dict[str, dict[str, Any]] = tomllib.loads(
    (resources.files("irisjax.ocularist") / "tables" / "palettes.toml").read_text("utf-8")
)
EYE_COLOURS = tuple(_PAINTS)
"""Colours of eye."""

_ROUND = "cloud", "stroma", "collarette", "stroma", "limbus", "stroma", "sphincter", "dots"
_CLOSING = ("collarette", "gaps", "stroma", "cloud", "sphincter", "limbus", "pupil")

_SOFT = {"smeared": 4.5, "dit-dot": 1.2, "detail": 0.9}  # brushes, relative to the usual one
# Shares of a stroma's coats that are dots, and of those that are smeared.
_DOTTED = {"smeared": (0.1, 1.0), "dit-dot": (0.75, 0.45), "detail": (0.15, 1.0)}


def _coat(rng, kind: str, part: str, tone: str):
    """Name and parameters of a component for a part of the iris, its mixtures' use, its opacity."""

    def about(value: float, spread: float = 0.25) -> float:
        return round(float(value * np.exp(rng.uniform(-spread, spread))), 4)

    def drawn(count: float | None = None, **medians: float) -> dict[str, Any]:
        number = {} if count is None else {"count": int(about(count))}
        return number | {name: about(median) for name, median in medians.items()}

    soft, (dotted, smeared) = _SOFT[kind], _DOTTED[kind]
    if part == "cloud":
        inner, outer = ((0.0, 0.6), (0.4, 1.0), (0.0, 1.0))[rng.integers(3)]
        wide = drawn(width=0.07, length=0.4, softness=0.03)
        parameters = drawn(160) | wide | {"inner": inner, "outer": outer}
        return "stroma-smears", parameters, "glaze", about(0.22)
    if part == "limbus":
        parameters = {"reach": about(0.25, 0.4)} | drawn(softness=0.014 * soft**0.5)
        return part, parameters, "border", about(0.7, 0.2)
    if part == "sphincter":
        return part, drawn(reach=0.17, softness=0.007 * soft**0.5), "ring", about(0.5)
    if part == "pupil":
        return part, drawn(reach=0.07), "hole", 0.9
    if part == "gaps":  # between strands, the crypts
        parameters = drawn(26, width=0.03, length=0.16) | {"inner": 0.3}
        parameters |= {"outer": about(0.75, 0.1)} | drawn(softness=0.006 * soft**0.7)
        return "stroma-smeared-dots", parameters, "dark", about(0.5)
    if part == "collarette":
        warm = "warm" if rng.uniform() < 0.6 else tone
        if rng.uniform() < dotted:
            parameters = drawn(190, width=0.012 * soft**0.5, softness=0.0035 * soft**0.5)
            parameters |= drawn(length=0.1) if rng.uniform() < smeared else {}
            return "collarette-dots", parameters, warm, about(0.7)
        parameters = drawn(120 / soft**0.4, width=0.016 * (0.6 + 0.4 * soft))
        parameters |= {"outer": about(0.38, 0.15)} | drawn(softness=0.0038 * soft)
        return "collarette-spokes", parameters, warm, about(0.55)
    if rng.uniform() < dotted + (0.3 if part == "dots" else 0):
        count, width = 300 if kind == "dit-dot" else 200, 0.011 * (0.8 + 0.25 * soft)
        parameters = drawn(count, width=width, softness=0.003 * soft)
        parameters["outer"] = about(0.87, 0.06)
        if rng.uniform() < smeared:
            return "stroma-smeared-dots", parameters | drawn(length=0.14), tone, about(0.7)
        return "stroma-dots", parameters, tone, about(0.75)
    width, softness = 0.011 * (0.5 + 0.5 * soft), 0.0038 * soft
    parameters = drawn(420 / soft**0.6, width=width, length=0.5, softness=softness, waviness=0.5)
    parameters["outer"] = 1.0 if tone == "dark" else about(0.9, 0.05)
    return "stroma-smears", parameters, tone, about(0.6)
