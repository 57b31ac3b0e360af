"""A photograph turned into an iris, stage by stage  [F09 Figs. 4, 5].

Outlines, pose, the iris laid flat, its thickness, its pigments: each stage is a function of those
before, and what it found can be replaced by the user's own.
"""

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from irisjax.anatomy.eye import Cornea, Eye
from irisjax.photo.average import TURNS, average_maps
from irisjax.photo.blur import width_by_rendering
from irisjax.photo.boundaries import Boundaries, find_boundaries
from irisjax.photo.cloned import NOTHING, Clone, Given, Settings, needed
from irisjax.photo.finer import with_finer_thickness
from irisjax.photo.lamps import Lighting, find_lighting, light_at
from irisjax.photo.mirrored_face import find_mirrored_face
from irisjax.photo.morphology import maps_of
from irisjax.photo.part import part_of
from irisjax.photo.photograph import Photograph
from irisjax.photo.pigments import exposures_for, least_squares, simplex
from irisjax.photo.polar import from_polar
from irisjax.photo.pose import Pose, find_pose
from irisjax.photo.posterior import sample
from irisjax.photo.refraction import SIZE, follow, unrefract
from irisjax.photo.second import second_of
from irisjax.photo.thickness import BETA, SIGMA
from irisjax.photo.visible import pixels_shown
from irisjax.photo.window_pixels import WindowPixels, choose_pixels, iris_alone
from irisjax.photo.windows import Windows, windows_of
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.project import onto_picture
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable
from irisjax.render.stages import look
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps
from irisjax.transport.ilit.exact import IlitExact

STAGES = ("outlines", "pose", "texture", "thickness", "pigments", "posterior")
"""In their order."""
MEDIA = ("cornea-aqueous", "f09")
METHODS = ("least-squares", "simplex")
SOLVER_ANGLES = 12
"""Of ILIT's solver where pigments are sought: radiances are within 5e-5 of those of a picture."""
FIBRILS = 57.0
"""Radius of the stroma's fibrils (nm) that colours begin with: between those of the presets'
blue and brown eyes. Its scattering is free within a factor."""


def clone(
    photograph: Photograph,
    settings: Settings,
    given: Given = NOTHING,
    *,
    last: str = STAGES[-1],
    stage: Callable[[str], AbstractContextManager[Any]] = lambda name: nullcontext(),
    tables: Callable[[Scene], Illumination | None] = Scene.tables,
) -> Iterator[Clone]:
    """Run the stages up to `last`; what is known after each is yielded.

    Args:
        photograph: Linear; of `io.read_photograph`.
        settings: What a clone is made with.
        given: In place of what stages would find.
        last: Name of the last stage.
        stage: Is entered with a stage's name for as long as it takes.
        tables: Makes the tables of light on the iris, or has them from a file.

    Raises:
        ValueError: If a stage finds nothing, in one line.
    """
    check_names(settings, last)
    with stage(STAGES[0]):
        found = Clone(photograph, find_boundaries(photograph, given.limbus, given.pupil))
    yield found
    pigments = partial(_with_pigments, tables=tables)
    steps = (_posed, _flat, _with_thickness, pigments, _sampled)
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
    del settings
    part, clear, pose = needed(found.part), needed(found.clear), needed(found.pose)
    if found.second is not None:
        part, clear = found.second.part, found.second.clear
    if given.visible is not None:
        clear = pixels_shown(needed(found.view), given.visible, clear.shape)
        found = found._replace(clear=clear)
    where = follow(pose, SIZE)
    return found._replace(refraction=where, texture=unrefract(part, clear, pose, where))


def _with_thickness(found: Clone, settings: Settings, given: Given) -> Clone:
    """With a coarse thickness by Eq. 7."""
    beta = BETA if settings.beta is None else settings.beta
    texture = needed(found.texture)
    sigma = SIGMA if settings.sigma is None else settings.sigma
    shape = maps_of(texture, given.freckles, sigma_mm=sigma, beta=beta)
    if given.maps is not None:
        if (depth := given.maps.stroma_depth) is None:
            raise ValueError("the maps that are given have no thickness of the stroma")
        rim = texture.pupil_radius, texture.iris_radius
        there = from_polar(np.asarray(depth), texture.radius(), texture.angle(), *rim)
        shape = shape._replace(maps=given.maps, thickness=there, clamped=0)
    return found._replace(morphology=shape)


def _sampled(found: Clone, settings: Settings, given: Given) -> Clone:
    """With a posterior of its pigments."""
    del given
    known = needed(found.windows), needed(found.base), needed(found.fit)
    return found._replace(posterior=sample(*known, max_steps=settings.steps, seed=settings.seed))


def eye_of(settings: Settings) -> Eye:
    """The eye of these media and this depth, its pupil not yet known."""
    depth = cast(Any, settings.iris_depth)
    if settings.media == "f09":
        return Eye(cornea=Cornea.f09(), aqueous_index=cast(Any, 1.376), iris_depth=depth)
    return Eye(iris_depth=depth)


def _posed(found: Clone, settings: Settings, given: Given) -> Clone:
    """With the camera, and the part of the photograph that it sees."""
    eye = eye_of(settings)
    photograph, limbus, pupil = found.photograph, found.boundaries.limbus, found.boundaries.pupil
    focal = photograph.focal_px if settings.focal_px is None else settings.focal_px
    part = part_of(photograph, limbus)
    lids = part.lids(part.moved(pupil))
    clear = part.clear(part.moved(pupil), lids)
    pose = find_pose(
        part.limbus,
        part.moved(pupil),
        eye,
        focal_px=None if focal is None else focal / part.reduction,
        azimuth=settings.azimuth,
    )
    pose = pose._replace(eye=_with_widths(pose, found.boundaries))
    x, y = pose.corner
    rows, columns = pose.camera.shape
    if min(x, y) < 0 or y + rows > len(clear) or x + columns > len(clear):
        raise ValueError(
            "the outlines do not fit one another: the eye's middle lies off the limbus"
        )
    cut = slice(y, y + rows), slice(x, x + columns)
    view, pixels, clear = look(pose.eye, pose.camera), part.pixels[cut], clear[cut]
    if lids.any():
        around = part.outside[cut], part.limbus.moved(-x, -y)
        clear = clear & ~find_mirrored_face(pixels, *around, view.mirror)
    found = found._replace(
        pose=pose,
        view=view,
        part=pixels,
        clear=clear,
        lids=bool(lids.any()),
        reduction=part.reduction,
        corner=(part.corner[0] + x * part.reduction, part.corner[1] + y * part.reduction),
    )
    if given.second is None:
        return found
    return found._replace(second=second_of(given.second, photograph, limbus, pupil, cut))


def _with_widths(pose: Pose, outlines: Boundaries) -> Eye:
    """The eye with edges as soft as the outlines; a pixel of the camera at least, as the picture is
    of points.
    """
    eye, pixel = pose.eye, float(pose.camera.width) / pose.camera.size[0]
    known = (
        ("pupil_margin", outlines.pupil_margin, eye.pupil_radius),
        ("limbus_width", outlines.limbus_width, eye.limbus_radius),
    )
    widths = {
        name: jnp.asarray(max(relative * float(radius), pixel), float)
        for name, relative, radius in known
        if relative is not None
    }
    return eye.replace(**widths)


def _with_pigments(
    found: Clone,
    settings: Settings,
    given: Given,
    tables: Callable[[Scene], Illumination | None],
) -> Clone:
    """Pigments of an average iris, or of one as thick as the given maps say; then thickness by what
    the model makes of these pigments  [F09 Fig. 10]."""
    pose, part = needed(found.pose), needed(found.part)
    view = needed(found.view)
    if given.lights is None and given.environment is None:
        light = find_lighting(part, pose, view)
    else:
        light = Lighting(given.lights, given.environment)
    # Tables depend on how low light stands, and that of a room comes from all round.
    around = Environment.uniform() if light.room else light.environment
    made = tables(Scene(Iris(), eye=pose.eye, lights=light.lamps, environment=around))
    found = found._replace(lighting=light, tables=made, integrator=settings.integrator)
    clear = needed(found.clear) & iris_alone(pose) & ~_freckled(found)
    chosen = choose_pixels(part, clear, view, pose.eye, light.environment, _light_on(found))
    found = _fitted(found, chosen, settings.method, given.maps)
    base, fit, windows = needed(found.base), needed(found.fit), needed(found.windows)
    if given.maps is None:
        if settings.beta is None:
            found = with_finer_thickness(found, settings)
        elif settings.sigma is None:
            found = _with_width(found, chosen, settings.beta)
        windows = _windows(found, chosen, base, needed(found.morphology).maps)
    return found._replace(exposure=exposures_for(fit, windows, base))


def _light_on(found: Clone) -> Float[np.ndarray, "rows columns"] | None:
    """Irradiance of the iris by lamps at each pixel of the part; not known where lids shade it."""
    seen, pose = needed(found.view).iris, needed(found.pose)
    if found.lids or seen is None:
        return None
    x, y = (np.asarray(c) for c in seen.point[:2])
    lit = light_at(x, y, needed(found.lighting).lights(), pose.eye, found.tables)
    return onto_picture(seen, lit, pose.camera.shape)


def _with_width(found: Clone, chosen: WindowPixels, beta: float) -> Clone:
    """With a thickness whose deconvolution makes the rendering most like the photograph."""
    texture, base, fit = needed(found.texture), needed(found.base), needed(found.fit)
    freckles = needed(found.morphology).freckles

    def deconvolved(width: float) -> Clone:
        shape = maps_of(texture, freckles, sigma_mm=width, beta=beta)
        exposure = exposures_for(fit, _windows(found, chosen, base, shape.maps), base)
        return found._replace(morphology=shape, exposure=exposure)

    return deconvolved(width_by_rendering(deconvolved))


def _fitted(found: Clone, chosen: WindowPixels, method: str, given: IrisMaps | None) -> Clone:
    """With the pigments of an average iris, or of the given maps."""
    if given is None:
        maps, turns = average_maps(needed(found.pose).eye), TURNS
    else:
        maps, turns = given, 1
    base = Iris(
        fibril_radius=jnp.asarray(FIBRILS),
        stroma_thickness=jnp.mean(jnp.asarray(maps.stroma_depth)),
    )
    windows = _windows(found, chosen, base, maps, turns)
    fit = simplex(windows, base) if method == "simplex" else least_squares(windows, base)
    return found._replace(windows=windows, base=base, fit=fit)


def _windows(
    found: Clone, chosen: WindowPixels, base: Iris, maps: IrisMaps, turns: int = 1
) -> Windows:
    """Windows of some maps in the found light."""
    light, integrator = needed(found.lighting), cast(Any, found.integrator)
    if isinstance(integrator, Separable):
        integrator = dataclasses.replace(integrator, solver=IlitExact(SOLVER_ANGLES))
    maps = maps.replace(freckles=None)
    known = light.lights(), integrator, found.tables, light.room, turns
    return windows_of(chosen, needed(found.pose).eye, base, maps, *known)


def _freckled(found: Clone) -> Bool[np.ndarray, "rows columns"]:
    """Pixels of the part that show a freckle."""
    mask = np.zeros_like(needed(found.clear))
    freckles, where = needed(found.morphology).freckles, needed(found.refraction)
    rows, columns = mask.shape
    row, column = (
        np.clip(np.rint(v[freckles]).astype(int), 0, n - 1)
        for v, n in ((where.row, rows), (where.column, columns))
    )
    mask[row, column] = True
    return mask
