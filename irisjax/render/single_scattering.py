"""The iris by single scattering, as F09 renders it: rays marched through a map of layers  [F09
Section 6.1].

The layers have the index of the chamber before them, as in F09: no light is mirrored or bent at the
iris, and its surface passes all. Against radiative transfer with Fresnel's interfaces
(`experiments/integrators.py`) light at 0° seen within 60° comes out 2 to 23 % too bright: the n² of
radiance that leaves a denser medium is missing, and light scattered twice makes up for a part of
it. Beyond 70° it is wrong by factors either way, for rays unbent by the surface graze the layers.
Unlike `Separable`, neighbouring texels matter: an oblique line of sight crosses several. Light on
its way in is weakened by the column in which it is scattered alone, and relief tilts that way but
leaves the irradiance.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.interpolation import polar_bilinear
from irisjax.numerics.portions import pixelwise
from irisjax.optics.conicoid import norm
from irisjax.optics.phase import rayleigh
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Field, fluxes_of, normals, shares, slopes_of
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import FRECKLE, IrisMaps, Scales, texel_layers
from irisjax.tissue.pigments import extinction
from irisjax.transport.process import ILIT_2006, AbstractProcess


class SingleScattering(AbstractIntegrator):
    """Integrator: ray marching, one scattering with Rayleigh's phase function  [F09 Section 6.1].

    Attributes:
        n_steps: Number of equal steps in depth down to the thickest place of the maps. Within a
            step the layers are taken from its middle and integrated in closed form, so that a
            uniform iris is exact with one.
        process: Process that outputs name; its switches make no difference here.
    """

    n_steps: int = eqx.field(static=True, default=12)
    process: AbstractProcess = eqx.field(static=True, default=ILIT_2006)

    def __check_init__(self):
        if not isinstance(self.n_steps, int) or self.n_steps < 1:
            raise ValueError(
                f"SingleScattering(n_steps={self.n_steps!r}): must be a whole number of at least 1"
            )

    def illuminate(
        self,
        pixels: IrisPixels,
        lights: Lights,
        eye: Eye,
        iris: Iris,
        maps: IrisMaps | None,
        tables: Illumination | None,
    ) -> tuple["Rays", "SceneData"]:
        """See `AbstractIntegrator`. The relief tilts the surface towards the light; its parallax is
        left out.
        """
        slopes = slopes_of(None if maps is None else maps.relief, eye)
        flux, textures = fluxes_of(lights, eye, tables), local_textures(maps, iris)
        return _rays(pixels, eye, slopes), SceneData(textures, flux, lights.tint, eye)

    def response(self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales) -> "March":
        """The layers' optical depths at the wavelengths of `bands`."""
        del ranges
        table = extinction(np.asarray(bands.wavelengths))

        def depths(eumelanin, pheomelanin):
            scales = Scales(None, None, eumelanin, pheomelanin)
            made = texel_layers(iris, aqueous_index, table, scales)
            return Depths(made.abl_absorption, made.extinction)

        # Depths are linear in the melanins, which maps may change from place to place.
        rest = depths(0.0, 0.0)
        eumelanin, pheomelanin = (
            jax.tree.map(jnp.subtract, depths(*x), rest) for x in ((1.0, 0.0), (0.0, 1.0))
        )
        return March(
            rest=rest,
            eumelanin=eumelanin,
            pheomelanin=pheomelanin,
            scattering=iris.layers(table, aqueous_index).stroma_scattering,
            thickness=(iris.abl_thickness, iris.stroma_thickness),
            weights=bands.weights,
            n_steps=self.n_steps,
        )


class Rays(eqx.Module):
    """Lines of sight of pixels.

    Attributes:
        point: Where each meets the iris, mm.
        direction: Its direction in the chamber.
        normal: Normal of the iris there, with the relief's tilt.
        share: Share of light that reaches the camera.
    """

    point: Float[Array, "3 pixels"]
    direction: Float[Array, "3 pixels"]
    normal: Float[Array, "3 pixels"]
    share: Float[Array, " pixels"]


class Local(NamedTuple):
    """The subsurface map  [F09 Section 6.1], each relative to the uniform iris; `None`: one
    everywhere.
    """

    abl_thickness: Any = None
    stroma_thickness: Any = None
    freckles: Any = None
    eumelanin: Any = None
    pheomelanin: Any = None


class SceneData(eqx.Module):
    """What all pixels share.

    Attributes:
        textures: The subsurface map.
        flux: Flux vectors of each light on the grid of a `Field`.
        tint: Tint of each light.
        eye: The eye.
    """

    textures: Local
    flux: Float[Array, "lights 3 rows columns"]
    tint: Float[Array, "lights 3"] | None
    eye: Eye

    def at(self, point: Float[Array, "3 pixels"]) -> Local:
        """The map at points of the iris."""
        present = [t for t in self.textures if t is not None]
        if not present:
            return self.textures
        radius = self.eye.relative_radius(jnp.sqrt(point[0] ** 2 + point[1] ** 2))
        found = iter(polar_bilinear(jnp.stack(present), jnp.arctan2(point[1], point[0]), radius))
        return Local(*(None if t is None else next(found) for t in self.textures))


@eqx.filter_jit
def local_textures(maps: IrisMaps | None, iris: Iris) -> Local:
    """The subsurface map of an iris with maps."""
    if maps is None:
        return Local()
    dark = None if maps.freckles is None else 1 + (FRECKLE - 1) * maps.freckles
    abl = None if maps.abl_depth is None else maps.abl_depth / iris.abl_thickness
    return Local(abl, maps.stroma_scale(iris), dark, maps.eumelanin, maps.pheomelanin)


class Depths(NamedTuple):
    """Optical depths of absorption in the ABL and of extinction in the stroma, (bands,)."""

    abl: Any
    stroma: Any


class March(AbstractResponse):
    """Optical depths of the uniform iris, by what varies over it, (bands,), and thicknesses of ABL
    and stroma, mm.
    """

    rest: Depths
    eumelanin: Depths
    pheomelanin: Depths
    scattering: Float[Array, " bands"]
    thickness: tuple[Float[Array, ""], Float[Array, ""]]
    weights: Float[Array, "channels bands"]
    n_steps: int = eqx.field(static=True)
    error: None = None
    status: None = None

    def shade(
        self, pixels: IrisPixels, texels: None, light: tuple[Rays, SceneData]
    ) -> Float[Array, "channels pixels"]:
        """See `AbstractResponse`."""
        rays, data = light
        return _marched(rays, self, data)

    def radiance(self, rays: Rays, data: SceneData) -> Float[Array, "channels pixels"]:
        """Radiance of pixels: ∫ E p(α) μ_s e^(−τ_light/μ_i − τ_view/μ_o) dz/μ_o, light by
        light.
        """
        uniform = all(t is None for t in data.textures)
        n_steps = 1 if uniform else self.n_steps
        step = self._deepest(data.textures) / n_steps
        flat = data.eye.iris_normal(rays.point.T).T
        slant = 1 / jnp.maximum(-(rays.direction * flat).sum(0), 1e-3)
        along = rays.direction * slant + flat  # the iris, per depth
        sources = _sources(rays, data)
        tints = jnp.ones((data.flux.shape[0], 1), slant.dtype) if data.tint is None else data.tint

        def march(carry, k):
            clear, radiance = carry
            local = data.at(rays.point + along * ((k + 0.5) * step))
            abl_end, end = self._ends(local)
            top, bottom = k * step, (k + 1) * step
            depth, scattering = self._depths(local)
            in_abl = _passed(bottom, 0.0, abl_end) - _passed(top, 0.0, abl_end)
            above = _passed(top, abl_end, end)
            inside = _passed(bottom, abl_end, end) - above
            clear = clear * jnp.exp(-depth.abl * (in_abl * slant))
            crossed, light_depth = depth.stroma * inside, depth.abl + depth.stroma * above

            def lit(total, light):
                source, light_slant, tint = light
                arrives = jnp.exp(-light_depth * light_slant) * _mean_survival(
                    crossed * (light_slant + slant)
                )
                return total + tint[:, None, None] * (source * arrives), None

            zero = jnp.zeros((tints.shape[1], *clear.shape), clear.dtype)
            arriving = jax.lax.scan(lit, zero, (*sources, tints))[0]
            radiance = radiance + (clear * scattering) * (inside * slant) * arriving
            # The IPE absorbs a ray that reaches it, be the stroma thicker again further on.
            clear = jnp.where(bottom < end, clear * jnp.exp(-crossed * slant), 0.0)
            return (clear, radiance), None

        clear = jnp.ones((self.scattering.size, slant.size), slant.dtype)
        start = (clear, jnp.zeros((tints.shape[1], *clear.shape), clear.dtype))
        radiance = jax.lax.scan(march, start, jnp.arange(n_steps, dtype=slant.dtype))[0][1]
        if data.tint is None:
            return (self.weights @ radiance[0]) * rays.share
        return jnp.einsum("cb,cbp->cp", self.weights, radiance) * rays.share

    def _deepest(self, textures: Local):
        """Thickness of both layers where it is largest, mm."""
        abl, end = self._ends(textures)
        del abl
        return jnp.max(end)

    def _ends(self, local: Local):
        """Depths of the ends of ABL and stroma, mm."""
        abl, stroma = self.thickness
        abl = abl if local.abl_thickness is None else abl * local.abl_thickness
        return abl, abl + (
            stroma if local.stroma_thickness is None else stroma * local.stroma_thickness
        )

    def _depths(self, local: Local) -> tuple[Depths, Any]:
        """Optical depths of the whole layers and that of scattering, (bands, pixels) or (bands,
        1).
        """
        one = jnp.ones(1, self.scattering.dtype)
        eumelanin, pheomelanin, abl, freckles, stroma = (
            one if x is None else x
            for x in (
                local.eumelanin,
                local.pheomelanin,
                local.abl_thickness,
                local.freckles,
                local.stroma_thickness,
            )
        )

        def mixed(rest, eu, pheo):
            return rest[:, None] + eu[:, None] * eumelanin + pheo[:, None] * pheomelanin

        found = Depths(
            *(mixed(*x) for x in zip(self.rest, self.eumelanin, self.pheomelanin, strict=True))
        )
        return Depths(found.abl * (abl * freckles), found.stroma * stroma), self.scattering[
            :, None
        ] * stroma


@pixelwise
def _rays(pixels: IrisPixels, eye: Eye, slopes: Float[Array, "2 angles radii"] | None) -> Rays:
    point, direction, normal = map(
        jnp.stack, (pixels.point, pixels.direction, normals(pixels, eye, slopes))
    )
    return Rays(point, direction, normal, shares(pixels, eye))


@pixelwise
def _marched(rays: Rays, march: March, data: SceneData) -> Float[Array, "channels pixels"]:
    return march.radiance(rays, data)


def _sources(rays: Rays, data: SceneData):
    """Of each light at each pixel, shapes (lights, pixels): irradiance across the light times the
    phase function (1/sr), and the slant 1/μ_i."""

    def one(flux):
        found = Field(flux[None], data.eye.iris_radius).at(tuple(rays.point))[0]
        power = norm(found.T)
        towards = found / jnp.where(power > 0, power, 1.0)
        cosine = -(towards * rays.normal).sum(0)
        bend = (towards * rays.direction).sum(0)
        lit = (power > 0) & (cosine > 1e-3)
        phase = rayleigh(bend) / (4 * jnp.pi)
        return jnp.where(lit, power * phase, 0.0), 1 / jnp.where(lit, cosine, 1.0)

    return jax.lax.map(one, data.flux)


def _passed(depth, start, end):
    """Share of the layer from `start` to `end` that lies above `depth`; all of a layer without
    thickness.
    """
    thick = end - start
    empty = thick <= 0
    share = jnp.clip((depth - start) / jnp.where(empty, 1.0, thick), 0, 1)
    return jnp.where(empty, jnp.where(depth > start, 1.0, 0.0), share)


def _mean_survival(x):
    """(1 − e⁻ˣ)/x, the mean of e⁻ᵗ over [0, x]."""
    small = x < 1e-3  # the division's own gradient is 0/0 at 0
    series = 1 - x / 2 * (1 - x / 3 * (1 - x / 4))
    safe = jnp.where(small, 1.0, x)
    return jnp.where(small, series, -jnp.expm1(-safe) / safe)
