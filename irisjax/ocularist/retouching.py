"""Coats that follow a target's own pattern, where strokes drawn from a key cannot."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter

from irisjax._types import as_float
from irisjax.anatomy.eye import Eye
from irisjax.numerics.checks import check_range, check_whole
from irisjax.ocularist.coats import OPACITY, over, through
from irisjax.ocularist.easel import SCAN, painted
from irisjax.ocularist.matching import checked
from irisjax.ocularist.mixing import AbstractMixer
from irisjax.ocularist.plan import lab, plan_view, rolled
from irisjax.ocularist.recipes import HEIGHT_STEP, CoatRecipe

_SHARES = np.linspace(0.0, 1.0, 7)
_LEVELS = 33  # of opacity that are tried
_TEXELS = 1500  # that choose a mixture


class Retouch(NamedTuple):
    """Coats to paint on top and the pictures that they are scanned from, by the names of their
    files: grey values from 0, opaque, to 1, (size, size) each.
    """

    recipes: tuple[CoatRecipe, ...]
    scans: dict[str, np.ndarray]


def retouched(
    recipes: Sequence[CoatRecipe],
    mixer: AbstractMixer,
    eye: Eye,
    target,
    known=None,
    *,
    count: int = 6,
    exposure: float = 1.0,
    most: float = 1.0,
    blur: float = 0.5,
    prefix: str = "retouch-",
    scans: Mapping[str, np.ndarray] | None = None,
    size: int = 256,
) -> Retouch:
    """Further coats, each of the mixture of two paints that leaves least of the mean ΔE² in plan
    view, as opaque at each texel as serves it best.

    Args:
        recipes: The coats below, such as those of a `Match`.
        mixer: Of their paints; every pair of its paints is tried.
        eye: With the target's pupil.
        target: As for `match`, `known` too: what is not known stays as it is.
        known: The texels that are known.
        count: Further coats.
        exposure: Factor on all colours, such as that of a `Match`.
        most: Opacity that no coat exceeds.
        blur: Standard deviation of the brush, texels of the map.
        prefix: Of the names of the files, before a number and `.png`.
        scans: As for `painted`.
        size: Texels along a side of opacity maps; paint them at this size.

    Raises:
        ValueError: as for `match`.
    """
    check_whole("count", count, 0)
    check_range("most", most, OPACITY)
    target, mask = checked(target, known)
    row, column, on = rolled(target, eye, size)
    there = on & mask[row, column]
    wanted = lab(target[row, column][there])
    coats = painted(recipes, mixer, eye, size=size, scans=scans).coats
    state = plan_view(
        jnp.stack([coat.opacity[there] for coat in coats]),
        jnp.stack([coat.colour for coat in coats]),
    )
    mixtures, colours = _mixtures(mixer)
    factor = as_float(exposure)
    levels = jnp.linspace(0.0, most, _LEVELS).astype(factor.dtype)
    some = np.linspace(0, len(wanted) - 1, min(_TEXELS, len(wanted))).astype(int)
    height = max(recipe.height for recipe in recipes)
    taken = {recipe.parameters.get("file") for recipe in recipes}
    names = (f"{prefix}{n}.png" for n in range(1, len(recipes) + count + 1))
    free = [name for name in names if name not in taken]
    new: list[CoatRecipe] = []
    pictures: dict[str, np.ndarray] = dict(scans or {})
    for name in free[:count]:
        costs = _costs(state[some], wanted[some], colours, levels, factor)
        best = int(np.argmin(costs))
        opacity = np.zeros((size, size))
        opacity[there] = _best(state, wanted, colours[best], levels, factor)[1]
        # Where a scan's grey is kept in 8 bits what it holds is what was reckoned with.
        opacity = np.rint(255 * _brushed(opacity, there, blur)) / 255
        alpha = jnp.asarray(opacity[there], state.dtype)[:, None]
        state = _above(state, alpha, colours[best][None])
        height += HEIGHT_STEP
        parameters: dict[str, Any] = {"file": name}
        new.append(CoatRecipe(SCAN, parameters, *mixtures[best], 1.0, 0, round(height, 6)))
        pictures[name] = 1 - opacity
    return Retouch(tuple(new), pictures)


def _mixtures(mixer: AbstractMixer):
    """Names and shares of mixtures, and their colours (mixtures, 3)."""
    pairs = [
        (first, second, float(share))
        for first, second in combinations(mixer.names, 2)
        for share in _SHARES
    ] or [(mixer.names[0], mixer.names[0], 0.0)]
    first, second, share = zip(*pairs, strict=True)
    return pairs, mixer.mix(first, second, np.asarray(share))


def _brushed(opacity: np.ndarray, there: np.ndarray, blur: float) -> np.ndarray:
    """Softly, and none of it where nothing is known."""
    if not blur:
        return opacity
    paint = gaussian_filter(opacity, blur)
    return np.where(there, paint / np.maximum(gaussian_filter(there.astype(float), blur), 1e-6), 0)


def _above(state, opacity, paint):
    """A coat on top, which tints the light of all below."""
    return over(through(state, opacity, paint), opacity, paint, 1.0)


@eqx.filter_jit
def _costs(state, wanted, colours, levels, exposure):
    return jax.lax.map(lambda c: _best(state, wanted, c, levels, exposure)[0].mean(), colours)


@eqx.filter_jit
def _best(state, wanted, colour, levels, exposure):
    """Least ΔE² of each texel, and the opacity that leaves it."""

    def at(level):
        return ((lab(exposure * _above(state, level, colour[None])) - wanted) ** 2).sum(-1)

    left = jax.lax.map(at, levels)
    return left.min(0), levels[left.argmin(0)]
