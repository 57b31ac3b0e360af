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
"""From one coat to the next, mm."""
_SEEDS = 2**31


class CoatRecipe(NamedTuple):
    """A coat of paint as a recipe has it, all plain data.

    - `component` and `parameters`: what is painted, as `irisjax.ocularist.components.component`
        takes it.
    - `first`, `second`: names of paints; `share` of the second in their mixture, 0 to 1.
    - `opacity`: factor on the component's map, 0 to 1. `seed`: `jax.random.key(seed)` draws it.
    - `height`: above the base, mm.
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
    one. Equal seeds give equal coats. **Raises:** `ValueError` for an unknown type or colour and
    for a seed that is negative or not whole.
    """
    check_known("type of eye", kind, EYE_TYPES)
    check_known("colour of eye", colour, EYE_COLOURS)
    check_whole("seed", seed, 0)
    rng = np.random.default_rng([seed, EYE_TYPES.index(kind), EYE_COLOURS.index(colour)])
    paints = _PAINTS[colour]
    rounds = paints.count - 1 - len(_CLOSING)
    parts = [_ROUND[i % len(_ROUND)] for i in range(rounds)] + list(_CLOSING)
    thin = (12 / paints.count) ** 0.35  # the more coats, the thinner each
    out = [CoatRecipe("base", {}, *paints.base[0][:3], 1.0, int(rng.integers(_SEEDS)), 0.0)]
    for i, part in enumerate(parts):
        # Each round from shadows to lights, the later ones lighter: there are shadows at any depth.
        step = 2 if i >= rounds else (i % len(_ROUND)) // 2 % 3
        lit = 0.5 * i / len(parts) + 0.25 * step + rng.uniform(-0.1, 0.1)
        tone = paints.dark if lit < 0.35 else paints.middle if lit < 0.65 else paints.light
        name, parameters, mixtures, opacity = _coat(rng, kind, part, paints, tone)
        mixture = mixtures[(i // len(_ROUND) + i) % len(mixtures)]
        opacity *= mixture.strength * (thin if i < rounds else thin**0.5)
        seed, height = int(rng.integers(_SEEDS)), round((i + 1) * HEIGHT_STEP, 6)
        out.append(CoatRecipe(name, parameters, *mixture[:3], round(opacity, 3), seed, height))
    return tuple(out)


class _Mixture(NamedTuple):
    """`strength`: factor on the opacity of coats of it."""

    first: str
    second: str
    share: float
    strength: float = 1.0


_Mixtures = tuple[_Mixture, ...]


class _Paints(NamedTuple):
    """What an eye of a colour is painted with; `count`: of coats."""

    count: int
    base: _Mixtures
    dark: _Mixtures
    middle: _Mixtures
    light: _Mixtures
    glaze: _Mixtures
    warm: _Mixtures
    ring: _Mixtures
    border: _Mixtures


def _read_palettes() -> dict[str, _Paints]:
    file = resources.files("irisjax.ocularist") / "tables" / "palettes.toml"
    palettes = tomllib.loads(file.read_text(encoding="utf-8"))
    found = {}
    for colour, kinds in palettes.items():
        count = kinds.pop("count")
        mixtures = {name: tuple(_Mixture(*m) for m in some) for name, some in kinds.items()}
        found[colour] = _Paints(count, **mixtures)
    return found


_PAINTS = _read_palettes()
EYE_COLOURS = tuple(_PAINTS)
"""Colours of eye."""

_ROUND = "cloud", "stroma", "collarette", "stroma", "limbus", "stroma", "sphincter", "dots"
_CLOSING = ("collarette", "gaps", "stroma", "cloud", "sphincter", "limbus", "pupil")

_SOFT = {"smeared": 4.5, "dit-dot": 1.2, "detail": 0.9}  # brushes, relative to the usual one
# Shares of a stroma's coats that are dots, and of those that are smeared.
_DOTTED = {"smeared": (0.1, 1.0), "dit-dot": (0.75, 0.45), "detail": (0.15, 1.0)}


def _coat(rng, kind: str, part: str, paints: _Paints, tone: _Mixtures):
    """Name and parameters of a component for a part of the iris, mixtures to choose, opacity."""

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
        return "stroma-smears", parameters, paints.glaze, about(0.22)
    if part == "limbus":
        parameters = {"reach": about(0.25, 0.4)} | drawn(softness=0.014 * soft**0.5)
        return part, parameters, paints.border, about(0.7, 0.2)
    if part == "sphincter":
        return part, drawn(reach=0.17, softness=0.007 * soft**0.5), paints.ring, about(0.5)
    if part == "pupil":
        return part, drawn(reach=0.07), (_Mixture("ivory black", "burnt umber", 0.2),), 0.9
    if part == "gaps":  # between strands, the crypts
        parameters = drawn(26, width=0.03, length=0.16) | {"inner": 0.3}
        parameters |= {"outer": about(0.75, 0.1)} | drawn(softness=0.006 * soft**0.7)
        return "stroma-smeared-dots", parameters, paints.dark, about(0.5)
    if part == "collarette":
        warm = paints.warm if rng.uniform() < 0.6 else tone
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
    parameters["outer"] = 1.0 if tone is paints.dark else about(0.9, 0.05)
    return "stroma-smears", parameters, tone, about(0.6)
