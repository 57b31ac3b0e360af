"""`irisjax map`: a hyperspectral cube in, maps of pigments and their standard deviations out."""

import math
from collections import UserDict
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates
from tqdm import tqdm

import irisjax as ij
from irisjax import io
from irisjax.cli import options as opt
from irisjax.cli.engine import LostPiece, Workers, run_pieces
from irisjax.cli.files import check_folder
from irisjax.cli.fit_options import EPILOG as EPILOG
from irisjax.cli.fit_options import PixelModel, SpectralMeasurement, flows_folder
from irisjax.cli.flows import flow_for
from irisjax.cli.kept import KeptPieces
from irisjax.cli.report import print_table
from irisjax.cli.scenes import parse_outline
from irisjax.infer import pixels as fitting
from irisjax.infer.amortised import read_flow, weighted_draws, with_chains
from irisjax.infer.parameters import unit_of
from irisjax.infer.pixels import PixelFits, PixelFlag, Starts
from irisjax.infer.problem import reported
from irisjax.io.cubes import Reflectances, Rows, read_cube, read_map, read_reference, writing_maps
from irisjax.io.maps import encode_maps
from irisjax.io.measured import within_range
from irisjax.io.sections import plain, toml_of
from irisjax.io.tables import replacing
from irisjax.measure.passbands import Passbands
from irisjax.numerics.checks import Range
from irisjax.numerics.chunks import cores
from irisjax.numerics.streams import key_of
from irisjax.photo.photograph import Ellipse
from irisjax.plot import flags_figure, maps_figure, picture
from irisjax.tissue.maps import cell_centres
from irisjax.transport.process import Ilit, option_of

_PARTS_FOLDER = "maps.part"  # a folder
_CHUNK = 1 << 14  # pixels that are read and fitted at a time
_SAMPLE = 1024  # pixels that are fitted first, from whose results all others start
_PICTURE_SIDE = 1024  # rows and columns of a picture, at most
_RADIUS = 512  # largest radius of the limbus, in texels, of the maps for the renderers
_MANY_MISFITS = 0.1  # share of misfits above which a warning is printed
_UNFITTED = PixelFlag.MASKED | PixelFlag.NOT_A_NUMBER | PixelFlag.SATURATED
FLAGS = {
    PixelFlag.MASKED: "masked",
    PixelFlag.NOT_A_NUMBER: "no number in a band",
    PixelFlag.SATURATED: "saturated",
    PixelFlag.NOT_CONVERGED: "not converged",
    PixelFlag.OFF_PRIOR: "far off a prior",
    PixelFlag.MISFIT: "misfit",
    PixelFlag.OUT_OF_DISTRIBUTION: "out of distribution",
    PixelFlag.NO_POSTERIOR: "no posterior",
}
"""Flags of pixels in words."""
_OF_POSTERIOR = {"posterior_mean": "mean of the posterior", "posterior_sd": "sd of the posterior"}


def _parse_range(text: str) -> tuple[float, float]:
    limits = opt.numbers(text.replace(":", ","))
    if len(limits) != 2 or not 0 <= limits[0] < limits[1]:
        raise ValueError(f"{text!r}: write two reflectances, such as 0.005:0.4")
    return limits[0], limits[1]


class CubeMeasurement(SpectralMeasurement):
    cube: Path = opt.argument("ENVI (.hdr), NetCDF (.nc) or Zarr (.zarr)", "CUBE", ...)
    white: Path | None = opt.option(
        "white reference: a cube of the same columns, or a table of wavelengths and values",
        metavar="FILE",
    )
    dark: Path | None = opt.option("the same of the dark signal", metavar="FILE")
    white_reflectance: float = opt.number(
        "reflectance of the white standard, {}", Range(0, 2, above=True), 1.0
    )
    ceiling: float | None = opt.number(
        "stored value from which a band is saturated; default: the largest that the file's whole "
        "numbers can be"
    )
    variable: str | None = opt.option(
        "variable of NetCDF or Zarr, where several have three axes", metavar="NAME"
    )


class PixelChoice(opt.Group, panel="Pixels"):
    mask: Path | None = opt.option(
        "picture of the cube's size, white where pixels are used", metavar="FILE.png"
    )
    brightness: tuple[float, float] | None = opt.option(
        "use pixels whose mean reflectance over the bands is in this range",
        parse=_parse_range,
        metavar="LOW:HIGH",
    )
    limbus: str | None = opt.option(
        "outline of the limbus: centre (column, row), semi-axes (pixels), angle of the larger one "
        "from the right towards the top; pixels outside are masked",
        metavar="X,Y,A,B,DEG",
    )
    pupil: str | None = opt.option(
        "the same of the pupil; with both the maps for the renderers are written too",
        metavar="X,Y,A,B,DEG",
    )


class MapFiles(opt.Group, panel="Files"):
    output: Path = opt.output(
        "for maps.nc, a PNG of each map, overview.png; with --pupil and --limbus maps.exr and "
        "scene.toml for irisjax view and render",
        "FOLDER",
        ...,
    )
    resume: bool = opt.flag("continue a stopped run into the same FOLDER")
    overwrite: bool = opt.flag("replace the maps in FOLDER")


class PixelPosterior(opt.Group, panel="Posterior"):
    ONLY_WITH: ClassVar[opt.OnlyWith] = dict.fromkeys(("flows", "seed"), ("posterior", ()))

    posterior: bool = opt.flag(
        "mean and standard deviation of every pixel's posterior too, by a flow (extra posteriors) "
        "that is weighted by the exact likelihood"
    )
    flows: Path | None = flows_folder()
    seed: int = opt.seeded("posteriors")


@opt.grouped
def map_command(
    measured: CubeMeasurement,
    pixels: PixelChoice,
    model: PixelModel,
    posterior: PixelPosterior,
    files: MapFiles,
    workers: Workers,
) -> None:
    """Map the pigments of an iris from a hyperspectral cube, with standard deviations.

    For example: irisjax map iris.hdr --white white.hdr --dark dark.hdr -o maps

    Every pixel is fitted by least squares as irisjax fit does it, and its covariance kept.
    The cube is read by rows: it may be larger than the memory. Flags of pixels: 1 masked,
    2 no number in a band, 4 saturated, 8 not converged, 16 a parameter more than 4 standard
    deviations off its prior, 32 the model does not produce these data; with --posterior 64
    unlike the model's own spectra, 128 no posterior to be trusted; they add.

    Exit status: 0; 2 for wrong input.
    """
    folder, outlines = files.output, _outlines(pixels)
    check_folder(folder, "maps.nc", "maps", files.overwrite)
    advice = "--resume continues them, --overwrite starts again"
    check_folder(folder, _PARTS_FOLDER, "unfinished maps", files.resume or files.overwrite, advice)
    source, problem = _read_problem(measured, pixels, model, outlines)
    notes: list[str] = []
    with ThreadPoolExecutor(cores()) as pool:
        sample = _sample(replace(source, brightness=None))
        source = source.in_fractions(sample, measured.unit, notes)
        sample = source.factor * sample if source.brightness is None else _sample(source)
        starts = fitting.prior_starts(problem, pool.map)
        if math.prod(source.cube.shape[:2]) > 4 * _SAMPLE:
            fits = fitting.fit_pixels(problem, sample, starts, pool.map)
            starts = fitting.starts_at(problem, fits.z, pool.map)
        flow = None
        if posterior.posterior:
            flow = flow_for(problem, posterior.flows or folder / "flows", posterior.seed, pool.map)
    groups = measured, pixels, model, posterior
    parts = KeptPieces(folder / _PARTS_FOLDER, repr([group.settings() for group in groups]), sample)
    parts.begin(files.resume)
    for note in notes:
        opt.notice(f"{source.cube.path}: {note}")
    settings = _Fitting(problem, starts, flow, posterior.seed)
    _fit(parts, source, settings, workers)
    with replacing(folder / "maps.nc") as temporary:
        counts, fitted = _write_maps(temporary, source, settings, measured, parts)
        _draw(temporary, folder, problem, outlines, posterior.posterior)
    parts.remove()
    rows, columns, _ = source.cube.shape
    flagged = [f"{n} {FLAGS[flag]}" for flag, n in counts.items() if n]
    print_table([], _median_table(folder / "maps.nc", problem), [], title=f"{folder}: medians")
    opt.notice(f"{rows * columns} pixels: {', '.join(flagged) or 'none flagged'}")
    if counts[PixelFlag.MISFIT] > _MANY_MISFITS * fitted:
        opt.notice("WARNING: the model does not produce the spectra of many pixels: see the misfit")


def _outlines(pixels: PixelChoice) -> tuple[Ellipse, Ellipse] | None:
    """Parse the outlines of pupil and limbus."""
    pupil, limbus = parse_outline("--pupil", pixels.pupil), parse_outline("--limbus", pixels.limbus)
    if (pupil is None) != (limbus is None):
        raise ValueError("--pupil and --limbus go together: give both, or neither")
    return None if pupil is None or limbus is None else (pupil, limbus)


def _read_problem(
    measured: CubeMeasurement,
    pixels: PixelChoice,
    model: PixelModel,
    outlines: tuple[Ellipse, Ellipse] | None,
) -> tuple[Reflectances, ij.Problem]:
    """Read the cube's reflectances, and state the inverse problem of a pixel."""
    cube_options = {"variable": measured.variable, "wavelength_unit": measured.wavelength_unit}
    cube = read_cube(measured.cube, **cube_options)
    spectrum_arguments, grid = measured.spectrum_arguments, cube.wavelengths
    bands = spectrum_arguments["bands"]
    if grid is None and isinstance(bands, Passbands):
        grid = np.asarray(bands.centres)
    if grid is None or grid.size != cube.shape[2]:
        defect = "no wavelengths of its bands" if grid is None else f"{cube.shape[2]} bands"
        advice = "give --bands FILE with the centre of each"
        raise ValueError(f"{cube.path}: has {defect}; {advice}")
    notes: list[str] = []
    used = np.flatnonzero(within_range(grid, measured.wavelengths, notes))
    for note in notes:
        opt.notice(f"{cube.path}: {note}")
    if bands is None and cube.fwhm is not None:
        spectrum_arguments["bands"] = Passbands.slit(grid[used], cube.fwhm[used])
        opt.notice(f"{cube.path}: bandwidths as the file says; --bandwidth otherwise")
    blank = ij.spectrum(grid[used], np.zeros(used.size), name=str(cube.path), **spectrum_arguments)
    noise: Any = measured.relative_noise, measured.absolute_noise
    problem = ij.problem(blank, noise=ij.Noise(*noise), **model.problem_arguments([cube.header]))
    model.notice_process(problem)
    white, dark = (
        None if path is None else read_reference(path, cube, **cube_options)
        for path in (measured.white, measured.dark)
    )
    return Reflectances(
        cube,
        white,
        dark,
        measured.white_reflectance,
        ceiling=cube.ceiling if measured.ceiling is None else measured.ceiling,
        keep=_pixel_selector(pixels, cube.shape[:2], outlines),
        brightness=pixels.brightness,
        bands=used,
    ), problem


def _pixel_selector(pixels: PixelChoice, shape: tuple[int, ...], outlines: Any) -> Rows | None:
    """Return a function of the first and the last row that tells which pixels are used."""
    mask = None
    if pixels.mask is not None:
        mask = io.read_image(pixels.mask).pixels[..., 0] > 0.5
        if mask.shape != shape:
            sizes = [f"{columns} x {rows}" for rows, columns in (mask.shape, shape)]
            raise ValueError(f"{pixels.mask}: is {sizes[0]} pixels, the cube {sizes[1]}")
    if mask is None and outlines is None:
        return None

    def select(first: int, last: int) -> np.ndarray:
        chosen = np.ones((last - first, shape[1]), bool) if mask is None else mask[first:last]
        if outlines is None:
            return chosen
        row, column = np.mgrid[first:last, : shape[1]]
        pupil, limbus = (outline.relative_radius(column, row) for outline in outlines)
        return chosen & (pupil > 1) & (limbus < 1)

    return select


def _sample(source: Reflectances) -> np.ndarray:
    """Read spectra of pixels spread over the cube; raise `ValueError` if none can be used."""
    rows = source.cube.shape[0]
    spread = np.unique(np.linspace(0, rows - 1, 66).round().astype(int))
    counts = dict.fromkeys(list(FLAGS)[:3], 0)
    for chosen in (spread, np.setdiff1d(np.arange(rows), spread)):
        spectra = []
        for row in chosen.tolist():
            values, flags = source.read(row, row + 1)
            usable = values[flags == 0]
            count = -(-_SAMPLE // len(chosen))
            spectra.append(
                usable[np.linspace(0, len(usable) - 1, min(count, len(usable))).astype(int)]
            )
            for flag in counts:
                counts[flag] += int(((flags & flag) > 0).sum())
        if sum(map(len, spectra)):
            return np.concatenate(spectra)
    flagged = ", ".join(f"{n} {FLAGS[flag]}" for flag, n in counts.items() if n)
    if source.white is not None and counts[PixelFlag.NOT_A_NUMBER]:
        flagged += "; is the white above the dark in every band?"
    raise ValueError(f"{source.cube.path}: no pixel is left to fit: {flagged}")


class _Fitting(NamedTuple):
    """Settings of the fit of pixels; with a `flow` their posteriors are drawn too."""

    problem: ij.Problem
    starts: Starts
    flow: Path | None
    seed: int


class _Pieces(UserDict[int, Any]):
    """Arguments of `_fit_rows` by the first row; `read` makes them when they are needed."""

    def __init__(self, names: Iterable[int], read: Callable[[int], tuple[Any, ...]]):
        super().__init__(dict.fromkeys(names))
        self._read = read

    def __getitem__(self, first: int) -> tuple[Any, ...]:
        return self._read(first)


def _fit(parts: KeptPieces, source: Reflectances, settings: _Fitting, workers: Workers) -> None:
    """Fit all pixels that are left, by blocks of rows."""
    rows, columns, _ = source.cube.shape
    step = max(1, _CHUNK // columns)
    ends = {first: min(first + step, rows) for first in range(0, rows, step)}
    left = ends.keys() - parts.done()
    pixels_left = columns * sum(ends[first] - first for first in left)
    pieces = _Pieces(sorted(left), lambda first: (*source.read(first, ends[first]), settings))
    total, begun = rows * columns, rows * columns - pixels_left
    with tqdm(total=total, initial=begun, unit="pixel", disable=None) as bar:
        for first, result in run_pieces(_fit_rows, pieces, workers):
            if isinstance(result, LostPiece):
                place = f"{source.cube.path}, row {first} and those below"
                raise ValueError(f"{place}: {result.reason}")
            flags, maps = result
            parts.add(first, {"flag": flags, **maps})
            bar.update(flags.size)


def _write_maps(
    path: Path,
    source: Reflectances,
    settings: _Fitting,
    measured: CubeMeasurement,
    parts: KeptPieces,
) -> tuple[dict[PixelFlag, int], int]:
    """Write the maps of all parts to a file; count the pixels with each flag, and those fitted."""
    (rows, columns, _), counts, fitted = source.cube.shape, dict.fromkeys(FLAGS, 0), 0
    problem, flow = settings.problem, settings.flow
    names = problem.fitted
    priors = {n: {"prior": repr(p)} for n, p in zip(problem.free, problem.priors, strict=True)}
    variables: dict[str, Any] = {}

    def declare(name: str, *axes: str, **attributes_of_map: str) -> None:
        variables[name] = axes, "f4", {**attributes_of_map, "_FillValue": np.float32(np.nan)}

    statistics = {"sd": "standard deviation"} | (_OF_POSTERIOR if flow is not None else {})
    for name in _map_names(problem):
        units = unit_of(name) or "1"
        declare(name, units=units, **priors.get(name, {}))
        for what, words in statistics.items():
            declare(f"{name}_{what}", units=units, long_name=f"{words} of {name}")
    description = "covariance of the parameters in their units"
    declare("covariance", "parameter", "other", long_name=description)
    description = "sum of squared residuals over the number of bands"
    declare("reduced_chi_square", units="1", long_name=description)
    if flow is not None:
        declare("efficiency", units="1", long_name="share of effective draws of the flow")
    variables["flag"] = (), "u1", {
        "flag_masks": np.array([int(f) for f in FLAGS], np.uint8),
        "flag_meanings": " ".join(w.replace(" ", "_") for w in FLAGS.values()),
    }  # fmt: skip
    attributes = {
        "irisjax": ij.__version__, "cube": str(source.cube.path.name),
        "process": option_of(problem.process), "relative_noise": f"{measured.relative_noise:g}",
        "absolute_noise": f"{measured.absolute_noise:g}",
        "fixed": ", ".join(f"{n} = {float(v):.6g}" for n, v in problem.fixed.items()),
    }  # fmt: skip
    if "simulated" in source.cube.header:
        attributes["simulated"] = source.cube.header["simulated"]
    coordinates = {"parameter": names, "other": names}
    with writing_maps(path, (rows, columns), variables, coordinates, attributes) as write:
        for first in parts.done():
            arrays = parts.read(first)
            flags = arrays.pop("flag")
            is_fitted = flags & _UNFITTED == 0
            fitted += int(is_fitted.sum())
            for name, (more_axes, dtype, _) in variables.items():
                shape = (*flags.shape, *(len(names) for _ in more_axes))
                array = flags if name == "flag" else np.full(shape, np.nan, dtype)
                if name in arrays:
                    array[is_fitted] = arrays[name]
                write(name, first, array)
            for flag in counts:
                counts[flag] += int(((flags & flag) > 0).sum())
    return counts, fitted


def _fit_rows(
    values: np.ndarray, flags: np.ndarray, settings: _Fitting
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Fit rows; return their flags, and the maps of the pixels that are fitted."""
    is_fitted = flags == 0
    if not is_fitted.any():
        return flags, {}
    with ThreadPoolExecutor(cores()) as pool:
        fits = fitting.fit_pixels(settings.problem, values[is_fitted], settings.starts, pool.map)
        posterior_flags, maps = 0, {}
        if settings.flow is not None:
            posterior_flags, maps = _posteriors(
                settings, settings.flow, values[is_fitted], fits, pool.map
            )
    flags = flags.copy()  # an array from another process is read-only
    flags[is_fitted] = fits.flags + posterior_flags
    return flags, _map_arrays(fits) | maps


def _posteriors(
    settings: _Fitting, flow: Path, values: np.ndarray, fits: PixelFits, each: Any
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Draw posteriors; return flags of pixels, and maps of means and standard deviations."""
    problem, key = settings.problem, key_of(settings.seed)
    data = problem, values, fits.z, fits.z_covariance
    weighted = weighted_draws(read_flow(flow, problem), *data, each=each, key=key)
    draws, reliable = with_chains(weighted, *data, each=each, key=key)
    maps = {"efficiency": weighted.efficiency}
    for name, x in reported(problem, draws.z, each).items():
        mean = (draws.weights * x).sum(axis=1)
        sd = np.sqrt((draws.weights * (x - mean[:, None]) ** 2).sum(axis=1))
        maps |= {f"{name}_posterior_mean": mean, f"{name}_posterior_sd": sd}
    flags = PixelFlag.OUT_OF_DISTRIBUTION * weighted.unusual + PixelFlag.NO_POSTERIOR * ~reliable
    return flags.astype(np.uint8), maps


def _map_names(problem: ij.Problem) -> list[str]:
    """List the maps: fitted parameters, and the melanin of the ABL if it follows from them."""
    names = problem.fitted
    return [*names, *["abl_melanin"] * ({"melanin_load", "abl_fraction"} <= set(names))]


def _map_arrays(fits: PixelFits) -> dict[str, np.ndarray]:
    """Return arrays of fitted pixels by the names of maps."""
    arrays = {"covariance": fits.covariance, "reduced_chi_square": fits.chi_square}
    for name, values, sd in zip(fits.names, fits.values.T, fits.sd.T, strict=True):
        arrays |= {name: values, f"{name}_sd": sd}
    if (of_abl := fits.abl_melanin()) is not None:
        arrays |= {"abl_melanin": of_abl[0], "abl_melanin_sd": of_abl[1]}
    return arrays


def _draw(
    temporary: Path, folder: Path, problem: ij.Problem, outlines: Any, posterior: bool
) -> None:
    """Write pictures of the maps, and the maps for the renderers."""
    flags = read_map(temporary, "flag")
    extent, step = flags.shape, max(1, -(-max(flags.shape) // _PICTURE_SIDE))

    def read(name: str, unit: str = "") -> tuple[np.ndarray, str]:
        return read_map(temporary, name, step), unit

    maps = {name: read(name, unit_of(name)) for name in _map_names(problem)}
    panels = {name: {name: drawn} for name, drawn in maps.items()}
    for name, (_, unit) in maps.items():
        panels[name][f"standard deviation of {name}"] = read(f"{name}_sd", unit)
        for what, words in _OF_POSTERIOR.items() if posterior else ():
            panels[name][words] = read(f"{name}_{what}", unit)
    for name in ("reduced_chi_square", *["efficiency"] * posterior):
        panels[name] = {name: read(name)}
    panels["overview"] = maps | panels["reduced_chi_square"]
    figures = {name: maps_figure(drawn, extent) for name, drawn in panels.items()}
    figures["flag"] = flags_figure(flags[::step, ::step], {int(f): w for f, w in FLAGS.items()})
    data = {folder / f"{name}.png": picture(figure, ".png") for name, figure in figures.items()}
    if outlines is not None and problem.base.power_law is not None:
        opt.notice("no maps.exr: pictures support no power law of scattering")
    elif outlines is not None:
        data |= {
            folder / n: d for n, d in _renderer_files(temporary, flags, problem, outlines).items()
        }
    io.write_together(data)


def _renderer_files(
    temporary: Path, flags: np.ndarray, problem: ij.Problem, outlines: tuple[Ellipse, Ellipse]
) -> dict[str, bytes]:
    """Make polar textures of the maps between pupil and limbus, and a scene with them."""
    pupil, limbus = outlines
    step = max(1, math.ceil(limbus.mean_radius / _RADIUS))
    middle, reach = np.flip(limbus.centre), max(limbus.semi_axes) + 1
    low, high = (np.clip((middle + d) / step, 0, None).astype(int) for d in (-reach, reach))
    box = np.s_[low[0] : high[0] + 2, low[1] : high[1] + 2]
    usable = (flags[::step, ::step][box] & (_UNFITTED | PixelFlag.NOT_CONVERGED)) == 0
    values = {n: np.asarray(v) for n, v in problem.fixed.items() if n != "noise"}
    values |= {n: read_map(temporary, n, step)[box].astype(float) for n in problem.fitted}
    iris = fitting.iris_of_pixels(values, problem.base, usable)
    across = limbus.mean_radius - pupil.mean_radius
    shape = max(64, round(2 * math.pi * limbus.mean_radius / step)), max(16, round(across / step))
    angle, radius = (np.asarray(x) for x in cell_centres(shape))
    edges = [o.points(angle - o.angle)[:, None] for o in outlines]
    column, row = np.moveaxis(edges[0] + (edges[1] - edges[0]) * radius[:, None], -1, 0) / step
    column, row = column - low[1], row - low[0]
    nearest: Any = distance_transform_edt(~usable, return_distances=False, return_indices=True)
    texels = {
        n: np.full(shape, v) if v.ndim == 0
        else map_coordinates(v[tuple(nearest)], [row, column], order=1, mode="nearest")
        for n, v in values.items()
    }  # fmt: skip
    maps = fitting.maps_of_pixels(texels, iris)
    fields = "eumelanin", "pheomelanin", "abl_fraction", "oxyhemoglobin", "deoxyhemoglobin"
    fields = *fields, "stroma_thickness", "abl_thickness", "scattering_scale"
    ilit = isinstance(problem.process, Ilit)
    share = pupil.mean_radius / limbus.mean_radius
    sections = {
        "iris": {name: float(getattr(iris, name)) for name in fields},
        "maps": {"file": "maps.exr"},
        "eye": {"pupil_radius": float(np.clip(share * 5.5, 0.25, 4.75))},
        "environment": {"kind": "studio"},
        "picture": {"integrator": "separable" if ilit else "radiative-transfer"},
    }
    text = f"# maps of a cube by irisjax map\n{toml_of(plain(sections, 6))}"
    return {"maps.exr": encode_maps("maps.exr", maps), "scene.toml": text.encode()}


def _median_table(path: Path, problem: ij.Problem) -> dict[str, list[str]]:
    """Return columns of a table: each map's median, range over pixels, and standard deviation."""
    step, rows = max(1, max(read_map(path, "flag").shape) // _PICTURE_SIDE), []
    for name in sorted(_map_names(problem), key=lambda n: n != "abl_melanin"):
        low, middle, high = np.nanpercentile(read_map(path, name, step), (16, 50, 84))
        sd = np.nanmedian(read_map(path, f"{name}_sd", step))
        numbers = f"{middle:.3g}", f"{low:.3g} to {high:.3g}", f"{sd:.2g}"
        rows.append((name, unit_of(name), *numbers))
    heads = "parameter", "unit", "median", "68 % of pixels", "sd"
    return {n: list(cells) for n, *cells in zip(heads, *rows, strict=True)}
