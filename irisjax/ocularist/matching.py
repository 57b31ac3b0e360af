"""Coats matched to a given eye: shares of paints and opacities by least squares through the
compositor, beyond the paper.

Maps, order and heights stay as they are. What fixed strokes cannot follow, the target's own
pattern, `retouched` paints on top.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from irisjax._types import PRNGKey, as_float
from irisjax.anatomy.eye import Eye
from irisjax.infer.least_squares import Found, least_squares, levenberg_marquardt
from irisjax.numerics.checks import Range, check_range, check_whole
from irisjax.ocularist.easel import painted
from irisjax.ocularist.mixing import AbstractMixer
from irisjax.ocularist.palette import places
from irisjax.ocularist.plan import Difference, difference, lab, plan_view, texture_of, unrolled
from irisjax.ocularist.recipes import CoatRecipe

TARGET = Range(0.0, 100.0, meaning="linear reflectance; an exposure may take it beyond 1")
PULL = 0.03
"""ΔE*ab that each unit costs by which the logit of a share or an opacity leaves where it began: a
coat that no texel shows keeps its place.
"""
_EDGE = 0.02  # from 0 and 1, at which shares and opacities begin: a logit has to move there
_CLOSE = 1e-4


class Match(NamedTuple):
    """Coats that were matched.

    - `recipes`: from the bottom up, with new shares and opacities. `exposure`: factor on their
        colours that was fitted, or 1.
    - `before`, `after`: what was and what is left, over all known texels.
    - `steps`: of the search; `converged`: whether it ended of itself.
    """

    recipes: tuple[CoatRecipe, ...]
    exposure: float
    before: Difference
    after: Difference
    steps: int
    converged: bool


def match(
    recipes: Sequence[CoatRecipe],
    mixer: AbstractMixer,
    eye: Eye,
    target: Float[Array, "angles radii 3"] | np.ndarray,
    known: Bool[np.ndarray, "angles radii"] | None = None,
    *,
    exposure: bool = False,
    scans: Mapping[str, np.ndarray] | None = None,
    size: int = 256,
    texels: int = 2000,
    max_steps: int = 60,
    key: PRNGKey,
) -> Match:
    """Shares of paints and opacities with which coats look most like a target, in plan view.

    Levenberg–Marquardt on CIE L*a*b* of texels drawn evenly over the iris. It finds a minimum near
    the recipe's own: begin with one of the eye's colour. The opacity of a `base` stays.

    Args:
        recipes: The coats to begin with.
        mixer: Of their paints.
        eye: With the target's pupil.
        target: Linear reflectance, polar as in `IrisMaps` (`unrolled` makes it of a photograph).
        known: Texels that count; all by default.
        exposure: Whether one factor on the colours of all coats is fitted too, for photographs of
            unknown exposure.
        scans: As for `painted`.
        size: Texels along a side of opacity maps.
        texels: Most texels that the search looks at.
        max_steps: Most steps of the search.
        key: For the draw of texels.

    Raises:
        ValueError: for no coat, a target or mask of another shape or out of range, a mask without
            texels, and what `painted` and `mixer` raise it for.
    """
    check_whole("texels", texels, 1)
    check_whole("max_steps", max_steps, 1)
    if not recipes:
        raise ValueError("a match needs at least one coat")
    target, known = checked(target, known)
    shape = known.shape
    ordered = sorted(recipes, key=lambda recipe: recipe.height)
    before = texture_of(painted(ordered, mixer, eye, size=size, scans=scans), eye, shape)
    whole = [recipe._replace(opacity=1.0) for recipe in ordered]
    maps = painted(whole, mixer, eye, size=size, scans=scans).coats
    opacity = jnp.stack([unrolled(coat.opacity, eye, shape) for coat in maps])
    taken = _drawn(known, eye, texels, key)
    bright = _exposure_to_begin(before, target, known) if exposure else 0.0
    start = jnp.concatenate(
        [
            _logit([recipe.share for recipe in ordered]),
            _logit([recipe.opacity for recipe in ordered]),
            as_float(bright)[None],
        ]
    )
    problem = _Problem(
        mixer,
        jnp.asarray(places([recipe.first for recipe in ordered], mixer.names)),
        jnp.asarray(places([recipe.second for recipe in ordered], mixer.names)),
        opacity.reshape(len(ordered), -1)[:, taken],
        lab(target.reshape(-1, 3)[taken]),
        as_float([recipe.opacity for recipe in ordered]),
        jnp.asarray([recipe.component == "base" for recipe in ordered]),
        jnp.asarray(exposure),
        start,
    )
    found = _searched(problem, max_steps)
    shares, strengths, factor = (np.asarray(v, np.float64) for v in _values(found.x, problem))
    new = tuple(
        recipe._replace(share=float(share), opacity=float(strength))
        for recipe, share, strength in zip(ordered, shares, strengths, strict=True)
    )
    after = texture_of(painted(new, mixer, eye, size=size, scans=scans), eye, shape)
    after = after * as_float(factor)
    return Match(
        new,
        float(factor),
        difference(before, target, known),
        difference(after, target, known),
        int(found.steps),
        bool(found.result == optx.RESULTS.successful),
    )


def checked(
    target, known
) -> tuple[Float[Array, "angles radii 3"], Bool[np.ndarray, "angles radii"]]:
    """A target and its mask as arrays.

    **Raises:** `ValueError` as for `match`.
    """
    shape = np.shape(target)
    if len(shape) != 3 or shape[2] != 3 or min(shape[:2]) < 2:
        raise ValueError(
            f"a target has shape {shape}; need (angles, radii, 3), at least 2 angles and radii"
        )
    mask = np.ones(shape[:2], bool) if known is None else np.asarray(known)
    if mask.shape != shape[:2] or mask.dtype != bool:
        raise ValueError(
            f"the mask of a target of {shape[0]} angles and {shape[1]} radii has shape "
            f"{mask.shape} of {mask.dtype}; need {shape[:2]} of bool"
        )
    if not mask.any():
        raise ValueError("the mask of a target leaves no texel")
    values = np.asarray(target)
    check_range("target", values[mask], TARGET)
    return as_float(np.where(mask[..., None], values, 0.0)), mask


class _Problem(NamedTuple):
    """`opacity`: of whole coats at texels; `target`: L*a*b* there; `given`: opacities of recipes;
    `start`: logits of shares and of opacities, logarithm of the exposure.
    """

    mixer: AbstractMixer
    first: Array
    second: Array
    opacity: Array
    target: Array
    given: Array
    held: Array
    exposed: Array
    start: Array


def _values(x, problem: _Problem):
    """Shares, opacities and exposure."""
    coats = len(problem.held)
    shares, strengths = jax.nn.sigmoid(x[:coats]), jax.nn.sigmoid(x[coats : 2 * coats])
    exposure = jnp.where(problem.exposed, jnp.exp(x[-1]), 1.0)
    return shares, jnp.where(problem.held, problem.given, strengths), exposure


def _residuals(x, pull, problem: _Problem):
    """Of L*a*b*, and of what is drawn back to its start; the sum of squares is mean ΔE² and the
    price of the moves.
    """
    shares, strengths, exposure = _values(x, problem)
    colours = problem.mixer.blend(problem.first, problem.second, shares)
    seen = exposure * plan_view(strengths[:, None] * problem.opacity, colours)
    off = (lab(seen) - problem.target).ravel() / np.sqrt(len(problem.target))
    return jnp.concatenate([off, pull * (x - problem.start)])


@eqx.filter_jit
def _searched(problem: _Problem, max_steps: int) -> Found:
    return least_squares(
        _residuals,
        problem,
        problem.start,
        weights=jnp.full(1, PULL, problem.start.dtype),
        solver=levenberg_marquardt(_CLOSE, _CLOSE),
        max_steps=max_steps,
    )


def _logit(values) -> Float[Array, " coats"]:
    inside = np.clip(np.asarray(values, np.float64), _EDGE, 1 - _EDGE)
    return as_float(np.log(inside / (1 - inside)))


def _exposure_to_begin(seen, target, known) -> float:
    """Logarithm by which the target's mean is brighter."""
    one, other = (float(np.asarray(v)[known].mean()) for v in (seen, target))
    return float(np.log(max(other, 1e-4) / max(one, 1e-4)))


def _drawn(known, eye: Eye, most: int, key: PRNGKey) -> np.ndarray:
    """Places of some known texels, as many as their area counts."""
    radius = (np.arange(known.shape[1]) + 0.5) / known.shape[1]
    area = np.where(known, np.asarray(eye.from_axis(radius)), 0.0).ravel()
    count = min(most, int(known.sum()))
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)).ravel())
    return np.sort(rng.choice(area.size, count, replace=False, p=area / area.sum()))
