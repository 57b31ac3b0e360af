"""`irisjax simulate-cube`: a hyperspectral cube of a grown iris, with its truth."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import typer
from scipy.special import expit, logit

import irisjax as ij
from irisjax import io
from irisjax.anatomy.eye import Eye
from irisjax.cli import model
from irisjax.cli import options as opt
from irisjax.cli.files import check_folder
from irisjax.cli.light import NoisyLight
from irisjax.grow.noise import noise, split_seed
from irisjax.grow.procedural import procedural
from irisjax.infer.parameters import of_iris, unit_of
from irisjax.infer.pixels import predict_pixels
from irisjax.io.cubes import writing_maps
from irisjax.io.tables import format_table, replacing
from irisjax.measure.colour import illuminant_power
from irisjax.numerics.checks import Range
from irisjax.numerics.interpolation import polar_bilinear
from irisjax.numerics.streams import key_of
from irisjax.transport.process import option_of

_LIMBUS, _PUPIL = 0.48, 0.16  # radii over the width of the cube
_OUTSIDE, _INSIDE = 0.5, 0.001  # reflectances of the sclera and the pupil
_WHITE, _DARK, _MOST = 40_000.0, 400.0, 2**16 - 1  # counts
_HIGHLIGHT = 0.03, 0.28, 0.9  # radius and distance from the centre over the width, and angle
_STROMA = 0.38, 2.0  # thinnest and thickest stroma relative to its mean
_VARIED = ("melanin_load", "abl_fraction", "pheomelanin_share", "hemoglobin", "saturation")


class CubeSize(opt.Group, panel="Cube"):
    size: int = opt.whole("rows and columns, {}", Range(16, 1024), 128, "pixels")
    output: Path = opt.output(
        "for cube.hdr and cube.img (ENVI), white.csv, dark.csv and truth.nc", "FOLDER", ...
    )
    overwrite: bool = opt.flag("replace the cube in FOLDER")


@opt.grouped
def simulate_cube_command(
    iris: model.IrisOptions, process: model.ProcessOptions, light: NoisyLight, cube: CubeSize
) -> None:
    """Simulate a hyperspectral cube of a grown iris, with its truth, to try irisjax map.

    The iris's numbers are those of a typical place; its texture, melanins and blood vary
    over the pixels. The camera counts 16 bits, of which 40,000 are white; a highlight is
    saturated. What the slit and the bands average is computed; light that moves sideways
    in the tissue is not.
    """
    folder, size = cube.output, cube.size
    check_folder(folder, "cube.hdr", "a cube", cube.overwrite)
    eye, rules = model.build_model(iris, process)
    grid, key = light.wavelengths.values, key_of(light.seed)
    middle, row, column = (size - 1) / 2, *np.mgrid[:size, :size]
    radius_of_pixel = np.hypot(row - middle, column - middle) / size
    angle_of_pixel = np.arctan2(middle - row, column - middle) % (2 * np.pi)
    inside = (radius_of_pixel > _PUPIL) & (radius_of_pixel < _LIMBUS)
    truth = _true_maps(eye, radius_of_pixel, angle_of_pixel, key)
    blank = ij.spectrum(grid, np.zeros(grid.size), **light.instrument_arguments())
    varied = (*_VARIED, "scattering_scale")
    problem = ij.problem(blank, free=varied, fixed={"gain": light.gain}, base=eye, process=rules)
    with ThreadPoolExecutor(2) as pool:
        spectra = predict_pixels(problem, {n: truth[n][inside] for n in varied}, pool.map)
    values = np.where((radius_of_pixel < _PUPIL)[..., None], _INSIDE, np.full(grid.size, _OUTSIDE))
    values[inside] = spectra
    random = np.random.default_rng([light.seed, 1])
    sd = np.hypot(light.relative_noise * values, light.absolute_noise)
    values += sd * random.standard_normal(values.shape)
    radius, distance, angle = _HIGHLIGHT
    centre = middle + size * distance * np.array([-np.sin(angle), np.cos(angle)])
    values[np.hypot(row - centre[0], column - centre[1]) < radius * size] = 3.0
    lamp = np.asarray(illuminant_power("D65", grid))
    white = _DARK + (_WHITE - _DARK) * lamp / lamp.max()
    counts = np.clip(np.rint(_DARK + values * (white - _DARK)), 0, _MOST).astype("<u2")
    outlines = {"limbus": _LIMBUS * size, "pupil": _PUPIL * size}
    outlines = {n: f"{middle:g},{middle:g},{r:g},{r:g},0" for n, r in outlines.items()}
    description = (
        f"hyperspectral cube of a grown iris by irisjax {ij.__version__}, not a measurement"
    )
    header = {
        "description": "{" + description + "}", "samples": size, "lines": size, "bands": grid.size,
        "header offset": 0, "file type": "ENVI Standard", "data type": 12, "interleave": "bil",
        "byte order": 0, "wavelength units": "Nanometers", "wavelength": _braced(grid),
        **({} if light.bandwidth is None else {"fwhm": _braced([light.bandwidth] * grid.size)}),
        "simulated": description, "process": option_of(rules), **outlines,
        "scattering_scale": f"{float(eye.scattering_scale):g}", "gain": f"{light.gain:g}",
        "relative noise": f"{light.relative_noise:g}",
        "absolute noise": f"{light.absolute_noise:g}", "seed": light.seed,
    }  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    names = {"simulated": "counts of a camera, not a measurement"}
    tables = {
        "white.csv": format_table(names, {"wavelength_nm": grid, "white": white}),
        "dark.csv": format_table(names, {"wavelength_nm": grid, "dark": 0 * grid + _DARK}),
        "cube.hdr": "ENVI\n" + "".join(f"{k} = {v}\n" for k, v in header.items()),
    }
    variables = {n: ((), "f4", {"units": unit_of(n) or "1"}) for n in truth}
    with (
        replacing(folder / "truth.nc") as temporary,
        writing_maps(temporary, inside.shape, variables, {}, {"simulated": description}) as write,
    ):
        for name, array in truth.items():
            write(name, 0, np.where(inside, array, np.nan))
    data = {folder / name: text.encode() for name, text in tables.items()}
    io.write_together(data | {folder / "cube.img": counts.transpose(0, 2, 1).tobytes()})
    options = " ".join(f"--{name} {text}" for name, text in outlines.items())
    typer.echo(
        f"irisjax map {folder}/cube.hdr --white {folder}/white.csv --dark {folder}/dark.csv "
        f"{options}"
    )


def _true_maps(iris: ij.Iris, distance: np.ndarray, azimuth: np.ndarray, key: jax.Array):
    """Grow the parameters of an inversion at pixels, from their distances from the pupil's middle,
    over the width of the cube, and their angles.
    """
    eye = Eye(pupil_radius=jnp.asarray(5.5 * _PUPIL / _LIMBUS))
    maps = procedural(iris, eye, shape=(768, 128), heterochromia=1.0, freckles=4, abl=0.5, key=key)
    angle, radius = jnp.asarray(azimuth), jnp.asarray((distance - _PUPIL) / (_LIMBUS - _PUPIL))

    def sample(texture):
        return 1.0 if texture is None else np.asarray(polar_bilinear(texture, angle, radius))

    # Limited, since the prior of the strength of scattering begins at 0.3.
    abl, stroma = sample(maps.abl_scale(iris)), np.clip(sample(maps.stroma_scale(iris)), *_STROMA)
    eumelanin_scale = sample(maps.eumelanin)
    typical = {n: float(v) for n, v in of_iris(iris).items()}
    share, fraction = typical["pheomelanin_share"], typical["abl_fraction"]
    # Concentrations do not depend on thickness: thicker places have more of all pigments.
    depth = fraction * abl + (1 - fraction) * stroma
    eumelanin = typical["melanin_load"] * (1 - share) * eumelanin_scale * depth
    pheomelanin = typical["melanin_load"] * share * depth
    seeds = split_seed(jax.random.bits(jax.random.fold_in(key, 9), dtype=jnp.uint32), 2)
    fields = [
        np.asarray(noise(s, angle / (2 * jnp.pi), jnp.clip(radius, 0, 1), (6, 3), 3)) for s in seeds
    ]
    parameters = {
        "melanin_load": eumelanin + pheomelanin,
        "abl_fraction": fraction * abl / depth,
        "pheomelanin_share": pheomelanin / (eumelanin + pheomelanin),
        "hemoglobin": typical["hemoglobin"] * stroma * np.exp(0.5 * fields[1]),
        "saturation": expit(logit(typical["saturation"]) + fields[0]),
        "scattering_scale": typical["scattering_scale"] * stroma,
    }
    return {n: np.broadcast_to(v, distance.shape) for n, v in parameters.items()}


def _braced(values) -> str:
    return "{" + ", ".join(f"{float(v):g}" for v in values) + "}"
