"""Coats matched to a given eye, beyond the paper: shares of paints and opacities by least squares
in plan view, and further coats on top.

`match` keeps maps, order and heights as they are. The target's own pattern, which fixed strokes
cannot follow, is painted on top by `retouch`.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy import optimize, special
from scipy.ndimage import gaussian_filter

from irisjax._types import PRNGKey, as_float
from irisjax.anatomy.eye import Eye
from irisjax.measure.colour import lab_of_srgb
from irisjax.numerics.checks import Range, check_range, check_whole
from irisjax.numerics.streams import words_of
from irisjax.ocularist import plan
from irisjax.ocularist.coats import over, through
from irisjax.ocularist.mixing import AbstractMixer
from irisjax.ocularist.painting import SCAN, painted
from irisjax.ocularist.plan import Difference, plan_view
from irisjax.ocularist.recipes import HEIGHT_STEP, CoatRecipe

_Target = Float[Array, "angles radii 3"] | np.ndarray
_Known = Bool[np.ndarray, "angles radii"]
_EDGE = 0.02  # least distance of first shares and opacities from 0 and 1, where logits are infinite
_CLOSE = 1e-4  # relative change of cost and parameters at which the search ends
_SHARES = np.linspace(0.0, 1.0, 7)
_LEVELS = 33  # trial opacities
_TEXELS = 1500  # that a mixture is chosen by
_TARGET = Range(0.0, 100.0, meaning="linear reflectance; an exposure may take it beyond 1")
# ΔE*ab that a unit of change in the logit of a share or an opacity costs. It fixes the coats that
# no texel shows.
_PULL = 0.03
_BLUR = 0.5  # standard deviation of the retouching brush, texels


class Match(NamedTuple):
    """Coats that were matched.

    Attributes:
        recipes: From the bottom up, with new shares and opacities.
        before: Colour difference over all known texels before the match.
        after: Colour difference after it.
        steps: Evaluations of the search.
        converged: Whether the search converged within its steps.
    """

    recipes: tuple[CoatRecipe, ...]
    before: Difference
    after: Difference
    steps: int
    converged: bool


def match(
    recipes: Sequence[CoatRecipe],
    mixer: AbstractMixer,
    eye: Eye,
    target: _Target,
    known: _Known | None = None,
    *,
    scans: Mapping[str, np.ndarray] | None = None,
    size: int = 256,
    texels: int = 2000,
    max_steps: int = 60,
    key: PRNGKey,
) -> Match:
    """Fit shares of paints and opacities so that coats look most like a target in plan view.

    Least squares of CIE L*a*b* at texels drawn evenly over the iris. The search finds a minimum
    near the recipe's own values: begin with a recipe of the eye's colour. The opacity of a `base`
    is not fitted.

    Args:
        recipes: The coats to begin with.
        mixer: Mixer of their paints.
        eye: Eye with the target's pupil.
        target: Linear reflectance, polar as in `IrisMaps`.
        known: Texels that count; all by default.
        scans: As for `painted`.
        size: Texels along a side of opacity maps.
        texels: Largest number of texels that are compared.
        max_steps: Largest number of evaluations.
        key: For the draw of texels.

    Raises:
        ValueError: for no coat, a target or mask of another shape or out of range, a mask without
            texels, and what `painted` and `mixer` raise it for.
    """
    check_whole("texels", texels, 1)
    check_whole("max_steps", max_steps, 1)
    if not recipes:
        raise ValueError("a match needs at least one coat")
    target, known = _checked_target(target, known)
    ordered = sorted(recipes, key=lambda recipe: recipe.height)

    def painting(coats):
        return painted(coats, mixer, eye, size=size, scans=scans)

    def left(coats):
        return plan.difference(plan.texture_of(painting(coats), eye, known.shape), target, known)

    before = left(ordered)
    maps = painting([recipe._replace(opacity=1.0) for recipe in ordered]).coats
    opacity = jnp.stack([plan.unrolled(coat.opacity, eye, known.shape) for coat in maps])
    taken = _drawn(known, eye, texels, key)
    components, _, first, second, *numbers = zip(*ordered, strict=True)
    values = np.array(numbers[:2])  # shares and opacities
    start = special.logit(np.clip(values, _EDGE, 1 - _EDGE)).ravel()
    problem = _Problem(
        mixer,
        jnp.asarray(mixer.indices(first)),
        jnp.asarray(mixer.indices(second)),
        opacity.reshape(len(ordered), -1)[:, taken],
        lab_of_srgb(target.reshape(-1, 3)[taken]),
        as_float(values[1]),
        jnp.asarray(np.array(components) == "base"),
        as_float(start),
    )

    def of(function):
        return lambda x: np.asarray(function(as_float(x), problem), np.float64)

    kinds: Any = {"jac": of(_jacobian), "method": "lm", "ftol": _CLOSE, "xtol": _CLOSE}
    found = optimize.least_squares(of(_residuals), start, **kinds, max_nfev=max_steps)
    fitted = of(_values)(found.x).T.tolist()
    new = tuple(
        recipe._replace(share=share, opacity=opacity)
        for recipe, (share, opacity) in zip(ordered, fitted, strict=True)
    )
    return Match(new, before, left(new), found.nfev, found.status > 0)


class Retouch(NamedTuple):
    """Coats to paint on top.

    Attributes:
        recipes: From the bottom up.
        scans: The pictures of all scanned coats by the names of their files; those of the new coats
            are grey values from 0, opaque, to 1, of shape (size, size).
    """

    recipes: tuple[CoatRecipe, ...]
    scans: dict[str, np.ndarray]


def retouch(
    recipes: Sequence[CoatRecipe],
    mixer: AbstractMixer,
    eye: Eye,
    target: _Target,
    known: _Known | None = None,
    *,
    count: int = 6,
    prefix: str = "retouch-",
    scans: Mapping[str, np.ndarray] | None = None,
    size: int = 256,
) -> Retouch:
    """Add coats, each of that mixture of two paints that leaves the least mean ΔE² in plan view,
    with the best opacity at each texel.

    Args:
        recipes: The coats below, such as those of a `Match`.
        mixer: Mixer of their paints, every pair of which is tried.
        eye: Eye with the target's pupil.
        target: As for `match`.
        known: As for `match`; other texels are left as they are.
        count: Number of coats to add.
        prefix: Beginning of the names of the files, before a number and `.png`.
        scans: As for `painted`.
        size: Texels along a side of opacity maps; paint the new coats at this size.

    Raises:
        ValueError: as for `match`.
    """
    check_whole("count", count, 0)
    target, mask = _checked_target(target, known)
    row, column, on = plan.rolled(target.shape[:2], eye, size)
    there = on & mask[row, column]
    wanted = lab_of_srgb(target[row, column][there])
    coats = painted(recipes, mixer, eye, size=size, scans=scans).coats
    opacities = jnp.stack([coat.opacity[there] for coat in coats])
    state = plan_view(opacities, jnp.stack([coat.colour for coat in coats]))
    mixtures, colours = _mixtures(mixer)
    levels = jnp.linspace(0.0, 1.0, _LEVELS).astype(state.dtype)
    some = np.linspace(0, len(wanted) - 1, min(_TEXELS, len(wanted))).astype(int)
    height = max(recipe.height for recipe in recipes)
    taken = {recipe.parameters.get("file") for recipe in recipes}
    names = (name for n in itertools.count(1) if (name := f"{prefix}{n}.png") not in taken)
    new: list[CoatRecipe] = []
    pictures: dict[str, np.ndarray] = dict(scans or {})
    for name in itertools.islice(names, count):
        best = int(np.argmin(_costs(state[some], wanted[some], colours, levels)))
        opacity = np.zeros((size, size))
        opacity[there] = _best(state, wanted, colours[best], levels)[1]
        # Rounded as a file of 8 bits keeps it, so that later coats correct for the rounding.
        opacity = np.rint(255 * _brushed(opacity, there)) / 255
        alpha = jnp.asarray(opacity[there], state.dtype)[:, None]
        state = _above(state, alpha, colours[best][None])
        height += HEIGHT_STEP
        new.append(CoatRecipe(SCAN, {"file": name}, *mixtures[best], 1.0, 0, round(height, 6)))
        pictures[name] = 1 - opacity
    return Retouch(tuple(new), pictures)


def _checked_target(target, known) -> tuple[Float[Array, "angles radii 3"], _Known]:
    """A target, 0 where it is unknown, and its mask."""
    values = np.asarray(target)
    texels = values.shape[:2]
    if values.shape[2:] != (3,) or min(texels) < 2:
        need = "need (angles, radii, 3), at least 2 angles and radii"
        raise ValueError(f"a target has shape {values.shape}; {need}")
    mask = np.ones(texels, bool) if known is None else np.asarray(known)
    if mask.shape != texels or mask.dtype != bool:
        of = f"the mask of a target of {texels[0]} angles and {texels[1]} radii"
        raise ValueError(f"{of} has shape {mask.shape} of {mask.dtype}; need {texels} of bool")
    if not mask.any():
        raise ValueError("the mask of a target leaves no texel")
    check_range("target", values[mask], _TARGET)
    return as_float(np.where(mask[..., None], values, 0.0)), mask


class _Problem(NamedTuple):
    """Data of the residuals; arrays have one entry per coat unless stated.

    Attributes:
        mixer: Mixer of the paints.
        first, second: Indices of the paints.
        opacity: Opacity of whole coats, shape (coats, texels).
        target: L*a*b* of the target, shape (texels, 3).
        given: Opacities of the recipe.
        fixed: Whether the opacity is kept.
        start: Logits of the shares, then of the opacities, of the recipe.
    """

    mixer: AbstractMixer
    first: Array
    second: Array
    opacity: Array
    target: Array
    given: Array
    fixed: Array
    start: Array


def _values(x, problem: _Problem):
    """Shares and opacities."""
    shares, strengths = jax.nn.sigmoid(x.reshape(2, -1))
    return shares, jnp.where(problem.fixed, problem.given, strengths)


@eqx.filter_jit
def _residuals(x, problem: _Problem):
    """Residuals: the sum of squares is mean ΔE² and the cost of changes from the start."""
    shares, strengths = _values(x, problem)
    colours = problem.mixer.blend(problem.first, problem.second, shares)
    seen = plan_view(strengths[:, None] * problem.opacity, colours)
    off = (lab_of_srgb(seen) - problem.target).ravel() / np.sqrt(len(problem.target))
    return jnp.concatenate([off, _PULL * (x - problem.start)])


@eqx.filter_jit
def _jacobian(x, problem: _Problem):
    return jax.jacfwd(_residuals)(x, problem)


def _drawn(known: _Known, eye: Eye, most: int, key: PRNGKey) -> np.ndarray:
    """Indices of some known texels, with probabilities proportional to their area."""
    radius = (np.arange(known.shape[1]) + 0.5) / known.shape[1]
    area = np.where(known, np.asarray(eye.from_axis(radius)), 0.0).ravel()
    count = min(most, int(known.sum()))
    rng = np.random.default_rng(words_of(key))
    return np.sort(rng.choice(area.size, count, replace=False, p=area / area.sum()))


def _mixtures(mixer: AbstractMixer):
    """Names and shares of mixtures, and their colours (mixtures, 3)."""
    two = itertools.combinations(mixer.paints, 2)
    pairs = [(*names, share) for names in two for share in _SHARES.tolist()]
    pairs = pairs or [(mixer.paints[0], mixer.paints[0], 0.0)]
    *names, share = zip(*pairs, strict=True)
    return pairs, mixer.mix(*names, np.asarray(share))


def _brushed(opacity: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Opacity blurred by the brush, with none where the target is unknown."""
    paint, cover = (gaussian_filter(v, _BLUR) for v in (opacity, there.astype(float)))
    return np.where(there, paint / np.maximum(cover, 1e-6), 0)


def _above(state, opacity, paint):
    """A coat on top, which tints the light of all below."""
    return over(through(state, opacity, paint), opacity, paint, 1.0)


@eqx.filter_jit
def _costs(state, wanted, colours, levels):
    return jax.lax.map(lambda c: _best(state, wanted, c, levels)[0].mean(), colours)


@eqx.filter_jit
def _best(state, wanted, colour, levels):
    """Least ΔE² of each texel, and the opacity at which it is reached."""

    def at(level):
        return ((lab_of_srgb(_above(state, level, colour[None])) - wanted) ** 2).sum(-1)

    left = jax.lax.map(at, levels)
    return left.min(0), levels[left.argmin(0)]
