"""A photograph turned into an iris, stage by stage  [F09 Figs. 4, 5].

Outlines, pose, the iris laid flat, its thickness, its pigments: each stage is a function of those
before, and what it found can be replaced by the user's own.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import skimage.measure
import skimage.transform
from jaxtyping import Bool, Float

from irisjax.anatomy.eye import Cornea, Eye
from irisjax.photo.boundaries import Boundaries, find_boundaries
from irisjax.photo.ellipse import Ellipse
from irisjax.photo.highlights import find_highlights, find_lashes, find_lids
from irisjax.photo.lamps import lamps_of
from irisjax.photo.morphology import Morphology, maps_of
from irisjax.photo.photograph import Photograph
from irisjax.photo.pigments import Fit, iris_of, least_squares, simplex
from irisjax.photo.pose import Pose, find_pose
from irisjax.photo.posterior import PigmentPosterior, sample
from irisjax.photo.refraction import SIZE, follow, unrefract
from irisjax.photo.unrefracted import Unrefracted
from irisjax.photo.windows import Windows, windows_of
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps

STAGES = ("outlines", "pose", "texture", "thickness", "pigments", "posterior")
"""In their order."""
MEDIA = ("cornea-aqueous", "f09")
METHODS = ("least-squares", "simplex")
LARGEST = 1100
"""Pixels across the iris that are used; more are averaged."""
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
    fit: Fit | None = None
    log: tuple[dict[str, float], ...] = ()
    posterior: PigmentPosterior | None = None

    def scene(self) -> Scene:
        """The eye as it was photographed: the same camera, light and pigments.

        **Raises:** `ValueError` before the pigments are known.
        """
        pose, morphology = self.pose, self.morphology
        if pose is None or morphology is None or self.fit is None or self.base is None:
            raise ValueError("the pigments have not been sought yet")
        return Scene(
            iris_of({k: jnp.asarray(v) for k, v in self.fit.values.items()}, self.base),
            morphology.maps,
            eye=pose.eye,
            lights=self.lights,
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
    eye = eye_of(settings)
    with stage("outlines"):
        found = Clone(photograph, find_boundaries(photograph, given.limbus, given.pupil))
    yield found
    if last == "outlines":
        return
    with stage("pose"):
        found = _posed(found, eye, settings)
    yield found
    if last == "pose":
        return
    with stage("texture"):
        assert found.pose is not None and found.part is not None and found.clear is not None
        found = found._replace(texture=unrefract(found.part, found.clear, found.pose, SIZE))
    yield found
    if last == "texture":
        return
    with stage("thickness"):
        assert found.texture is not None
        found = found._replace(
            morphology=maps_of(
                found.texture,
                given.freckles,
                sigma_mm=settings.sigma,
                **({} if settings.beta is None else {"beta": settings.beta}),
            )
        )
    yield found
    if last == "thickness":
        return
    with stage("pigments"):
        found = _with_pigments(found, settings, given)
    yield found
    if last == "pigments":
        return
    with stage("posterior"):
        assert found.windows is not None and found.base is not None and found.fit is not None
        sampled = sample(
            found.windows, found.base, found.fit, max_steps=settings.steps, seed=settings.seed
        )
        found = found._replace(posterior=sampled)
    yield found


def eye_of(settings: Settings) -> Eye:
    """The eye of these media and this depth, its pupil not yet known."""
    if settings.media == "f09":
        return Eye(cornea=Cornea.f09(), aqueous_index=1.376, iris_depth=settings.iris_depth)
    return Eye(iris_depth=settings.iris_depth)


def _posed(found: Clone, eye: Eye, settings: Settings) -> Clone:
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
    assert found.pose is not None and found.part is not None and found.clear is not None
    assert found.morphology is not None and found.texture is not None
    lights, count = given.lights, None
    if lights is None:
        lights, count = lamps_of(found.part, found.pose)
    base = Iris(
        fibril_radius=FIBRILS,
        stroma_thickness=float(np.mean(found.morphology.maps.stroma_depth)),
    )
    tables = Illumination.build(found.pose.eye, caustics=False)
    windows = windows_of(
        found.part,
        found.clear & ~_freckled(found),
        found.pose,
        base,
        IrisMaps(stroma_depth=found.morphology.maps.stroma_depth),
        lights,
        settings.integrator,
        tables,
    )
    if settings.method == "simplex":
        fit, log = simplex(windows, base)
    else:
        fit, log = least_squares(windows, base), []
    return found._replace(
        integrator=settings.integrator,
        lights=lights,
        lights_found=count,
        windows=windows,
        base=base,
        fit=fit,
        log=tuple(log),
    )


def _freckled(found: Clone) -> Bool[np.ndarray, "rows columns"]:
    """Pixels of the part that show a freckle."""
    assert found.pose is not None and found.morphology is not None and found.clear is not None
    mask = np.zeros_like(found.clear)
    freckles = found.morphology.freckles
    if not freckles.any():
        return mask
    where = follow(found.pose, len(freckles))
    rows, columns = mask.shape
    row, column = (
        np.clip(np.rint(v[freckles]).astype(int), 0, n - 1)
        for v, n in ((where.row, rows), (where.column, columns))
    )
    mask[row, column] = True
    return mask
