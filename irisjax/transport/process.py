"""The rules that light follows, of ILIT and of radiative transfer, as values.

Solvers integrate or sample them. Directions are cosines μ to the layer normal, depths are optical.
[LB06 Section 3]
"""

import abc
import dataclasses
from typing import ClassVar, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax._types import AnyReals, Real
from irisjax.numerics.checks import check_known
from irisjax.optics.fresnel import Shares
from irisjax.optics.phase import PHASES, AbstractPhase

Phase = Literal["lb06", "rayleigh"]
Rescatter = Literal["to-interface", "retest"]


class AbstractProcess(eqx.Module):
    """The rules that light follows; all fields are static and compiled into programs.

    Attributes:
        name: Name of the process in a sentence.
        polarised: Whether light is followed by its Stokes vector.
    """

    name: eqx.AbstractClassVar[str]
    polarised: eqx.AbstractVar[bool]

    @property
    def phase_function(self) -> AbstractPhase:
        """Phase function of the stroma."""
        return PHASES["rayleigh"]

    @property
    @abc.abstractmethod
    def transport(self) -> str:
        """Name of the kind of transport in outputs."""

    def describe(self) -> dict[str, str | bool]:
        """Return the switches by name, for headers."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}


class Ilit(AbstractProcess):
    """ILIT: tests over whole layers, directions redrawn on entering them  [LB06 Section 3].

    Attributes:
        phase: `"lb06"` samples the deflection as printed (no sin α), `"rayleigh"` Rayleigh's law.
        rescatter: Whether a scattered ray goes straight `"to-interface"`, or is tested again over
            the whole thickness (`"retest"`); they differ by a factor of two in the blue.
        perturb_on_reflection: Whether a ray reflected inside a layer gets a new direction, as on
            entry.
    """

    name: ClassVar[str] = "ILIT"
    polarised: ClassVar[bool] = False

    phase: Phase = eqx.field(static=True, default="lb06")
    rescatter: Rescatter = eqx.field(static=True, default="to-interface")
    perturb_on_reflection: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        for name, kind in (("phase", Phase), ("rescatter", Rescatter)):
            check_known(name, getattr(self, name), get_args(kind))

    @property
    def phase_function(self) -> AbstractPhase:
        return PHASES[self.phase]

    @property
    def transport(self) -> str:
        return "whole-layer"


class RadiativeTransfer(AbstractProcess):
    """Radiative transfer in the same layers.

    Light has free paths in depth, scatters by Rayleigh's law, and follows Fresnel's and Snell's
    laws at every interface; no direction is redrawn.

    Attributes:
        polarised: Whether light is followed by its Stokes vector, with Rayleigh's phase matrix and
            Fresnel's Mueller matrices, or by its intensity alone (scalar theory).
    """

    name: ClassVar[str] = "radiative transfer"

    polarised: bool = eqx.field(static=True, default=False)

    @property
    def transport(self) -> str:
        return "depth-resolved, polarised" if self.polarised else "depth-resolved"

    def describe(self) -> dict[str, str | bool]:
        return {"polarised": True} if self.polarised else {}


ILIT_2006 = Ilit()
"""ILIT as printed in LB06, with decisions where the paper leaves rules open."""

ILIT_CORRECTED = Ilit(phase="rayleigh")
"""ILIT with Rayleigh's phase function sampled exactly."""

DEPTH_RESOLVED = RadiativeTransfer()
"""Scalar radiative transfer in the same layers."""

POLARISED = RadiativeTransfer(polarised=True)
"""Radiative transfer of Stokes vectors in the same layers."""

PROCESSES: dict[str, AbstractProcess] = {
    "ilit-2006": ILIT_2006,
    "ilit-corrected": ILIT_CORRECTED,
    "depth-resolved": DEPTH_RESOLVED,
}
"""Processes by their names on the command line."""


def option_of(process: AbstractProcess) -> str:
    """The name that the command line gives a process; what outputs call it where it has none."""
    names = (name for name, candidate in PROCESSES.items() if candidate == process)
    return next(names, process.transport)


def entry_density(cosine: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Density of the cosine after diffuse perturbation, 2μ on [0, 1]  [LB06 Eq. 1]."""
    return 2 * cosine


def sample_entry(u: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Cosine after diffuse perturbation, √(1 − u)  [LB06 Eq. 1]."""
    return jnp.sqrt(1 - u)


def survival(depth: AnyReals, cosine: AnyReals) -> Array:
    """Probability of crossing a whole layer untouched, exp(−τ/μ)  [LB06 Eqs. 2, 3, 6]."""
    return jnp.exp(-depth / cosine)


def attenuation(depth: AnyReals, cosine: AnyReals) -> Array:
    """Probability of an event in a layer, P = 1 − exp(−τ/μ)  [LB06 Eqs. 2, 3, 6].

    Absorption in the ABL (Eq. 3), absorption or scattering in the stroma (Eq. 6). The event happens
    where u ≤ P; the opposite sign printed after Eq. 3 would make the palest iris the darkest.
    """
    return -jnp.expm1(-depth / cosine)


def reflections(t: Real, loss: Real, near: Shares, far: Shares) -> Shares:
    """Sum over all mirror reflections in a layer at one cosine, 1/(1 − t² F F'), and whether none
    escapes, where the sum is 0.

    It is computed from a sum of losses, so that nothing cancels where little is lost.

    Args:
        t: Survival of one crossing.
        loss: 1 − t.
        near: Reflectance and transmittance of one face.
        far: Reflectance and transmittance of the other.
    """
    escape = loss * (1 + t) + t * t * (near[1] + near[0] * far[1])
    trapped = escape <= 0
    return jnp.where(trapped, 0.0, 1 / jnp.where(trapped, 1.0, escape)), trapped
