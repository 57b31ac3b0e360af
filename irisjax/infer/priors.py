"""Priors, each written as a map from a standard normal number.

A parameter is sampled and fitted in the coordinate z in which its prior is the standard normal: its
value is `prior.value(z)`. Bounds then hold by themselves, the log prior is −z²/2 whatever the
prior, and a posterior variance of z below 1 is what the data have taught.
"""

import abc
import re
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr, ndtri


class AbstractPrior(eqx.Module):
    """A continuous distribution of one number. Its own numbers are static: they are settings, not
    data.
    """

    @abc.abstractmethod
    def value(self, z) -> Any:
        """The number whose prior probability below it is that of the standard normal below `z`."""

    @abc.abstractmethod
    def standard(self, value) -> Any:
        """The inverse of `value`."""

    @property
    @abc.abstractmethod
    def support(self) -> tuple[float, float]:
        """The interval that holds all of it."""


class LogNormal(AbstractPrior):
    """A positive number whose logarithm is normal: median, and standard deviation of the
    logarithm.
    """

    median: float = eqx.field(static=True, converter=float)
    spread: float = eqx.field(static=True, converter=float)

    def value(self, z):
        return self.median * jnp.exp(self.spread * z)

    def standard(self, value):
        return jnp.log(value / self.median) / self.spread

    @property
    def support(self):
        return 0.0, np.inf

    def __repr__(self):
        return f"lognormal({self.median:g}, {self.spread:g})"


class LogitNormal(AbstractPrior):
    """A share in (0, 1) whose logit is normal: median, and standard deviation of the logit."""

    median: float = eqx.field(static=True, converter=float)
    spread: float = eqx.field(static=True, converter=float)

    def value(self, z):
        odds = self.median / (1 - self.median) * jnp.exp(self.spread * z)
        return odds / (1 + odds)

    def standard(self, value):
        return jnp.log(value / (1 - value) * (1 - self.median) / self.median) / self.spread

    @property
    def support(self):
        return 0.0, 1.0

    def __repr__(self):
        return f"logitnormal({self.median:g}, {self.spread:g})"


class Uniform(AbstractPrior):
    """Equal density between two numbers."""

    low: float = eqx.field(static=True, converter=float)
    high: float = eqx.field(static=True, converter=float)

    def value(self, z):
        # From the nearer end, so that both ends are resolved alike.
        width = self.high - self.low
        return jnp.where(
            z < 0,
            self.low + width * ndtr(jnp.minimum(z, 0)),
            self.high - width * ndtr(-jnp.maximum(z, 0)),
        )

    def standard(self, value):
        return ndtri((value - self.low) / (self.high - self.low))

    @property
    def support(self):
        return float(self.low), float(self.high)

    def __repr__(self):
        return f"uniform({self.low:g}, {self.high:g})"


class LogUniform(AbstractPrior):
    """Equal density of the logarithm between two positive numbers."""

    low: float = eqx.field(static=True, converter=float)
    high: float = eqx.field(static=True, converter=float)

    def value(self, z):
        return jnp.exp(Uniform(np.log(self.low), np.log(self.high)).value(z))

    def standard(self, value):
        return Uniform(np.log(self.low), np.log(self.high)).standard(jnp.log(value))

    @property
    def support(self):
        return float(self.low), float(self.high)

    def __repr__(self):
        return f"loguniform({self.low:g}, {self.high:g})"


class Normal(AbstractPrior):
    """Normal with mean and standard deviation, cut off outside [`low`, `high`]."""

    mean: float = eqx.field(static=True, converter=float)
    sd: float = eqx.field(static=True, converter=float)
    low: float = eqx.field(static=True, converter=float, default=0.0)
    high: float = eqx.field(static=True, converter=float, default=np.inf)

    def value(self, z):
        below, above = (
            ndtr((self.low - self.mean) / self.sd),
            ndtr((self.mean - self.high) / self.sd),
        )
        # Counted from the nearer tail, where the other would round to one.
        lower = ndtri(below + (1 - below - above) * ndtr(jnp.minimum(z, 0)))
        upper = -ndtri(above + (1 - below - above) * ndtr(-jnp.maximum(z, 0)))
        return self.mean + self.sd * jnp.where(z < 0, lower, upper)

    def standard(self, value):
        below, above = (
            ndtr((self.low - self.mean) / self.sd),
            ndtr((self.mean - self.high) / self.sd),
        )
        return ndtri((ndtr((value - self.mean) / self.sd) - below) / (1 - below - above))

    @property
    def support(self):
        return float(self.low), float(self.high)

    def __repr__(self):
        return f"normal({self.mean:g}, {self.sd:g})"


_KINDS = {
    "lognormal": LogNormal,
    "logitnormal": LogitNormal,
    "uniform": Uniform,
    "loguniform": LogUniform,
    "normal": Normal,
}
_FORM = re.compile(r"\s*(\w+)\s*\(([^()]*)\)\s*")


def prior_of(text: str, low: float, high: float) -> AbstractPrior:
    """The prior written as `kind(a, b)`, for a parameter that lies in [low, high].

    **Raises:** `ValueError` for an unknown kind, numbers that make no distribution, or a support
    that reaches outside.
    """
    match = _FORM.fullmatch(text)
    kinds = (
        "lognormal(median, spread), logitnormal(median, spread), uniform(low, high), "
        "loguniform(low, high), "
        "normal(mean, sd)"
    )
    try:
        kind = _KINDS[match[1].lower()] if match else None
        a, b = (float(x) for x in match[2].split(",")) if match else (np.nan, np.nan)
    except (KeyError, ValueError):
        kind, a, b = None, np.nan, np.nan
    if kind is None:
        raise ValueError(f"{text!r} is no prior; write one of {kinds}")
    sane = (
        np.isfinite([a, b]).all()
        and {
            LogNormal: a > 0 and b > 0,
            LogitNormal: 0 < a < 1 and b > 0,
            Uniform: a < b,
            LogUniform: 0 < a < b,
            Normal: b > 0,
        }[kind]
    )
    if not sane:
        raise ValueError(f"{text!r}: these numbers make no distribution; the forms are {kinds}")
    prior = Normal(a, b, low, high) if kind is Normal else kind(a, b)
    check_prior(repr(text), prior, low, high)
    return prior


def check_prior(name: str, prior: AbstractPrior, low: float, high: float) -> None:
    """Raise `ValueError` where a prior is not one of a parameter that lies in [low, high]."""
    within = f"the parameter's range, {low:g} to {high:g}"
    if prior.support[0] < low or prior.support[1] > high:
        raise ValueError(f"{name} reaches outside {within}")
    # Cut off further out, it would be a sliver of its tail.
    if isinstance(prior, Normal) and not low - 5 * prior.sd < prior.mean < high + 5 * prior.sd:
        raise ValueError(f"{name} lies outside {within}")
