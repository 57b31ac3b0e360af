"""Priors, each written as a map from a standard normal number.

A parameter is sampled and fitted in the coordinate z in which its prior is the standard normal: its
value is `prior.value(z)`. Bounds then hold by themselves, the log prior is −z²/2 whatever the
prior, and how far a posterior variance of z is below 1 measures what the data add to the prior.
"""

import abc
import dataclasses
import re
from typing import Any, ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr, ndtri

_Real: TypeAlias = float | np.ndarray | jax.Array
"""A number or an array of numbers."""


class AbstractPrior(eqx.Module):
    """A continuous distribution of a number in (`low`, `high`), whose settings are static."""

    low: eqx.AbstractVar[float]
    high: eqx.AbstractVar[float]

    @abc.abstractmethod
    def value(self, z: _Real) -> jax.Array:
        """Return the prior's quantile at the standard normal's probability below z."""

    @abc.abstractmethod
    def standard(self, value: _Real) -> jax.Array:
        """Return the inverse of `value`."""

    @property
    @abc.abstractmethod
    def valid(self) -> bool:
        """Whether its numbers make a distribution."""

    def __repr__(self) -> str:
        """The form in which `prior_of` reads it: the kind and its two numbers."""
        a, b = (getattr(self, f.name) for f in dataclasses.fields(self)[:2])
        return f"{type(self).__name__.lower()}({a:g}, {b:g})"


def _number(**options: Any) -> Any:
    return eqx.field(static=True, converter=float, **options)


class LogNormal(AbstractPrior):
    """A positive number whose logarithm is normal, with standard deviation `spread`."""

    median: float = _number()
    spread: float = _number()
    low: ClassVar[float] = 0.0
    high: ClassVar[float] = np.inf

    def value(self, z: _Real) -> jax.Array:
        return self.median * jnp.exp(self.spread * z)

    def standard(self, value: _Real) -> jax.Array:
        return jnp.log(value / self.median) / self.spread

    @property
    def valid(self) -> bool:
        return self.median > 0 and self.spread > 0


class LogitNormal(AbstractPrior):
    """A share in (0, 1) whose logit is normal, with standard deviation `spread`."""

    median: float = _number()
    spread: float = _number()
    low: ClassVar[float] = 0.0
    high: ClassVar[float] = 1.0

    def value(self, z: _Real) -> jax.Array:
        odds = self.median / (1 - self.median) * jnp.exp(self.spread * z)
        return odds / (1 + odds)

    def standard(self, value: _Real) -> jax.Array:
        return jnp.log(value / (1 - value) * (1 - self.median) / self.median) / self.spread

    @property
    def valid(self) -> bool:
        return 0 < self.median < 1 and self.spread > 0


class Uniform(AbstractPrior):
    """Equal density between two numbers, `low` and `high`."""

    low: float = _number()
    high: float = _number()

    def value(self, z: _Real) -> jax.Array:
        # From the nearer end, so that both ends are resolved alike.
        up, down = ndtr(jnp.minimum(z, 0)), ndtr(-jnp.maximum(z, 0))
        width = self.high - self.low
        return jnp.where(z < 0, self.low + width * up, self.high - width * down)

    def standard(self, value: _Real) -> jax.Array:
        return ndtri((value - self.low) / (self.high - self.low))

    @property
    def valid(self) -> bool:
        return self.low < self.high


class LogUniform(AbstractPrior):
    """Equal density of the logarithm between two positive numbers, `low` and `high`."""

    low: float = _number()
    high: float = _number()

    def value(self, z: _Real) -> jax.Array:
        return jnp.exp(Uniform(np.log(self.low), np.log(self.high)).value(z))

    def standard(self, value: _Real) -> jax.Array:
        return ndtri(jnp.log(value / self.low) / np.log(self.high / self.low))

    @property
    def valid(self) -> bool:
        return 0 < self.low < self.high


class Normal(AbstractPrior):
    """Normal with this mean and standard deviation, cut off outside [`low`, `high`]."""

    mean: float = _number()
    sd: float = _number()
    low: float = _number(default=0.0)
    high: float = _number(default=np.inf)

    def value(self, z: _Real) -> jax.Array:
        below, above = self._cut_off()
        # Counted from the nearer tail, where the other would round to one.
        lower = ndtri(below + (1 - below - above) * ndtr(jnp.minimum(z, 0)))
        upper = -ndtri(above + (1 - below - above) * ndtr(-jnp.maximum(z, 0)))
        return self.mean + self.sd * jnp.where(z < 0, lower, upper)

    def standard(self, value: _Real) -> jax.Array:
        below, above = self._cut_off()
        return ndtri((ndtr((value - self.mean) / self.sd) - below) / (1 - below - above))

    @property
    def valid(self) -> bool:
        return self.sd > 0

    def _cut_off(self) -> tuple[jax.Array, jax.Array]:
        """Probabilities below and above the bounds."""
        return ndtr((self.low - self.mean) / self.sd), ndtr((self.mean - self.high) / self.sd)


_KINDS: dict[str, Any] = {
    kind.__name__.lower(): kind for kind in (LogNormal, LogitNormal, Uniform, LogUniform, Normal)
}
_FORM = re.compile(r"\s*(\w+)\s*\(([^(),]*),([^(),]*)\)\s*")
_FORMS = (
    "lognormal(median, spread), logitnormal(median, spread), uniform(low, high), "
    "loguniform(low, high), normal(mean, sd)"
)
_NONE = f"these numbers make no distribution; the forms are {_FORMS}"


def prior_of(text: str, low: float, high: float) -> AbstractPrior:
    """Read a prior written as `kind(a, b)`, for a parameter that lies in [low, high]; `ValueError`
    for an unknown kind, numbers that make no distribution, or a support that reaches outside.
    """
    try:
        name, *numbers = _FORM.fullmatch(text).groups()  # pyright: ignore[reportOptionalMemberAccess]
        a, b = map(float, numbers)
        kind = _KINDS[name.lower()]
    except (AttributeError, KeyError, ValueError):
        raise ValueError(f"{text!r} is no prior; write one of {_FORMS}") from None
    prior = Normal(a, b, low, high) if kind is Normal else kind(a, b)
    if not np.isfinite([a, b]).all():
        raise ValueError(f"{text!r}: {_NONE}")
    check_prior(repr(text), prior, low, high)
    return prior


def check_prior(name: str, prior: AbstractPrior, low: float, high: float) -> None:
    """Raise `ValueError` where a prior is not one of a parameter that lies in [low, high]."""
    if not prior.valid:
        raise ValueError(f"{name}: {_NONE}")
    within = f"the parameter's range, {low:g} to {high:g}"
    if prior.low < low or prior.high > high:
        raise ValueError(f"{name} reaches outside {within}")
    # Cut off further out, it would be a sliver of its tail.
    if isinstance(prior, Normal) and not low - 5 * prior.sd < prior.mean < high + 5 * prior.sd:
        raise ValueError(f"{name} lies outside {within}")
