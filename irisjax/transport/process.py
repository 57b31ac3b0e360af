"""The random rules of ILIT, written once: `exact` integrates them, `montecarlo` samples them.

Directions are cosines μ to the layer normal, depths are optical.  [LB06 Section 3]
"""

from typing import Literal, get_args

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax.optics.phase import PHASES, AbstractPhase

Phase = Literal["lb06", "rayleigh"]
Rescatter = Literal["to-interface", "retest"]
Scattering = Literal["lb06", "rayleigh-spheres"]
Cornea = Literal["none", "inward", "round-trip"]
Transport = Literal["whole-layer", "depth-resolved"]


class Process(eqx.Module):
    """Which rules a ray follows. All static: a process is compiled in, not computed with.

    - `phase`: `"lb06"` samples the deflection as printed (no sin α); `"rayleigh"` samples
        Rayleigh's law.
    - `rescatter`: after a scatter the ray goes straight `"to-interface"`, or is tested again over
        the whole thickness (`"retest"`); a factor of two in the blue lies between them.
    - `perturb_on_reflection`: whether a ray reflected inside a layer is redrawn as on entry.
    - `scattering`: the stroma's coefficient as printed (`"lb06"`), or that of independent small
        spheres.
    - `cornea`: whether light crosses tear film and cornea on its way in, or both ways; `None`
        leaves it to the instrument (reflectance: none; radiance: inward).
    - `first_surface`: whether rays mirrored by the iris's own surface count.
    - `transport`: `"whole-layer"` is ILIT; `"depth-resolved"` is radiative transfer in the same
        layers (free paths in depth, no redrawing of directions, Rayleigh's law), which makes the
        switches `rescatter` and `perturb_on_reflection` meaningless.
    """

    phase: Phase = eqx.field(static=True, default="lb06")
    rescatter: Rescatter = eqx.field(static=True, default="to-interface")
    perturb_on_reflection: bool = eqx.field(static=True, default=False)
    scattering: Scattering = eqx.field(static=True, default="lb06")
    cornea: Cornea | None = eqx.field(static=True, default=None)
    first_surface: bool = eqx.field(static=True, default=True)
    transport: Transport = eqx.field(static=True, default="whole-layer")

    def __check_init__(self):
        for name, kind in (
            ("phase", Phase),
            ("rescatter", Rescatter),
            ("scattering", Scattering),
            ("transport", Transport),
        ):
            if getattr(self, name) not in get_args(kind):
                raise ValueError(
                    f"{name} = {getattr(self, name)!r}; known: {', '.join(get_args(kind))}"
                )
        if self.cornea is not None and self.cornea not in get_args(Cornea):
            raise ValueError(f"cornea = {self.cornea!r}; known: {', '.join(get_args(Cornea))}")
        if self.transport == "depth-resolved" and self.phase != "rayleigh":
            raise ValueError('depth-resolved transport takes phase="rayleigh" only')

    @property
    def depth_resolved(self) -> bool:
        """Whether this is radiative transfer rather than ILIT's whole-layer tests."""
        return self.transport == "depth-resolved"

    @property
    def phase_function(self) -> AbstractPhase:
        """The phase function that `phase` names."""
        return PHASES[self.phase]

    def describe(self) -> dict[str, str | bool]:
        """The switches by name, for headers."""
        return {
            "transport": self.transport,
            "phase": self.phase,
            "rescatter": self.rescatter,
            "perturb_on_reflection": self.perturb_on_reflection,
            "scattering": self.scattering,
            "cornea": self.cornea or "auto",
            "first_surface": self.first_surface,
        }


ILIT_2006 = Process()
"""LB06 as printed, with the decisions where it is silent."""

ILIT_CORRECTED = Process(phase="rayleigh")
"""ILIT with Rayleigh's phase function sampled exactly."""

DEPTH_RESOLVED = Process(phase="rayleigh", transport="depth-resolved")
"""Scalar radiative transfer in the same layers, Fresnel at every interface."""

PROCESSES = {
    "ilit-2006": ILIT_2006,
    "ilit-corrected": ILIT_CORRECTED,
    "depth-resolved": DEPTH_RESOLVED,
}
"""Processes by the name the command line gives them."""


def entry_density(cosine: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Density of the cosine after diffuse perturbation, 2μ on [0, 1]  [LB06 Eq. 1]."""
    return 2 * cosine


def sample_entry(u: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Cosine after diffuse perturbation, √(1 − u)  [LB06 Eq. 1]."""
    return jnp.sqrt(1 - u)


def survival(depth, cosine):
    """Probability of crossing a whole layer untouched, exp(−τ/μ)  [LB06 Eqs. 2, 3, 6]."""
    return jnp.exp(-depth / cosine)


def attenuation(depth, cosine):
    """Probability of an event in a layer, P = 1 − exp(−τ/μ)  [LB06 Eqs. 2, 3, 6].

    Absorption in the ABL (Eq. 3), absorption or scattering in the stroma (Eq. 6). The event happens
    where u ≤ P; the opposite sign printed after Eq. 3 would make the palest iris the darkest.
    """
    return -jnp.expm1(-depth / cosine)
