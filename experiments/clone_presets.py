"""Clones of pictures of the presets: are the pigments in their intervals, and the pictures alike?

The presets are drawn by the package's own renderer, in the studio and straight from the front. The
optics are the same on both sides; but the search knows neither the maps nor the light, and the
pigments are those that photographed colours asked for, not draws from its priors. Each preset is
also drawn with maps whose contrast is raised: how much may colours vary over an iris before the
pigments of its mean are wrong?
"""

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from experiments.clone_truth import scattering_of
from experiments.common import RESULTS, start, write
from experiments.simulated_eyes import outlines_of, read_back
from irisjax.anatomy.eye import Eye
from irisjax.grow.presets import PRESETS
from irisjax.photo.clone import (
    NOTHING,
    CloneSettings,
    Fitted,
    Given,
    Sampled,
    clone_eye,
    compare_with_photograph,
)
from irisjax.photo.doubts import doubts_of
from irisjax.photo.pigments import mean_misfit
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.picture import draw_bands
from irisjax.render.scene import Scene
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, cell_centres

SIZE, WIDTH = 640, 14.0
"""Side of a picture in pixels, and width of the field that it shows in mm."""
EYE = Eye().replace(pupil_radius=1.7)
CONTRASTS = (1.0, 1.5, 2.0, 3.0)
"""Powers of the maps of pigments and thickness; above 2 the outlines are given."""
COLUMNS = ("preset", "contrast", "parameter", "truth", "q2.5", "median", "q97.5")
PICTURES = ("preset", "contrast", "doubts", "windows_rms")
PICTURES += tuple(f"{p}_{c}" for p in ("rms", "pigments") for c in "rgb")


def main(key, quick=False, out=RESULTS):
    """Write intervals beside the truth, and differences of the pictures in per cent (quick: one
    preset).
    """
    intervals, pictures = [], []
    eyes = [(colour, contrast) for contrast in CONTRASTS for colour in PRESETS]
    for colour, contrast in tqdm(eyes[: 1 if quick else None], unit="eye", disable=quick):
        iris, maps = PRESETS[colour](EYE, key=key)
        maps = raised(maps, contrast)
        scene = _scene(iris, maps)
        picture = read_back(np.concatenate([b.pixels for b in draw_bands(scene, samples=2)]))
        given = Given(*outlines_of(scene)) if contrast > 2 else NOTHING
        *_, found = clone_eye(picture, CloneSettings(), given, key=key)
        assert isinstance(found, Sampled)
        difference = compare_with_photograph(found)
        doubts = len(doubts_of(found, difference.rms_of_pigments))
        rms = 100 * np.concatenate([difference.rms, difference.rms_of_pigments])
        off = mean_misfit(found.fit, found.windows)
        pictures.append((colour, contrast, doubts, off, *map(float, rms)))
        for name, value in mean_pigments(iris, maps, EYE, found).items():
            e = found.posterior.estimates[name]
            intervals.append((colour, contrast, name, value, e.low, e.median, e.high))
    about = ("presets drawn by the package's renderer, and cloned", f"{SIZE} px")
    write(out / "clone_presets.csv", about, COLUMNS, intervals)
    write(out / "clone_presets_pictures.csv", (*about, "differences: %"), PICTURES, pictures)


def raised(maps: IrisMaps, power: float) -> IrisMaps:
    """Maps with deviations from their geometric means raised to a power."""

    def of_power(values):
        middle = jnp.exp(jnp.log(values).mean())
        return middle * (values / middle) ** power

    fields = "stroma_depth", "eumelanin", "pheomelanin"
    held = {name: value for name in fields if (value := getattr(maps, name)) is not None}
    return maps.replace(**{name: of_power(value) for name, value in held.items()})


def _scene(iris: Iris, maps: IrisMaps) -> Scene:
    """An iris in the studio."""
    camera = Camera(width=jnp.asarray(WIDTH), size=(SIZE, SIZE))
    return Scene(iris, maps, EYE, None, Environment.studio(), camera)


def mean_pigments(iris: Iris, maps: IrisMaps, eye: Eye, found: Fitted) -> dict[str, float]:
    """Means over the iris of what the clone estimates. Melanin adds up, and so does scattering: a
    stroma that is thicker than the clone's scatters as much more.
    """
    area = np.asarray(eye.ring_area(cell_centres(maps.shape)[1]))
    ones = np.ones(maps.shape)

    def mean(values) -> float:
        return float(np.average((values * ones).mean(0), weights=area))

    abl = 1.0 if (scale := maps.abl_scale(iris)) is None else np.asarray(scale)
    pigment = {
        name: 1.0 if (own := getattr(maps, name)) is None else np.asarray(own)
        for name in ("eumelanin", "pheomelanin")
    }
    truth = {
        name: value * mean(pigment[name.split("_")[1]] * (abl if name.startswith("abl") else 1))
        for name, value in iris.layer_concentrations().items()
    }
    thickness = mean(np.asarray(maps.stroma_depth)) / float(found.base.stroma_thickness)
    strength = float(iris.scattering_scale) * scattering_of(float(iris.fibril_radius))
    scattering = strength * thickness
    return truth | {"hemoglobin": float(iris.hemoglobin), "scattering_scale": scattering}


if __name__ == "__main__":
    start(main, __doc__)
