"""The iris by single scattering, as F09 renders it: rays marched through a map of layers  [F09
Section 6.1].

The layers have the index of the chamber before them, as in F09: no light is reflected or refracted
at the iris. Compared with radiative transfer with Fresnel's interfaces
(`experiments/integrators.py`) light at 0° seen within 60° is 2 to 23 % too bright: the factor 1/n²
of radiance that leaves a denser medium is missing, and the missing multiple scattering makes up for
a part of it. Beyond 70° it is wrong by factors either way, since rays that are not refracted graze
the layers. Unlike with `Separable`, neighbouring texels matter: an oblique line of sight crosses
several. Incident light is attenuated only in the column in which it scatters; a relief changes the
direction of incidence, but not the irradiance.
"""

from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.checks import check_whole
from irisjax.numerics.chunks import pixelwise
from irisjax.numerics.fusion import materialise
from irisjax.numerics.interpolation import chebyshev_nodes, polar_bilinear
from irisjax.optics.conicoid import from_parts, norm
from irisjax.optics.phase import rayleigh
from irisjax.render.angular import AngularFunctions, surface_indices
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.polynomials import chebyshev_polynomials
from irisjax.render.project import IrisPixels
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.shading import (
    Facing,
    IrisModel,
    camera_share,
    flux_at,
    hiding_factor,
    incident_flux,
    normal_at,
)
from irisjax.render.surfaces import IrisSurface
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.tissue.maps import FRECKLE, Scales, Texture, texel_layers
from irisjax.tissue.pigments import extinction
from irisjax.transport.light import Light
from irisjax.transport.process import DEPTH_RESOLVED, ILIT_2006, AbstractProcess
from irisjax.transport.radiative.slab import mean_survival
from irisjax.transport.solution import outcome
from irisjax.transport.solver import AbstractSolver

_LOWEST = 0.2  # cosine down to which a BRDF is tabulated


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

    def __check_init__(self) -> None:
        check_whole("SingleScattering: n_steps", self.n_steps, 1)

    def illuminate(
        self,
        pixels: IrisPixels,
        lights: Lights,
        model: IrisModel,
        tables: Illumination | None,
        facing: Facing | None,
    ) -> "tuple[MarchedScene, Facing | None]":
        """Return the scene that all pixels share, and how each of them faces the light. The relief
        tilts the surface; its parallax is left out.
        """
        unused: Any = {"relief": None, "residual": None}
        maps = {} if model.maps is None else model.maps.replace(**unused).present()
        flux = incident_flux(lights, model.eye, tables)
        return MarchedScene(maps, flux, lights.tint_factors, model.eye), facing

    def response(
        self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "MarchedResponse":
        """Compute the layers' optical depths at the wavelengths of `bands`."""
        del ranges
        table = extinction(np.asarray(bands.wavelengths))

        def depths(eumelanin, pheomelanin):
            scales = Scales(None, None, eumelanin, pheomelanin)
            layers = texel_layers(iris, aqueous_index, table, scales)
            return jnp.stack([layers.abl_absorption, layers.extinction])

        # Depths are linear in the melanins, which maps may change from place to place.
        rest = depths(0.0, 0.0)
        return MarchedResponse(
            depths=(rest, depths(1.0, 0.0) - rest, depths(0.0, 1.0) - rest),
            scattering=iris.layers(table, aqueous_index).stroma_scattering,
            thickness=(iris.abl_thickness, iris.stroma_thickness),
            weights=bands.weights,
            n_steps=self.n_steps,
        )


class TabulatedSingleScattering(RadiativeIntegrator):
    """Integrator: one scattering in each texel's layers, tabulated as by `RadiativeIntegrator`.

    It is what `SingleScattering` draws of a uniform iris, linear in the coefficients of its table,
    so that pigments can be inferred with it.
    """

    angular: tuple[int, int, int] = eqx.field(static=True, default=(6, 5, 4))
    solver: AbstractSolver | None = eqx.field(default_factory=lambda: _OneScattering())

    def directions(self, iris: Iris, aqueous_index: Scalar) -> AngularFunctions:
        index = surface_indices(iris, aqueous_index)[0]
        return _IndexMatchedFunctions(indices=(index, index), degrees=self.angular)


class _IndexMatchedFunctions(AngularFunctions):
    """For layers of the chamber's index: their BRDF times the sum of both cosines is smooth from
    `_LOWEST` on.
    """

    def inside_nodes(self, degree):
        return _LOWEST + (1 - _LOWEST) * jnp.asarray((chebyshev_nodes(degree + 1) + 1) / 2)

    def cross_surface(self, cosine, degree):
        clipped = jnp.maximum(cosine, _LOWEST)
        rows = chebyshev_polynomials(2 * (clipped - _LOWEST) / (1 - _LOWEST) - 1, degree + 1)
        return clipped, rows, jnp.ones_like(clipped)

    def functions(self, cos_incidence, cos_exit, across):
        return super().functions(cos_incidence, cos_exit, across) / (cos_incidence + cos_exit)

    def coefficients(self, brdf):
        incidences, exits = self.nodes()[0]
        return super().coefficients(brdf * (incidences[:, None] + exits.cosine)[..., None])


class _OneScattering(AbstractSolver):
    """BRDF of layers that scatter once: p(α) μ_s h e^(−τ_A s) (1 − e^(−τ s))/(4π τ s μ_i μ_o) with
    s = 1/μ_i + 1/μ_o and optical depths τ_A of the ABL and τ of the stroma.
    """

    process: AbstractProcess = eqx.field(static=True, default=DEPTH_RESOLVED)

    def solve(self, layers: Layers, light: Light, *, key: Any = None) -> Any:
        del key
        incidence, exits = light.cosine, light.exits
        assert incidence is not None
        assert exits is not None
        out, slant = exits.cosine, 1 / incidence + 1 / exits.cosine
        across = jnp.sqrt((1 - incidence**2) * (1 - out**2)) * jnp.cos(exits.azimuth)
        phase = rayleigh(across - incidence * out) / (4 * jnp.pi)
        abl, stroma = (d[:, None] * slant for d in (layers.abl_absorption, layers.extinction))
        source = layers.stroma_scattering[:, None] * jnp.exp(-abl) * mean_survival(stroma)
        brdf = source * phase / (incidence * out)
        return SimpleNamespace(brdf=brdf, status=outcome(layers.valid()))


class MarchedScene(eqx.Module):
    """The maps and the light that all pixels share.

    Attributes:
        maps: The subsurface map  [F09 Section 6.1]: those of the `IrisMaps` that are present.
        flux: Flux vectors of each light on a grid, see `incident_flux`.
        tint: `Lights.tint_factors`.
        eye: The eye.
    """

    maps: dict[str, Texture]
    flux: Float[Array, "lights 3 rows columns"]
    tint: Float[Array, "lights tints"]
    eye: Eye

    def at(self, point: Float[Array, "3 pixels"]) -> dict[str, Float[Array, " pixels"]]:
        """Interpolate the maps at points of the iris."""
        if not self.maps:
            return {}
        coordinates = IrisSurface(self.eye).texture_coordinates(point.T)
        values = polar_bilinear(jnp.stack(list(self.maps.values())), *coordinates)
        return dict(zip(self.maps, values, strict=True))


class MarchedResponse(AbstractResponse):
    """Layers of the uniform iris, through which rays are marched.

    Attributes:
        depths: Optical depths of absorption in the ABL and of extinction in the stroma: without
            melanin, of eumelanin, and of pheomelanin.
        scattering: Optical depth of scattering in the stroma.
        thickness: Thicknesses of ABL and stroma, mm.
        weights: Weights of the bands towards the picture's channels.
        n_steps: Number of steps in depth.
    """

    depths: tuple[Float[Array, "2 bands"], Float[Array, "2 bands"], Float[Array, "2 bands"]]
    scattering: Float[Array, " bands"]
    thickness: tuple[Float[Array, ""], Float[Array, ""]]
    weights: Float[Array, "channels bands"]
    n_steps: int = eqx.field(static=True)
    error: None = None
    status: None = None

    def shade(
        self, pixels: IrisPixels, texels: None, light: tuple[MarchedScene, Facing | None]
    ) -> Float[Array, "channels pixels"]:
        scene, facing = light
        return _march_rays((pixels, facing), self, scene)

    def layer_ends(self, local: dict[str, Array]) -> tuple[Array, Array]:
        """Return the depths at which ABL and stroma end, mm, from the maps' local values."""
        abl = local.get("abl_depth", self.thickness[0])
        return abl, abl + local.get("stroma_depth", self.thickness[1])

    def optical_depths(self, local: dict[str, Array]) -> tuple[Array, Array, Array]:
        """Return the optical depths of ABL and stroma, and that of scattering in the stroma, from
        the maps' local values; (bands, pixels) or (bands, 1).
        """
        ones = jnp.ones(1, self.scattering.dtype)
        without_melanin, *melanins = (depth[..., None] for depth in self.depths)
        eumelanin, pheomelanin = (local.get(n, ones) for n in ("eumelanin", "pheomelanin"))
        abl, stroma = without_melanin + melanins[0] * eumelanin + melanins[1] * pheomelanin
        abl_scale, stroma_scale = (
            local[f"{layer}_depth"] / thickness if f"{layer}_depth" in local else ones
            for layer, thickness in zip(("abl", "stroma"), self.thickness, strict=True)
        )
        abl_scale = abl_scale * (1 + (FRECKLE - 1) * local.get("freckles", 0 * ones))
        return abl * abl_scale, stroma * stroma_scale, self.scattering[:, None] * stroma_scale


@pixelwise
def _march_rays(
    pixels_and_facing: tuple[IrisPixels, Facing | None], iris: MarchedResponse, scene: MarchedScene
) -> Float[Array, "channels pixels"]:
    """Compute the radiance of pixels: ∫ E p(α) μ_s e^(−τ_light/μ_i − τ_view/μ_o) dz/μ_o, summed
    over the lights.
    """
    pixels, facing = pixels_and_facing
    n_steps = iris.n_steps if scene.maps else 1
    step = jnp.max(iris.layer_ends(scene.maps)[1]) / n_steps  # down to the thickest place
    point, direction = jnp.stack(pixels.point), jnp.stack(pixels.direction)
    flat = scene.eye.iris_normal(point.T).T
    slant = 1 / jnp.maximum(-(direction * flat).sum(0), 1e-3)
    along = direction * slant + flat  # offset along the iris per depth
    sources = _sources(pixels, facing, direction, scene)

    def march(carry, k):
        clear, radiance = carry
        local = materialise(scene.at(point + along * ((k + 0.5) * step)))
        abl_end, end = iris.layer_ends(local)
        top, bottom = k * step, (k + 1) * step
        abl, stroma, scattering = iris.optical_depths(local)
        in_abl = _share_above(bottom, 0.0, abl_end) - _share_above(top, 0.0, abl_end)
        above = _share_above(top, abl_end, end)
        inside = _share_above(bottom, abl_end, end) - above
        in_abl, above, inside = materialise((in_abl, above, inside))
        clear = clear * jnp.exp(-abl * (in_abl * slant))
        crossed, light_depth = stroma * inside, abl + stroma * above

        def add_light(total, light):
            source, light_slant, tint = light
            survival = mean_survival(crossed * (light_slant + slant))
            arriving = jnp.exp(-light_depth * light_slant) * survival
            return total + tint[:, None, None] * (source * arriving), None

        zero = jnp.zeros_like(radiance)
        arriving = jax.lax.scan(add_light, zero, (*sources, scene.tint))[0]
        radiance = radiance + (clear * scattering) * (inside * slant) * arriving
        # The IPE absorbs a ray that reaches it, even if the stroma is thicker further on.
        clear = jnp.where(bottom < end, clear * jnp.exp(-crossed * slant), 0.0)
        return (clear, radiance), None

    clear = jnp.ones((iris.scattering.size, slant.size), slant.dtype)
    start = (clear, jnp.zeros((scene.tint.shape[1], *clear.shape), clear.dtype))
    radiance = jax.lax.scan(march, start, jnp.arange(n_steps, dtype=slant.dtype))[0][1]
    share = camera_share(pixels, scene.eye)
    if len(radiance) == 1:
        return (iris.weights @ radiance[0]) * share
    return jnp.einsum("cb,cbp->cp", iris.weights, radiance) * share


def _sources(
    pixels: IrisPixels,
    facing: Facing | None,
    direction: Float[Array, "3 pixels"],
    scene: MarchedScene,
):
    """Compute for each light and pixel, (lights, pixels), the irradiance of a surface that faces
    the light times the phase function (1/sr), and the slant 1/μ_i.
    """
    normal = jnp.stack(normal_at(pixels, scene.eye, facing))
    flat = scene.eye.iris_normal(from_parts(pixels.point)).T

    def of_light(flux):
        flux_vectors = flux_at(flux, scene.eye.iris_radius, pixels.point)
        power = norm(flux_vectors.T)
        towards = flux_vectors / jnp.where(power > 0, power, 1.0)
        cosine = -(towards * normal).sum(0)
        scattering_cosine = (towards * direction).sum(0)
        lit = (power > 0) & (cosine > 1e-3)
        phase = rayleigh(scattering_cosine) / (4 * jnp.pi)
        if facing is not None:
            power = power * facing.unshadowed(hiding_factor(-(towards * flat).sum(0), scene.eye))
        return jnp.where(lit, power * phase, 0.0), 1 / jnp.where(lit, cosine, 1.0)

    return jax.lax.map(of_light, scene.flux)


def _share_above(depth, start, end):
    """Return the share of a layer that lies above `depth`; 0 or 1 for a layer without thickness."""
    thickness = end - start
    is_empty = thickness <= 0
    share = jnp.clip((depth - start) / jnp.where(is_empty, 1.0, thickness), 0, 1)
    return jnp.where(is_empty, jnp.where(depth > start, 1.0, 0.0), share)
