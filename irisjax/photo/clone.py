"""A photograph turned into an iris, stage by stage  [F09 Figs. 4, 5].

Outlines, pose, the iris laid flat, its thickness, its pigments: each stage is a function of those
before, and what it found can be replaced by the user's own.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np
import skimage.measure
import skimage.transform
from jaxtyping import Bool, Float

from irisjax.anatomy.eye import Cornea, Eye
from irisjax.photo.boundaries import Boundaries, find_boundaries
from irisjax.photo.ellipse import Ellipse
from irisjax.photo.highlights import find_highlights, find_lashes, find_lids
from irisjax.photo.lamps import lamps_of, tangent_of
from irisjax.photo.morphology import Morphology, maps_of
from irisjax.photo.photograph import Photograph
from irisjax.photo.pigments import Fit, iris_of, least_squares, simplex
from irisjax.photo.polar import to_polar
from irisjax.photo.pose import Pose, find_pose
from irisjax.photo.posterior import PigmentPosterior, sample
from irisjax.photo.refraction import SIZE, follow, unrefract
from irisjax.photo.thickness import BETA, generic_thickness
from irisjax.photo.unrefracted import Unrefracted
from irisjax.photo.windows import Windows, windows_of
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable
from irisjax.tissue.iris import Iris

STAGES = ("outlines", "pose", "texture", "thickness", "pigments", "posterior")
"""In their order."""
MEDIA = ("cornea-aqueous", "f09")
METHODS = ("least-squares", "simplex")
LARGEST = 1100
"""Pixels across the iris that are used; more are averaged."""
LEAST_RESPONSE = 0.4
"""Of luminance to thickness, as powers: below it, in brown eyes, brightness tells pigment."""
RELIEF = 0.3
"""Share of a stroma's unevenness that stands out towards the cornea, as in `grow.procedural`."""
FIBRILS = 57.0
"""Radius of the stroma's fibrils (nm) that colours begin with: between those of the presets'
blue and brown eyes. Its scattering is free within a factor."""


class Settings(NamedTuple):
    """What a clone is made with.

    - `media`: `"f09"` gives cornea and chamber one index, 1.376 [F09 Section 4.1.1].
    - `iris_depth`: behind the corneal apex, mm. `focal_px`: in place of the photograph's own.
    - `azimuth`: of the camera (radians), where it is known to which side the eye is tilted.
    - `sigma`: of the deconvolution, mm; `beta`: of Eq. 7 (mm), `None` asks the model instead how
        much brighter a thicker stroma is.
    - `method`: least squares, or the paper's simplex. `process`: of light in the iris.
    - `steps`: most steps of the posterior's chain. `seed`: of all random numbers.
    """

    media: str = "cornea-aqueous"
    iris_depth: float = 3.6
    focal_px: float | None = None
    azimuth: float | None = None
    sigma: float = 0.5
    beta: float | None = None
    method: str = "least-squares"
    integrator: Separable | RadiativeIntegrator = Separable()
    steps: int = 3000
    seed: int = 0


class Given(NamedTuple):
    """What the user gives in place of what a stage would find; `None` leaves it to the stage."""

    limbus: Ellipse | None = None
    pupil: Ellipse | None = None
    lights: Lights | None = None
    freckles: Bool[np.ndarray, "size size"] | None = None


NOTHING = Given()
"""Every stage finds what it finds."""


class Clone(NamedTuple):
    """All that was found; stages that did not run leave `None`.

    - `boundaries`: outlines in pixels of the photograph, with confidences.
    - `pose`: in pixels of the part that is used, `part`, (rows, columns, 3) linear; one of its
        pixels is `reduction` of the photograph's along each side, and `corner` the first of these.
    - `clear`: pixels of the part that show the iris and nothing else.
    - `response`: d ln luminance / d ln thickness by which the thickness was told; `None` where
        Eq. 7 did.
    - `lights`: given, or from the highlights on the cornea: `lights_found` says how many.
    """

    photograph: Photograph
    boundaries: Boundaries
    pose: Pose | None = None
    part: Float[np.ndarray, "rows columns 3"] | None = None
    clear: Bool[np.ndarray, "rows columns"] | None = None
    reduction: int = 1
    corner: tuple[int, int] = (0, 0)
    texture: Unrefracted | None = None
    morphology: Morphology | None = None
    lights: Lights | None = None
    lights_found: int | None = None
    windows: Windows | None = None
    base: Iris | None = None
    integrator: Separable | RadiativeIntegrator = Separable()
    response: float | None = None
    fit: Fit | None = None
    log: tuple[dict[str, float], ...] = ()
    posterior: PigmentPosterior | None = None

    def iris(self) -> Iris:
        """The iris of the fitted pigments. **Raises:** `ValueError` before they are known."""
        values = _needed(self.fit).values
        return iris_of({k: jnp.asarray(v) for k, v in values.items()}, _needed(self.base))

    def room(self) -> Environment | None:
        """Light from all round beside the lamps, where these were told from highlights."""
        if not self.lights_found:
            return None
        around = Environment.uniform()
        return Environment(_needed(self.fit).values["room"] * around.radiance)

    def scene(self) -> Scene:
        """The eye as it was photographed: the same camera, light and pigments.

        **Raises:** `ValueError` before the pigments are known.
        """
        iris, pose = self.iris(), _needed(self.pose)
        return Scene(
            iris,
            _needed(self.morphology).maps,
            eye=pose.eye,
            lights=self.lights,
            environment=self.room(),
            camera=pose.camera,
            integrator=self.integrator,
        )


def clone(
    photograph: Photograph,
    settings: Settings,
    given: Given = NOTHING,
    *,
    last: str = STAGES[-1],
    stage: Callable[[str], AbstractContextManager[Any]] = lambda name: nullcontext(),
) -> Iterator[Clone]:
    """Run the stages up to `last`; what is known after each is yielded.

    Args:
        photograph: Linear; of `io.read_photograph`.
        settings: What a clone is made with.
        given: In place of what stages would find.
        last: Name of the last stage.
        stage: Is entered with a stage's name for as long as it takes.

    Raises:
        ValueError: If a stage finds nothing, in one line.
    """
    check_names(settings, last)
    with stage(STAGES[0]):
        found = Clone(photograph, find_boundaries(photograph, given.limbus, given.pupil))
    yield found
    steps = (_posed, _flat, _with_thickness, _with_pigments, _sampled)
    for name, step in zip(STAGES[1:], steps, strict=True):
        if STAGES.index(name) > STAGES.index(last):
            return
        with stage(name):
            found = step(found, settings, given)
        yield found


def check_names(settings: Settings, last: str = STAGES[-1]) -> None:
    """Raise `ValueError` for media, methods and stages that do not exist."""
    for value, known, what in (
        (settings.media, MEDIA, "media"),
        (settings.method, METHODS, "method"),
        (last, STAGES, "stage"),
    ):
        if value not in known:
            raise ValueError(f"unknown {what} {value!r}; known: {', '.join(known)}")


def _flat(found: Clone, settings: Settings, given: Given) -> Clone:
    """With the iris laid flat."""
    del settings, given
    part, clear, pose = _needed(found.part), _needed(found.clear), _needed(found.pose)
    return found._replace(texture=unrefract(part, clear, pose, SIZE))


def _with_thickness(found: Clone, settings: Settings, given: Given) -> Clone:
    """With a coarse thickness by Eq. 7."""
    beta = BETA if settings.beta is None else settings.beta
    texture = _needed(found.texture)
    return found._replace(
        morphology=maps_of(texture, given.freckles, sigma_mm=settings.sigma, beta=beta)
    )


def _sampled(found: Clone, settings: Settings, given: Given) -> Clone:
    """With a posterior of its pigments."""
    del given
    known = _needed(found.windows), _needed(found.base), _needed(found.fit)
    return found._replace(posterior=sample(*known, max_steps=settings.steps, seed=settings.seed))


T = TypeVar("T")


def _needed(part: T | None) -> T:
    """What an earlier stage found."""
    if part is None:
        raise ValueError("an earlier stage has not run")
    return part


def eye_of(settings: Settings) -> Eye:
    """The eye of these media and this depth, its pupil not yet known."""
    if settings.media == "f09":
        return Eye(cornea=Cornea.f09(), aqueous_index=1.376, iris_depth=settings.iris_depth)
    return Eye(iris_depth=settings.iris_depth)


def _posed(found: Clone, settings: Settings, given: Given) -> Clone:
    """With the camera, and the part of the photograph that it sees."""
    del given
    eye = eye_of(settings)
    photograph, limbus, pupil = found.photograph, found.boundaries.limbus, found.boundaries.pupil
    focal = photograph.focal_px if settings.focal_px is None else settings.focal_px
    reduction = max(1, math.ceil(2 * limbus.semi_axes[0] / LARGEST))
    # Wide enough for every pixel of the camera's picture.
    half = math.ceil(1.3 * limbus.semi_axes[0] / reduction + 4) * reduction
    corner = tuple(int(np.floor(c)) - half for c in limbus.centre)
    side = 2 * half

    def part_of(values, fill):
        first = [max(0, corner[1]), max(0, corner[0])]
        end = [min(n, c + side) for n, c in zip(values.shape, corner[::-1], strict=False)]
        whole = np.full((side, side, *values.shape[2:]), fill, values.dtype)
        rows, columns = (
            slice(a - c, b - c) for a, b, c in zip(first, end, corner[::-1], strict=True)
        )
        whole[rows, columns] = values[first[0] : end[0], first[1] : end[1]]
        return whole

    def moved(outline: Ellipse) -> Ellipse:
        x, y = outline.centre
        return outline._replace(centre=(x - corner[0], y - corner[1])).scaled(1 / reduction)

    pixels = part_of(photograph.pixels, np.float32(0))
    hidden = part_of(photograph.saturated, True)
    outside = part_of(np.zeros_like(photograph.saturated), True)
    small, dark = moved(limbus), moved(pupil)
    if reduction > 1:
        pixels = skimage.transform.downscale_local_mean(pixels, (reduction, reduction, 1))
        hidden, outside = (
            skimage.measure.block_reduce(m, (reduction, reduction), np.max)
            for m in (hidden, outside)
        )
    pixels = np.asarray(pixels, np.float32)
    ring = small.mask(hidden.shape) & ~dark.mask(hidden.shape)
    covered = find_highlights(pixels, hidden & ring, ring) | find_lashes(pixels, small)
    covered |= find_lids(pixels, small, dark)
    clear = ring & ~covered & ~outside
    pose = find_pose(
        small,
        dark,
        eye,
        focal_px=None if focal is None else focal / reduction,
        azimuth=settings.azimuth,
    )
    x, y = pose.corner
    rows, columns = pose.camera.shape
    if min(x, y) < 0 or y + rows > len(pixels) or x + columns > pixels.shape[1]:
        raise ValueError(
            "the outlines do not fit one another: the eye's middle lies off the limbus"
        )
    cut = slice(y, y + rows), slice(x, x + columns)
    return found._replace(
        pose=pose,
        part=pixels[cut],
        clear=clear[cut],
        reduction=reduction,
        corner=(corner[0] + x * reduction, corner[1] + y * reduction),
    )


def _with_pigments(found: Clone, settings: Settings, given: Given) -> Clone:
    """Pigments of the coarse thickness; then thickness by what the model makes of these pigments,
    and pigments of that  [F09 Fig. 10]."""
    pose, part, texture = _needed(found.pose), _needed(found.part), _needed(found.texture)
    lights, count = given.lights, None
    if lights is None:
        lights, count = lamps_of(part, pose)
    tables = Illumination.build(pose.eye, caustics=False)
    found = found._replace(lights=lights, lights_found=count, integrator=settings.integrator)
    found = _fitted(found, settings, tables)
    if settings.beta is not None:
        return found
    response = _needed(found.windows).thickness_response(found.iris())
    if response < LEAST_RESPONSE:
        return found
    tangent = tangent_of(lights, pose.eye, tables)
    first: Any = tuple(float(-RELIEF * t) for t in tangent)
    coarse = _needed(found.morphology)
    finer = maps_of(texture, coarse.freckles, sigma_mm=0.0, response=response, slopes=first)
    height = RELIEF * (finer.thickness - generic_thickness(texture.radius()))
    relief = to_polar(height, texture.pupil_radius, texture.iris_radius)
    finer = finer._replace(maps=finer.maps.replace(relief=jnp.clip(jnp.asarray(relief), -1, 1)))
    return _fitted(found._replace(morphology=finer, response=response), settings, tables)


def _fitted(found: Clone, settings: Settings, tables: Illumination) -> Clone:
    """With the pigments that fit to its thickness."""
    pose, morphology = _needed(found.pose), _needed(found.morphology)
    base = Iris(
        fibril_radius=jnp.asarray(FIBRILS),
        stroma_thickness=jnp.mean(jnp.asarray(morphology.maps.stroma_depth)),
    )
    windows = windows_of(
        _needed(found.part),
        _needed(found.clear) & ~_freckled(found),
        pose,
        base,
        morphology.maps.replace(freckles=None),
        _needed(found.lights),
        settings.integrator,
        tables,
        room=bool(found.lights_found),
    )
    log = []
    if settings.method == "simplex":
        fit, log = simplex(windows, base)
    else:
        fit = least_squares(windows, base)
    return found._replace(windows=windows, base=base, fit=fit, log=(*found.log, *log))


def _freckled(found: Clone) -> Bool[np.ndarray, "rows columns"]:
    """Pixels of the part that show a freckle."""
    mask = np.zeros_like(_needed(found.clear))
    freckles = _needed(found.morphology).freckles
    if not freckles.any():
        return mask
    where = follow(_needed(found.pose), len(freckles))
    rows, columns = mask.shape
    row, column = (
        np.clip(np.rint(v[freckles]).astype(int), 0, n - 1)
        for v, n in ((where.row, rows), (where.column, columns))
    )
    mask[row, column] = True
    return mask
