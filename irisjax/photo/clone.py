"""An iris cloned from a photograph, stage by stage  [F09 Figs. 4, 5].

`Outlined → Posed → Flat → Shaped → Lit → Fitted → Coloured → Sampled`: each stage has the fields of
the one before and is made from it by one function. What a stage would find can be given by the
user.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float
from scipy import optimize

from irisjax._types import PRNGKey, Scalar
from irisjax.anatomy.eye import EYE_LIMITS, Cornea, Eye, Sclera, sclera_of
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.checks import Range, check_known
from irisjax.photo import pigments, texels
from irisjax.photo.light import (
    Lighting,
    find_lighting,
    find_shade,
    find_veil,
    in_shade,
    irradiance_of_iris,
)
from irisjax.photo.masks import cut_part, find_mirrored_face, part_geometry
from irisjax.photo.outlines import Boundaries, find_boundaries
from irisjax.photo.photograph import Colours, Ellipse, Mask, Photograph
from irisjax.photo.pose import Pose, find_pose
from irisjax.photo.register import SecondPhotograph, lay_on_first
from irisjax.photo.texels import OwnPigments
from irisjax.photo.texture import (
    Refraction,
    Unrefracted,
    follow_cells,
    follow_refraction,
    pixels_shown,
    unrefract,
)
from irisjax.photo.thickness import (
    BETA,
    SIGMA,
    Morphology,
    freckle_mask,
    generic_thickness,
    shape_maps,
    smooth_maps,
)
from irisjax.photo.white import WhiteOfEye, find_white
from irisjax.photo.windows import (
    NO_WHITE,
    WhiteSeen,
    Windows,
    average_maps,
    choose_pixels,
    iris_alone,
    make_windows,
    ring_radius,
)
from irisjax.render.bands import BAND_GRID, colour_bands
from irisjax.render.camera import CAMERA_LIMITS
from irisjax.render.environment import LUMINANCE, Environment
from irisjax.render.illumination import Illumination
from irisjax.render.integrators import refine_table
from irisjax.render.lights import Lights
from irisjax.render.outside import bulk_reflectance
from irisjax.render.picture import LitView, illuminate, respond, shade, surroundings, texture
from irisjax.render.project import View, project_visible, scatter_to_picture
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.refraction import direction_of
from irisjax.render.scene import ENVIRONMENT_LIGHTS, Scene
from irisjax.render.separable import Separable
from irisjax.render.single_scattering import SingleScattering, TabulatedSingleScattering
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps
from irisjax.transport.defaults import shipped_table
from irisjax.transport.ilit.exact import IlitExact

STAGES = ("outlines", "pose", "texture", "thickness", "pigments", "texels", "posterior")
"""Names of the stages in their order; `"pigments"` stands for `Lit` and `Fitted`."""
MEDIA = ("cornea-aqueous", "f09", "f09-melanin", "flat")
METHODS = ("least-squares", "simplex")
_SOLVER_ANGLES = 8  # of ILIT during the search: the posterior's logarithm errs by 0.04 (sd)
# Degrees of the table that a search by radiative transfer uses. It errs by up to 1 % of the
# brightest texel, while windows err by 4 % and more, and costs a quarter of a picture's table.
SEARCHED: Mapping[str, Any] = {"degrees": (6, 3, 4, 4), "angular": (2, 2, 1)}
FIBRILS = 57.0  # radius during the search, nm; the strength of their scattering is a free factor
_SATURATION = 0.95  # of the blood, as in the choroid and in the presets
_BLUR_WIDTHS = Range(0.05, 2.0, "mm")  # widths of the deconvolution that are compared
_BLUR_STEPS, _BLUR_TOLERANCE = 7, 0.1  # number of first trials; tolerance of the logarithm

_LEAST_DRAWN = 1e-9  # radiance of a white
LEAST_RESPONSE = 0.1
"""d ln luminance / d ln thickness below which a photograph says little about the thickness."""
_TIED = 2.0  # difference of log densities of maxima that are about as high
_BLUR_OF_PIXELS = 3.0  # width of a smoothstep that is as wide as a Gaussian of 0.67 pixels
_Arc = Float[np.ndarray, " count"]


class CloneSettings(NamedTuple):
    """Model and method of a clone.

    Attributes:
        media: `"f09"` gives cornea and chamber one refractive index, 1.376 [F09 Section 4.1.1];
            `"f09-melanin"` also gives the melanins F09's absorption; `"flat"` is for a picture of
            an iris with no cornea in front of it: painted, or a texture.
        iris_depth: Distance of the iris behind the corneal apex, mm.
        focal_px: Focal length in pixels, in place of the photograph's own.
        azimuth: Azimuth of the camera (radians), if it is known to which side the eye is tilted.
        sigma: Width of the deconvolution (mm) with `beta`; `None` chooses the one with which the
            rendering is nearest to the photograph.
        beta: β of Eq. 7 (mm); `None` takes the model's own response of brightness to thickness.
        method: Search for the pigments, one of `METHODS`.
        integrator: Model of light in the iris.
    """

    media: str = "cornea-aqueous"
    iris_depth: float = 3.6
    focal_px: float | None = None
    azimuth: float | None = None
    sigma: float | None = 0.5
    beta: float | None = None
    method: str = "least-squares"
    integrator: Separable | RadiativeIntegrator = Separable()


class Given(NamedTuple):
    """What the user gives in place of a stage's own result; `None` leaves it to the stage.

    Attributes:
        limbus: Outline of the limbus in pixels of the photograph.
        pupil: Outline of the pupil as it appears through the cornea.
        lights: Lamps, in place of those inferred from highlights.
        environment: Surroundings that light the eye.
        freckles: Mask of texels that belong to freckles.
        visible: Mask of texels that show the iris, in place of the search for lids, lashes and
            highlights.
        maps: Maps with the stroma's thickness, which the clone keeps.
        second: A photograph of the same eye, for example through crossed polarisers. Its texture
            gives the thickness; pigments and light are inferred from the first photograph.
        eye: Which of several eyes, as of `find_boundaries`.
        environment_lights: Number of lamps that stand for the environment.
    """

    limbus: Ellipse | None = None
    pupil: Ellipse | None = None
    lights: Lights | None = None
    environment: Environment | None = None
    freckles: Mask | None = None
    visible: Mask | None = None
    maps: IrisMaps | None = None
    second: Photograph | None = None
    eye: str | None = None
    environment_lights: int = ENVIRONMENT_LIGHTS


NOTHING = Given()  # every stage finds its own result


@dataclass(frozen=True)
class Outlined:
    """Stage 1: the outlines of limbus and pupil, in pixels of the photograph."""

    photograph: Photograph
    boundaries: Boundaries

    def crop(self) -> tuple[int, int, int, int]:
        """Return the part of the photograph that is used, about the limbus: its first and last
        column, its first and last row.
        """
        (x, y), side, _ = part_geometry(self.boundaries.limbus)
        rows, columns = self.photograph.shape
        across, down = (max(x, 0), min(x + side, columns) - 1), (max(y, 0), min(y + side, rows) - 1)
        return (*across, *down)


@dataclass(frozen=True)
class Posed(Outlined):
    """Stage 2: the camera, and the part of the photograph that it sees.

    Attributes:
        pose: Camera and eye, in pixels of `part`.
        view: What the camera sees of the eye.
        part: Linear pixels of the camera's picture.
        clear: Pixels of `part` that show the iris and nothing in front of it.
        reflected: Pixels of `part` in which a mirror image of the surroundings hides the iris.
        limbus: Outline of the limbus, in pixels of `part`.
        pupil: Outline of the pupil as it appears, in pixels of `part`.
        lids: Whether lids hide some of the iris.
        white: The white beside the iris, on the pixels of `part`; `None` if none is seen.
        second: The second photograph on the pixels of `part`.
    """

    pose: Pose
    view: View
    part: Colours
    clear: Mask
    reflected: Mask
    limbus: Ellipse
    pupil: Ellipse
    lids: bool
    white: WhiteOfEye | None
    second: SecondPhotograph | None


@dataclass(frozen=True)
class Flat(Posed):
    """Stage 3: the iris laid flat; `refraction` says where its texels appear in `part`."""

    refraction: Refraction
    texture: Unrefracted


@dataclass(frozen=True)
class Shaped(Flat):
    """Stage 4: freckles, and the stroma's thickness, at first by Eq. 7.

    Attributes:
        freckles: Mask of texels.
        estimate: Makes `morphology`, once: a clone whose texels have their own thickness never
            asks.
    """

    freckles: Bool[np.ndarray, "texels texels"]
    estimate: Callable[[], Morphology]

    @property
    def morphology(self) -> Morphology:
        """Freckles and one thickness for all pigments."""
        return self.estimate()


@dataclass(frozen=True)
class Lit(Shaped):
    """Stage 5: the light of the photograph, and its `tables` on the iris.

    Attributes:
        veil: Radiance of what the tear film mirrors over the iris, in the photograph's exposure;
            `None` where the environment is given, whose image is part of the model.
    """

    lighting: Lighting
    tables: Illumination | None
    veil: Float[np.ndarray, "3"] | None

    def unveiled(self) -> Colours:
        """Return the pixels without what the tear film mirrors of the room."""
        if self.veil is None:
            return self.part
        return np.maximum(self.part - self.veil * self.film(), 0).astype(np.float32)

    def film(self) -> Float[np.ndarray, "rows columns 1"]:
        """Return the reflectance of the tear film at each pixel."""
        seen = self.view.mirror
        if seen is None:
            return np.zeros((*self.clear.shape, 1), np.float32)
        return scatter_to_picture(seen, np.asarray(seen.reflectance)[:, None], self.clear.shape)


@dataclass(frozen=True)
class Fitted(Lit):
    """Stage 6: the pigments.

    Attributes:
        windows: Windows of an average iris (or of the given maps), whose colours are fitted.
        base: Iris that fixes everything but melanins and scattering.
        fit: The best pigments and camera.
        integrator: Model of light in the iris.
        shown: The same windows of the maps with which pictures of the clone are drawn.
        exposure: Exposures of the three channels with which a picture of the clone is as bright as
            the photograph. The posterior's exposure is that of an iris with an average relief.
    """

    windows: Windows
    base: Iris
    fit: pigments.PigmentFit
    integrator: Separable | RadiativeIntegrator
    shown: Windows
    exposure: Float[np.ndarray, "3"]

    def with_fit(self, fit: pigments.PigmentFit) -> "Fitted":
        """Return the stage with another maximum of the posterior."""
        exposure = pigments.exposures_for(fit, self.shown, self.base)
        return dataclasses.replace(self, fit=fit, exposure=exposure)

    def iris(self) -> Iris:
        """Return the iris of the fitted pigments."""
        return self.fit.iris(self.base)

    def scene(self) -> Scene:
        """Return the eye as it was photographed: the same camera, light and pigments."""
        return self.scene_with(self.maps())

    def scene_with(self, maps: IrisMaps | None) -> Scene:
        """Return the scene with other maps, or without any."""
        light, room = self.lighting, self.fit.values["room"]
        marched = isinstance(self.integrator, TabulatedSingleScattering)
        camera = self.pose.camera
        if self.veil is not None:  # of a room as bright as the model's the camera sees a share
            camera = dataclasses.replace(camera, images=jnp.asarray(self._images()))
        return Scene(
            self.iris(),
            maps,
            eye=self.pose.eye,
            lights=light.lamps,
            environment=light.surroundings(room),
            camera=camera,
            integrator=SingleScattering() if marched else self.integrator,
            environment_lights=light.environment_lights,
        )

    def maps(self) -> IrisMaps:
        """Return the maps of the iris."""
        return self.morphology.maps

    def mirrored(self) -> float:
        """Return the radiance of the room that the tear film mirrors in the scene's picture."""
        return 0.0 if self.veil is None else self._images() * self._bright()

    def _images(self) -> float:
        """Return the share of what the tear film mirrors with which it is as bright as in the
        photograph, at most what a camera may have.
        """
        if self.lighting.exposure is not None:
            share = float((self.lighting.exposure / self.exposure).mean())
            return min(share, CAMERA_LIMITS["images"].high)
        veil, bright = float((self.veil / self.exposure).mean()), self._bright()
        return min(veil, bright) / max(bright, 1e-9)

    def _bright(self) -> float:
        light = self.lighting
        assert light.room or light.environment is not None
        around = None if light.room else light.environment
        return self.fit.values["room"] if around is None else float(around.radiance.mean())


@dataclass(frozen=True)
class Coloured(Fitted):
    """Stage 7: the iris with pigments and thickness of every texel; `texels` is `None` where the
    thickness was given, is by Eq. 7 or that of a second photograph.
    """

    texels: OwnPigments | None

    def iris(self) -> Iris:
        """Return the iris that the maps are relative to."""
        return super().iris() if self.texels is None else self.texels.iris

    def maps(self) -> IrisMaps:
        """Return the maps of the iris."""
        return super().maps() if self.texels is None else self.texels.maps

    def abl_melanin(self) -> tuple[float, float, float] | None:
        """Return the mean concentration of the ABL's melanin by the texels (mg/ml) and its 95 %
        interval; `None` without texels or colours.
        """
        if self.texels is None or self.photograph.grey:
            return None
        mean = self.texels.abl_melanin(self.pose.eye)
        # As if all texels had the same error. They do share what the fit does not know: blood,
        # white balance, room.
        sd = math.hypot(self.texels.melanin_sd, pigments.sd_of_abl_melanin(self.fit))
        return mean, mean * math.exp(-1.96 * sd), mean * math.exp(1.96 * sd)


@dataclass(frozen=True)
class Sampled(Coloured):
    """Stage 8: the posterior of the pigments of the whole iris."""

    posterior: pigments.PigmentPosterior


class PictureDifference(NamedTuple):
    """Photograph and rendering through one camera.

    Attributes:
        photograph: sRGB-encoded, as it was taken.
        rendered: sRGB-encoded picture of the clone, with the exposure, white balance and contrast
            of the photograph.
        pigments: The same without the map of what the model cannot say.
        clear: Pixels that are compared: those of the iris that nothing hides.
        rms: Root mean square of the differences per channel, of the full range.
        rms_of_pigments: The same of `pigments`.
        balanced: The photograph as the scene's picture shows it: sRGB-encoded, its white balance
            and contrast removed.
    """

    photograph: Colours
    rendered: Colours
    pigments: Colours
    clear: Mask
    rms: Float[np.ndarray, "3"]
    rms_of_pigments: Float[np.ndarray, "3"]
    balanced: Colours

    def arc(self, clone: Flat, radius: float, count: int = 720) -> tuple[_Arc, _Arc, _Arc]:
        """Return the angles (degrees) of `count` places on a circle of the clone's iris, `radius`
        in mm, and the encoded luminance there in photograph and rendering; NaN where a pixel is not
        clear.
        """
        size, texel = len(clone.texture.valid), clone.texture.millimetres_per_texel
        angle, middle = np.arange(count) * (2 * np.pi / count), size / 2 - 0.5
        column = np.rint(middle + radius * np.cos(angle) / texel).astype(int)
        row = np.rint(middle - radius * np.sin(angle) / texel).astype(int)
        there = clone.refraction.pixels((row, column), self.clear.shape)
        photograph, rendered = (
            np.where(self.clear[there], picture[there] @ np.array(LUMINANCE), np.nan)
            for picture in (self.photograph, self.rendered)
        )
        return np.degrees(angle), photograph, rendered


def clone_eye(
    photograph: Photograph,
    settings: CloneSettings,
    given: Given = NOTHING,
    *,
    last: str = STAGES[-1],
    stage: Callable[[str], AbstractContextManager[Any]] = lambda name: nullcontext(),
    tables: Callable[[Scene], Illumination | None] = Scene.tables,
    key: PRNGKey | None = None,
) -> Iterator[Outlined]:
    """Run the stages up to `last` and yield the result of each.

    Args:
        photograph: A linear photograph, of `io.read_photograph`.
        settings: Model and method.
        given: What replaces the stages' own results.
        last: Name of the last stage, one of `STAGES`.
        stage: Makes a context that is entered with a stage's name while that stage runs.
        tables: Makes the tables of light on the iris, or reads them from a file.
        key: Key of the posterior's random numbers; `None` if no posterior is sampled.

    Raises:
        ValueError: If a stage finds nothing, with a message of one line, and for unknown names.
    """
    check_known("media", settings.media, MEDIA)
    check_known("method", settings.method, METHODS)
    check_known("stage", last, STAGES)
    light = settings.integrator
    if isinstance(light, RadiativeIntegrator) and light.solver is None:
        index = _eye_with(settings.media).aqueous_index
        if shipped_table(Iris().indices(index)) is None:
            raise ValueError(
                f"radiative transfer has no table for the refractive indices of media "
                f"{settings.media}, which a fit needs: give --process ilit-2006 or other --media"
            )
    made: dict[str, Callable[[Any], Outlined]] = {
        "outlines": lambda found: outline_eye(found, given),
        "pose": lambda found: pose_eye(found, settings, given),
        "texture": lambda found: flatten_iris(found, given),
        "thickness": lambda found: shape_iris(found, settings, given),
        "pigments": lambda found: fit_clone(light_eye(found, given, tables), settings, given),
        "texels": lambda found: colour_texels(found, settings, given),
        "posterior": lambda found: sample_clone(found, key=cast(PRNGKey, key)),
    }
    found = photograph
    for name in STAGES[: STAGES.index(last) + 1]:
        with stage(name):
            found = made[name](found)
        yield found


def outline_eye(photograph: Photograph, given: Given = NOTHING) -> Outlined:
    """Find the outlines of limbus and pupil."""
    found = find_boundaries(photograph, given.limbus, given.pupil, given.eye)
    return Outlined(photograph, found)


def pose_eye(outlined: Outlined, settings: CloneSettings, given: Given = NOTHING) -> Posed:
    """Find the camera, and cut out the part of the photograph that it sees."""
    photograph, boundaries = outlined.photograph, outlined.boundaries
    focal = photograph.focal_px if settings.focal_px is None else settings.focal_px
    part = cut_part(photograph, boundaries.limbus)
    pupil = part.moved(boundaries.pupil)
    clear, lids, mirrored = part.clear(pupil)
    focal = None if focal is None else focal / part.reduction
    eye = _eye_with(settings.media).replace(iris_depth=settings.iris_depth)
    known: dict[str, Any] = {"focal_px": focal, "azimuth": settings.azimuth}
    spread = boundaries.flattening_sd
    pose = find_pose(part.limbus, pupil, eye, **known, flattening_sd=spread)
    pose = pose._replace(eye=_with_soft_edges(pose, boundaries))
    x, y = pose.corner
    rows, columns = pose.camera.shape
    if min(x, y) < 0 or y + rows > len(clear) or x + columns > len(clear):
        raise ValueError(
            "the outlines do not fit one another: the eye's middle lies off the limbus"
        )
    cut = slice(y, y + rows), slice(x, x + columns)
    view = project_visible(pose.eye, pose.camera, once=True)
    pixels, clear = part.pixels[cut], clear[cut]
    limbus = part.limbus.moved(-x, -y)
    if lids.any():
        clear = clear & ~find_mirrored_face(pixels, part.outside[cut], limbus, view.mirror)
    white = None
    if clear.any():
        try:
            white = find_white(part, boundaries.limbus_width, pixels[clear])
            white = white._replace(pixels=white.pixels[cut])
        except ValueError:
            pass  # none is seen
    second = None
    if given.second is not None:
        second = lay_on_first(given.second, photograph, boundaries.limbus, boundaries.pupil, cut)
    known: dict[str, Any] = {"pose": pose, "view": view, "part": pixels, "clear": clear}
    known |= {"limbus": limbus, "pupil": pupil.moved(-x, -y), "reflected": mirrored[cut]}
    return Posed(**vars(outlined), **known, lids=bool(lids.any()), white=white, second=second)


def flatten_iris(posed: Posed, given: Given = NOTHING) -> Flat:
    """Lay the iris flat; the texture comes from the second photograph if there is one."""
    part, clear = posed.part, posed.clear
    if posed.second is not None:
        part, clear = posed.second.part, posed.second.clear
    if given.visible is not None:
        clear = pixels_shown(posed.view, given.visible, clear.shape)
        posed = dataclasses.replace(posed, clear=clear)
    refraction = follow_refraction(posed.pose)
    texture = unrefract(part, clear, posed.pose, refraction)
    return Flat(**vars(posed), refraction=refraction, texture=texture)


def shape_iris(flat: Flat, settings: CloneSettings, given: Given = NOTHING) -> Shaped:
    """Find freckles; the stroma's thickness is that of given maps or by Eq. 7."""
    texture, freckles = flat.texture, freckle_mask(flat.texture, given.freckles)
    beta = BETA if settings.beta is None else settings.beta
    sigma = SIGMA if settings.sigma is None else settings.sigma
    if given.maps is not None and given.maps.stroma_depth is None:
        raise ValueError("the maps that are given have no thickness of the stroma")

    @cache
    def estimate() -> Morphology:
        shape = shape_maps(texture, freckles, sigma_mm=sigma, beta=beta)
        if given.maps is None:
            return shape
        there = texture.from_polar(np.asarray(given.maps.stroma_depth))
        return shape._replace(maps=given.maps, thickness=there, clamped=0)

    return Shaped(**vars(flat), freckles=freckles, estimate=estimate)


def light_eye(
    shaped: Shaped,
    given: Given = NOTHING,
    tables: Callable[[Scene], Illumination | None] = Scene.tables,
) -> Lit:
    """Infer the light from highlights, or take the given one, and tabulate it on the iris."""
    pose = shaped.pose
    if given.lights is None and given.environment is None:
        seen = shaped.part, shaped.limbus, shaped.pupil, shaped.reflected
        light = find_lighting(*seen, pose, shaped.view)
    else:
        count = given.environment_lights
        light = Lighting(given.lights, given.environment, environment_lights=count)
    # Tables depend on the lowest light, and a room shines from all round.
    around = Environment.uniform() if light.room else light.environment
    scene = Scene(Iris(), eye=pose.eye, lights=light.lamps, environment=around)
    veil = None
    if light.room or given.environment is None or given.environment.is_uniform():
        veil = find_veil(shaped.part, shaped.clear, shaped.pupil, shaped.view)
    return Lit(**vars(shaped), lighting=light, tables=tables(scene), veil=veil)


def fit_clone(lit: Lit, settings: CloneSettings, given: Given = NOTHING) -> Fitted:
    """Fit the pigments of an average iris, or of the given maps; the thickness is then estimated by
    the response of the model with these pigments  [F09 Fig. 10].
    """
    eye, light = lit.pose.eye, lit.lighting
    clear = lit.clear & iris_alone(lit.view)
    clear[lit.refraction.pixels(lit.freckles, clear.shape)] = False
    # The veil of a room beside lamps tells how bright it is; of one that is assumed it is no model.
    alone = light.lamps is None and not light.room and lit.veil is not None
    pixels = lit.unveiled() if alone else lit.part
    around = None if alone or light.room else light.environment
    # The light on the iris is not known where lids shade it.
    known_light = None if lit.lids or lit.view.iris is None else _light_on_iris(lit)
    chosen = choose_pixels(pixels, clear, lit.view, eye, around, known_light)
    maps = average_maps(eye) if given.maps is None else given.maps
    depth = jnp.mean(jnp.asarray(maps.stroma_depth))
    base = usual_iris(depth)
    if settings.media == "f09-melanin":
        base = base.replace(absorption="f09")
    integrator = settings.integrator
    if isinstance(integrator, Separable):
        integrator = dataclasses.replace(integrator, solver=IlitExact(_SOLVER_ANGLES))
    elif isinstance(integrator, RadiativeIntegrator):
        integrator = dataclasses.replace(integrator, **SEARCHED)

    def windows_with(maps: IrisMaps, turned: bool = False) -> Windows:
        known = light.lights(), integrator, lit.tables, light.room, turned
        made = make_windows(chosen, eye, base, maps.replace(freckles=None), *known)
        known = {"white": _white_seen(lit)}
        if light.exposure is not None:
            told = np.asarray(light.exposure), np.asarray(light.burnt_out)
            known |= {"exposure": told[0], "at_least": told[1]}
        return dataclasses.replace(made, **known)

    windows = windows_with(maps, turned=given.maps is None)
    search = pigments.simplex if settings.method == "simplex" else pigments.fit_pigments
    fit = with_visible_thickness(search(windows, base), windows.thickness_response, base)

    known: dict[str, Any] = {"windows": windows, "base": base, "fit": fit}
    known["integrator"] = settings.integrator

    def fitted(estimate: Callable[[], Morphology]) -> Fitted:
        shown = windows
        if given.maps is None:
            own = has_texels(settings, given)
            shown = windows_with(smooth_maps(eye) if own else estimate().maps)
        kept = dataclasses.replace(lit, estimate=estimate)
        exposure = pigments.exposures_for(fit, shown, base)
        return Fitted(**vars(kept), **known, shown=shown, exposure=exposure)

    if given.maps is not None or (settings.beta is not None and settings.sigma is not None):
        return fitted(lit.estimate)
    if settings.beta is None:
        found = partial(_thickness_by_model, lit, windows, base, fit)
        return fitted(cache(found))
    deconvolve = partial(shape_maps, lit.texture, lit.freckles, beta=settings.beta)

    def deconvolved(width: float) -> Fitted:
        return fitted(cache(partial(deconvolve, sigma_mm=width)))

    return deconvolved(width_by_rendering(deconvolved))


def usual_iris(stroma_thickness: ArrayLike) -> Iris:
    """Return the iris that fixes what is not fitted: the thickness of its stroma (mm) is given."""
    fixed = {"fibril_radius": FIBRILS, "saturation": _SATURATION}
    return Iris().replace(stroma_thickness=stroma_thickness, **fixed)


def has_texels(settings: CloneSettings, given: Given) -> bool:
    """Return whether texels get a thickness and pigments of their own: not where the thickness is
    given, by Eq. 7 or that of a second photograph.
    """
    return given.maps is None and given.second is None and settings.beta is None


def colour_texels(fitted: Fitted, settings: CloneSettings, given: Given = NOTHING) -> Coloured:
    """Solve every texel for its own pigments and thickness if it `has_texels`; if not, the iris
    keeps one pair of melanins. The white of the eye gets the tint that the photograph shows.
    """
    if not has_texels(settings, given):
        return Coloured(**vars(_with_white_as_seen(fitted)), texels=None)
    finest: Any = refine_table(fitted.integrator)
    fitted = dataclasses.replace(fitted, integrator=finest)
    shape, eye = fitted.clear.shape, fitted.pose.eye
    seen = fitted.view.iris
    assert seen is not None
    x, y = map(np.asarray, seen.point[:2])
    radius = scatter_to_picture(seen, np.hypot(x, y), shape)
    shown = fitted.clear & iris_alone(fitted.view)
    ring = scatter_to_picture(seen, ring_radius(eye, x, y), shape)
    clear = shown & (ring > float(eye.pupil_radius + eye.pupil_margin))
    usual = np.log(generic_thickness(radius) / float(fitted.base.stroma_thickness))
    light = _light_on_iris(fitted, _room_beside_lamps(fitted, fitted.fit))
    shaded = clear & in_shade(light, clear)
    # Windows tell the colours of rings. Of the maxima that explain these, the highest is taken
    # whose iris can make the colours of pixels too, or else the one that is nearest to them.
    trials = []
    for fit in fitted.fit.maxima():
        trial = fitted.with_fit(fit)
        known = trial.scene_with(None), trial.view, trial.tables, trial.exposure
        coarse = texels.solve_coarse(_iris_light(trial), clear, shaded, usual, *known)
        trials.append((trial, coarse))
        if coarse.is_within:
            break
    fitted, coarse = min(trials, key=lambda trial: (not trial[1].is_within, trial[1].error))
    cells_of = partial(follow_cells, fitted.pose, fitted.refraction)
    doubt = pigments.doubt_of_exposures(fitted.fit)
    found = texels.colour_iris(coarse, shown, doubt, cells_of)
    exposure = fitted.exposure * found.gain ** fitted.fit.values["contrast"]
    exposed = dataclasses.replace(fitted, exposure=exposure)
    return Coloured(**vars(_with_white_as_seen(exposed)), texels=found)


def _iris_light(fitted: Fitted) -> Colours:
    """Return the radiance of the iris in the photograph, without what the tear film mirrors."""
    target, shape = fitted.unveiled() / fitted.exposure, fitted.clear.shape
    if fitted.veil is None:
        dark = fitted.scene_with(None).replace(iris=fitted.base)
        around = np.asarray(surroundings(fitted.view, texture(fitted.view, dark), dark))
        target = target - around.T.reshape(*shape, 3)
    return np.maximum(target, 0) ** (1 / fitted.fit.values["contrast"])


def tint_of_white(
    white: Mask, radiance: Colours, view: View, scene: Scene
) -> Float[np.ndarray, "3"]:
    """Return the `Sclera.tint` with which the white of a scene that has none is, in the median of
    some pixels, as it is in a picture of radiances; the nearest that is allowed, where hardly any
    light falls or no tint is as saturated.
    """
    scene = scene.replace(camera=dataclasses.replace(scene.camera, images=jnp.asarray(0.0)))
    drawn = np.asarray(surroundings(view, texture(view, scene), scene)).T.reshape(radiance.shape)
    seen, drawn = (np.median(picture[white], axis=0) for picture in (radiance, drawn))
    # The colour is linear in the tint, whose three parts overlap in the channels of a picture.
    of_tint = np.asarray(_colours_of_tints(sclera_of(scene.eye), scene.illuminant))
    wanted = seen / np.maximum(drawn, _LEAST_DRAWN) * of_tint.sum(1)
    limits = EYE_LIMITS["tint"]
    return np.clip(np.linalg.solve(of_tint, wanted), limits.low, limits.high)


@eqx.filter_jit
def _colours_of_tints(sclera: Sclera, illuminant: str) -> Float[Array, "channels 3"]:
    """Return the colour that a white has by each part of its tint alone."""
    weights = colour_bands(illuminant, all_wavelengths=True).weights
    tinted = [dataclasses.replace(sclera, tint=one) for one in np.eye(3)]
    return jnp.stack([weights @ bulk_reflectance(one, BAND_GRID) for one in tinted], axis=-1)


def sample_clone(fitted: Coloured, *, key: PRNGKey) -> Sampled:
    """Sample the posterior of the pigments."""
    posterior = pigments.sample_pigments(fitted.windows, fitted.base, fitted.fit, key=key)
    return Sampled(**vars(fitted), posterior=posterior)


def compare_with_photograph(clone: Fitted) -> PictureDifference:
    """Render a clone with its photograph's camera and compare the two."""
    scene, view, exposure = clone.scene(), clone.view, clone.exposure
    contrast, found = clone.fit.values["contrast"], texture(view, scene)
    own, response = clone.texels if isinstance(clone, Coloured) else None, respond(scene)
    if own is None:
        light = illuminate(view, found, scene, clone.tables)
    else:  # as for the texels
        light = LitView(surroundings(view, found, scene), own.light)
    bare = dataclasses.replace(found, residual=None)
    shown = [np.asarray(shade(view, parts, light, response)) for parts in (found, bare)]
    veil = 0 if clone.veil is None else clone.veil * clone.film()
    room = clone.mirrored() * clone.film()  # in the scene's picture, of all channels alike
    # The camera records exposure × radiance^contrast, and the veil.
    taken = [exposure * np.maximum(p - room, 0) ** contrast + veil for p in shown]
    balanced = (clone.unveiled() / exposure) ** (1 / contrast) + room
    linear = clone.part, *taken, exposure[1] * balanced
    photograph, rendered, alone, even = (np.clip(np.asarray(srgb_encode(p)), 0, 1) for p in linear)
    clear = clone.clear & iris_alone(clone.view)
    rms, of_pigments = (np.sqrt(((photograph - p)[clear] ** 2).mean(0)) for p in (rendered, alone))
    return PictureDifference(photograph, rendered, alone, clear, rms, of_pigments, even)


def width_by_rendering(with_width: Callable[[float], Fitted]) -> float:
    """Return the width (mm) of the deconvolution with which the picture of the clone is nearest to
    the photograph, in root mean square over all channels  [F09 Section 4.2.1].

    The best of seven widths is found first, then the best between its neighbours: where fibres are
    finer than the blur, the difference is flat over most widths and has several minima.
    """

    def difference(logarithm: Any) -> float:
        width = float(np.clip(np.exp(np.squeeze(logarithm)), _BLUR_WIDTHS.low, _BLUR_WIDTHS.high))
        return float(np.sqrt((compare_with_photograph(with_width(width)).rms ** 2).mean()))

    low, high = np.log([_BLUR_WIDTHS.low, _BLUR_WIDTHS.high])
    trials = optimize.brute(difference, ((low, high),), Ns=_BLUR_STEPS, finish=None)
    best, step = float(np.squeeze(trials)), (high - low) / (_BLUR_STEPS - 1)
    bounds, options = (max(best - step, low), min(best + step, high)), {"xatol": _BLUR_TOLERANCE}
    found = optimize.minimize_scalar(difference, bounds=bounds, method="bounded", options=options)
    return float(np.exp(found.x if found.fun < difference(best) else best))


def _eye_with(media: str) -> Eye:
    if media == "flat":
        return Eye().replace(cornea=None)
    eye = Eye(sclera=Sclera(gloss=jnp.asarray(0.0)))  # a clone has no lids to hide images there
    return eye.replace(cornea=Cornea.f09(), aqueous_index=1.376) if media.startswith("f09") else eye


def _with_soft_edges(pose: Pose, outlines: Boundaries) -> Eye:
    """The eye with edges as soft as the outlines and the photograph's own blur: it samples one
    point.
    """
    eye, pixel = pose.eye, float(pose.camera.width) / pose.camera.size[0]
    pupil, limbus = float(eye.pupil_radius), float(eye.limbus_radius)
    if outlines.pupil_margin is not None:
        margin = outlines.pupil_margin * pupil
        # Blur lets the rise begin earlier: its middle stays.
        soft = float(np.hypot(margin, _BLUR_OF_PIXELS * pixel))
        eye = eye.replace(pupil_margin=soft, pupil_radius=pupil - (soft - margin) / 2)
    if outlines.limbus_width is not None:
        eye = eye.replace(limbus_width=max(outlines.limbus_width * limbus, pixel))
    return eye


def _room_beside_lamps(lit: Lit, fit: pigments.PigmentFit) -> float:
    """Return the fitted radiance of the room; 0 where the light has none beside its lamps."""
    return fit.values["room"] if lit.lighting.room else 0.0


def _light_on_iris(lit: Lit, room: float = 0.0) -> np.ndarray:
    """Return the irradiance of the iris at each pixel of the part, by lamps and a room of some
    radiance.
    """
    seen = lit.view.iris
    assert seen is not None
    x, y = map(np.asarray, seen.point[:2])
    lights, eye = lit.lighting.lights(), lit.pose.eye
    irradiance = irradiance_of_iris(x, y, lights, room, eye, lit.tables)
    return scatter_to_picture(seen, irradiance, lit.pose.camera.shape)


def _white_seen(lit: Lit) -> WhiteSeen:
    """Return what the white tells of exposure and light: nothing where it is burnt out or a channel
    of it is black.
    """
    white, lights = lit.white, lit.lighting.lights()
    if white is None or white.is_burnt or white.sides.min() <= 0 or lit.photograph.grey:
        return NO_WHITE
    camera = lit.pose.camera
    facing_camera = _irradiance_from(lights, camera.polar, camera.azimuth)
    light = np.broadcast_to(np.asarray(facing_camera, np.float64) / np.pi, 3)
    reflectance, root = white.median_and_root()
    return WhiteSeen(white.sides.mean(0), reflectance, light, root)


@eqx.filter_jit
def _irradiance_from(lights: Lights, polar: Scalar, azimuth: Scalar) -> Float[Array, " tints"]:
    """Compute the irradiance of a surface at the eye that faces a direction, for each tint."""
    return lights.irradiance_on(direction_of(polar, azimuth))


def _with_white_as_seen(fitted: Fitted) -> Fitted:
    """The eye with a white as the photograph shows it: lids and lashes, which a clone has not,
    shade it, and light for colours that the model cannot make is too strong for it.
    """
    pose, white = fitted.pose, fitted.white
    if white is None or fitted.view.sclera is None or pose.eye.sclera is None:
        return fitted
    radiance = (fitted.unveiled() / fitted.exposure) ** (1 / fitted.fit.values["contrast"])
    tint = tint_of_white(white.pixels, radiance, fitted.view, fitted.scene_with(None))
    eye = pose.eye.replace(sclera=dataclasses.replace(pose.eye.sclera, tint=tint))
    return dataclasses.replace(fitted, pose=pose._replace(eye=eye))


def with_visible_thickness(
    fit: pigments.PigmentFit, response: Callable[[Iris], float], base: Iris
) -> pigments.PigmentFit:
    """Return the fit, or another maximum that is about as high if thickness hardly shows in the
    fitted iris, by its response to it, and shows in that one: windows tell the colours of rings,
    but not that there are fibres.
    """
    for one in fit.maxima() if fit.others else ():
        if one.log_density < fit.log_density - _TIED:
            break
        if response(one.iris(base)) >= LEAST_RESPONSE:
            return one
    return fit


def _thickness_by_model(
    lit: Lit, windows: Windows, base: Iris, fit: pigments.PigmentFit
) -> Morphology:
    """Thickness by the model's response of luminance to thickness."""
    eye, texture, freckles = lit.pose.eye, lit.texture, lit.freckles
    iris = usual = fit.iris(base)
    if pigments.misfits(fit, windows):  # the fitted iris is not one to estimate the thickness with
        medians = pigments.parameter_values(np.zeros(len(pigments.FREE_NAMES)))
        usual = pigments.iris_of_concentrations(medians, base)
    shade = darkness = None
    if lit.second is None:  # the light of a second photograph is not known
        room = _room_beside_lamps(lit, fit)
        shade = find_shade(texture, lit.lighting.lights(), room, eye, lit.tables)
    if freckles.any():
        shares = np.linspace(0, 1, 21) ** 2
        darkness = np.stack([shares, windows.freckle_response(iris, shares)])
    known: dict[str, Any] = {"response": windows.thickness_response(usual), "sigma_mm": 0.0}
    return shape_maps(texture, freckles, shade=shade, darkness=darkness, **known)
