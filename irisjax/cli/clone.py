"""`irisjax clone`: a photograph of an eye in, an iris with error bars out."""

import time
from collections.abc import Callable
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import typer
from tqdm import tqdm

from irisjax import io
from irisjax._types import PRNGKey
from irisjax.cli import options as opt
from irisjax.cli.compiled import cached_tables
from irisjax.cli.engine import Workers
from irisjax.cli.files import check_folder
from irisjax.cli.scenes import parse_lamps, parse_outline
from irisjax.io.clone_folders import PHOTOGRAPH, encode_photograph
from irisjax.io.clones import CLONE_FILES, OVERLAY, files_of, overlay_of
from irisjax.io.eye_colours import COLOUR_FILES, colour_files
from irisjax.io.photographs import read_photograph
from irisjax.numerics.checks import Range
from irisjax.numerics.streams import key_of
from irisjax.photo import clone as cloning
from irisjax.photo.doubts import Doubt, doubtful_outlines, doubts_of, per_cent
from irisjax.photo.eye_colour import RINGS, EyeColour, RegionColour, colours_of
from irisjax.photo.photograph import Photograph
from irisjax.plot.beside import Later, beside, here
from irisjax.render.environment import Environment
from irisjax.render.integrators import INTEGRATORS
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.separable import Separable
from irisjax.render.single_scattering import TabulatedSingleScattering

_DOUBTFUL = 3
_SMALL_PART = 0.3  # share of the photograph below which the part that is used is printed
_FIGURES = "side_by_side.png", "differences.png", "luminance.png"
_PROCESSES = {"ilit-2006": Separable, "depth-resolved": RadiativeIntegrator}
_INTEGRATORS = INTEGRATORS | {"single-scattering": TabulatedSingleScattering}
_DEFAULTS = cloning.CloneSettings()
_OF_COLOURS = {"photograph", "eye", "limbus", "pupil", "seed"}  # options that --colour uses too


class ClonePicture(opt.Group, panel="Photograph"):
    photograph: Path | None = opt.argument(
        "JPEG, PNG, WebP, HEIC, TIFF, EXR or camera raw", "PHOTO"
    )
    eye: str | None = opt.option(
        "which of several eyes: left or right as the picture shows them, or its number from the "
        "left; default: the one that is seen best",
        metavar="left|right|N",
    )
    focal_px: float | None = opt.number(
        "focal length; default: the file's own", Range(10, 1e6, "pixels")
    )
    limbus: str | None = opt.option(
        "outline of the limbus, in place of the one that is found: centre (column, row), semi-axes "
        "(pixels), angle of the larger one from the right towards the top",
        metavar="X,Y,A,B,DEG",
    )
    pupil: str | None = opt.option("the same for the pupil as it appears", metavar="X,Y,A,B,DEG")
    tilt_azimuth: float | None = opt.number(
        "azimuth of the camera around the eye, from the picture's right to its top; default: "
        "inferred from the pupil",
        Range(-360, 360, "degrees"),
    )
    light: list[str] | None = opt.option(
        "as in render, E its irradiance; repeatable; default: inferred from highlights on the "
        "cornea",
        metavar="POLAR,AZIMUTH[,E]",
    )
    environment: str | None = opt.option(
        "latitude-longitude panorama, or uniform light", metavar="FILE|uniform"
    )
    cross_polarised: bool = opt.flag("the photograph was taken through polarisers")
    second: Path | None = opt.option(
        "another photograph of the eye, best through crossed polarisers: it shows the texture "
        "without highlights; light and pigments are inferred from PHOTO",
        metavar="FILE",
    )
    maps: Path | None = opt.option(
        "thickness (maps.exr), in place of the estimate from the texture", metavar="FILE.exr"
    )
    freckles: Path | None = opt.option(
        "mask in place of freckles.png, white where a freckle is", metavar="FILE.png"
    )
    visible: Path | None = opt.option(
        "mask in place of visible.png, white where nothing hides the iris", metavar="FILE.png"
    )

    def given(self) -> cloning.Given:
        """Read the inputs that replace results of the clone's own stages."""
        environment = None
        if self.environment == "uniform":
            environment = Environment.uniform()
        elif self.environment is not None:
            environment = io.read_environment(self.environment)
        return cloning.Given(
            limbus=parse_outline("--limbus", self.limbus),
            pupil=parse_outline("--pupil", self.pupil),
            lights=parse_lamps(self.light) if self.light else None,
            environment=environment,
            freckles=_mask(self.freckles),
            visible=_mask(self.visible),
            maps=None if self.maps is None else io.read_maps(self.maps),
            second=None if self.second is None else read_photograph(self.second),
            eye=self.eye,
        )


class CloneModel(opt.Group, panel="Model"):
    ONLY_WITH: ClassVar[opt.OnlyWith] = {"deconvolution": ("beta", ())}

    media: str = opt.choice(
        "what light crosses before the iris; flat: nothing, the picture is painted or a texture",
        cloning.MEDIA,
        _DEFAULTS.media,
    )
    iris_depth: float = opt.number(
        "depth of the iris behind the cornea, {}", Range(2.5, 8, "mm"), _DEFAULTS.iris_depth
    )
    beta: float | None = opt.number(
        "thickness by F09's Eq. 7, where it is 0.35; default: by the model's response",
        Range(0, 5, "mm"),
    )
    deconvolution: float | str = opt.option(
        "with --beta: width of the blur by scattering, 0 to 2, or fit: nearest picture",
        _DEFAULTS.sigma,
        parse=opt.number_or("fit", Range(0, 2)),
        metavar="mm|fit",
    )
    method: str = opt.choice(
        "search for the pigments; simplex is F09's", cloning.METHODS, _DEFAULTS.method
    )
    process: str = opt.choice("light in the iris", _PROCESSES, "ilit-2006")
    integrator: str | None = opt.choice(
        "the same as render names it, with F09's renderer, single-scattering, among them",
        _INTEGRATORS,
    )
    seed: int = opt.seeded("files, but for the seconds in clone.json")


class CloneResults(opt.Group, panel="Files"):
    ONLY_WITH: ClassVar[opt.OnlyWith] = {"resume": ("batch", ())}

    output: Path = opt.output("folder for the clone, or with --batch for a folder each", "DIR", ...)
    stop_after: str = opt.choice("last stage", cloning.STAGES, "posterior")
    colour: bool = opt.flag(
        "only the colours of the eye, by rings, corrected for the light by the white of the eye"
    )
    batch: Path | None = opt.option(
        "many photographs: a folder, or a pattern such as 'eyes/*.jpg'", metavar="SOURCE"
    )
    resume: bool = opt.flag("continue a stopped --batch into the same DIR")
    overwrite: bool = opt.flag("replace a clone in that folder")

    @property
    def summary(self) -> str:
        """The file that every finished folder has."""
        return COLOUR_FILES[0] if self.colour else "clone.json"


class CloneRun(NamedTuple):
    """The result of one photograph.

    Attributes:
        found: The last stage.
        files: Contents of files by name.
        doubts: Doubts about the result.
        pictures: Comparison of the clone's picture with the photograph, if it was reached.
        colours: The eye's colours, if they were requested and the outlines are not doubtful.
    """

    found: cloning.Outlined
    files: dict[str, bytes]
    doubts: tuple[Doubt, ...]
    pictures: cloning.PictureDifference | None = None
    colours: EyeColour | None = None


@opt.grouped
def clone_command(
    picture: ClonePicture, model: CloneModel, results: CloneResults, workers: Workers
) -> None:
    """Clone an iris from a photograph: outlines, the iris laid flat, thickness, pigments.

    For example: irisjax clone eye.jpg -o clone_eye

    Exit status: 0; 3 with warnings if an outline is doubtful (give --limbus and
    --pupil), a stage fails (the results of those before it are written), the model
    does not follow the photograph, the posterior has too few effective samples, or a
    photograph of a --batch failed (doubtful ones are counted, and marked in the
    table); 2 for wrong input.
    """
    if (picture.photograph is None) == (results.batch is None):
        sources = "the PHOTO of an eye, or --batch with a folder of photographs"
        raise ValueError(f"give {sources}{'' if results.batch is None else ', not both'}")
    workers.check(results.batch)
    unused = (picture.typed | model.typed) - _OF_COLOURS | (results.typed & {"stop_after"})
    if results.colour and unused:
        options = ", ".join(map(opt.dashed, sorted(unused)))
        raise ValueError(f"--colour does not go with {options}: it needs the outlines only")
    drawing = beside() if "pigments" in _stages(results) else nullcontext(here)
    if results.batch is not None:
        from irisjax.cli.clones import clone_many

        with drawing as draw:
            raise typer.Exit(clone_many(results.batch, picture, model, results, draw, workers))
    assert picture.photograph is not None
    if picture.photograph.is_dir():
        raise ValueError(f"{picture.photograph}: is a folder; --batch clones all photographs in it")
    contents = "an eye's colours" if results.colour else "a clone"
    check_folder(results.output, results.summary, contents, results.overwrite)
    with drawing as draw:
        run = run_clone(picture.photograph, picture, model, results, results.output, draw)
    for note in run.found.photograph.notes:
        opt.notice(f"{picture.photograph}: {note}")
    if run.pictures is not None:
        differences = map(per_cent, (run.pictures.rms, run.pictures.rms_of_pigments))
        sentence = "difference of the pictures, RMS: {} % (R, G, B); by the pigments alone {} %"
        print(sentence.format(*differences))
    for line in () if run.colours is None else colour_lines(run.colours):
        print(line)
    report(run.found, picture.cross_polarised, results.output, run.doubts)
    raise typer.Exit(_DOUBTFUL if run.doubts else 0)


def run_clone(
    path: Path,
    picture: ClonePicture,
    model: CloneModel,
    results: CloneResults,
    folder: Path,
    draw: Callable[..., Later],
    quiet: bool = False,
) -> CloneRun:
    """Clone a photograph, or measure its colours, and write the files into a folder in place of
    those of an earlier run; `quiet` hides the progress bar.

    Raises:
        ValueError: There is no result. The folder then has the outlines, if they were found.
    """
    photograph, inputs = read_photograph(path), picture.given()
    options = {n: v for group in (picture, model) for n, v in vars(group).items() if n != "typed"}
    options |= {"photograph": path}
    texts: dict[str, object] = {n: str(v) if isinstance(v, Path) else v for n, v in options.items()}
    key = key_of(model.seed)

    def with_overlay(found: cloning.Outlined, error: ValueError) -> ValueError:
        folder.mkdir(parents=True, exist_ok=True)
        io.write_together({folder / OVERLAY: overlay_of(found)})
        return ValueError(f"{error}; look at {folder / OVERLAY}")

    if results.colour:
        run = _measure_colours(photograph, inputs, texts, with_overlay, key)
        all_files = {*COLOUR_FILES}
    else:
        settings = _settings(picture, model)
        with tqdm(total=len(_stages(results)), unit="stage", disable=quiet or None) as bar:
            run = _run_stages(
                photograph, settings, inputs, texts, results, draw, bar, with_overlay, key
            )
        all_files = {*CLONE_FILES, *_FIGURES, PHOTOGRAPH}
    folder.mkdir(parents=True, exist_ok=True)
    io.write_together({folder / name: data for name, data in run.files.items()})
    for name in all_files - set(run.files):  # of an earlier, longer run
        (folder / name).unlink(missing_ok=True)
    return run


def _stages(results: CloneResults) -> tuple[str, ...]:
    last = "outlines" if results.colour else results.stop_after
    return cloning.STAGES[: cloning.STAGES.index(last) + 1]


def _measure_colours(
    photograph: Photograph, inputs: cloning.Given, texts, with_overlay, key
) -> CloneRun:
    """Measure the colours of an eye, unless its outlines are doubtful."""
    found = cloning.outline_eye(photograph, inputs)
    doubts, measured = doubts_of(found), None
    if not doubtful_outlines(found):
        try:
            measured = colours_of(found, key=key)
        except ValueError as error:
            raise with_overlay(found, error) from None
        doubts += tuple(Doubt("light", doubt) for doubt in measured[0].doubts)
    files = colour_files(found, measured, texts, doubts)
    return CloneRun(found, files, doubts, colours=None if measured is None else measured[0])


def _run_stages(
    photograph: Photograph,
    settings: cloning.CloneSettings,
    inputs: cloning.Given,
    texts: dict[str, object],
    results: CloneResults,
    draw: Callable[..., Later],
    bar: Any,
    with_overlay: Callable[[cloning.Outlined, ValueError], ValueError],
    key: PRNGKey,
) -> CloneRun:
    """Run the stages of a clone, and count them on the bar."""
    timings: dict[str, float] = {}

    @contextmanager
    def stage(name: str):
        bar.set_description(name)
        begin = time.perf_counter()
        yield
        timings[name] = time.perf_counter() - begin
        bar.update()

    arguments = {"last": results.stop_after, "stage": stage, "tables": cached_tables}
    stages = cloning.clone_eye(photograph, settings, inputs, **arguments, key=key)
    found, comparison, figures, failures = next(stages), None, {}, ()
    try:
        # No stage follows a doubtful outline.
        for stage_result in () if doubtful_outlines(found) else stages:
            found = stage_result
            last = results.stop_after == "pigments" or isinstance(stage_result, cloning.Coloured)
            # Figures are drawn while the posterior is sampled.
            if comparison is None and isinstance(stage_result, cloning.Fitted) and last:
                comparison = cloning.compare_with_photograph(stage_result)
                eye = stage_result.scene().eye
                pictures = comparison.photograph, comparison.rendered
                radius = float(0.5 * (eye.pupil_radius + eye.iris_radius))
                along = *comparison.arc(stage_result, radius), radius
                figures = {
                    "side_by_side.png": draw("side_by_side", *pictures),
                    "differences.png": draw("differences", *pictures, comparison.clear),
                    "luminance.png": draw("luminance_profile", *along),
                }
    except ValueError as error:
        if not isinstance(found, cloning.Shaped):
            raise with_overlay(found, error) from None
        message = f"{_stages(results)[len(timings)]}: {error}; the stages before it are written"
        failures = (Doubt("model", message),)
    doubts = doubts_of(found, None if comparison is None else comparison.rms_of_pigments) + failures
    files = files_of(found, texts, timings, comparison, doubts)
    if comparison is not None:
        files |= {name: figure() for name, figure in figures.items()}
        files[PHOTOGRAPH] = encode_photograph(comparison.balanced)
    return CloneRun(found, files, doubts, comparison)


def report(
    found: cloning.Outlined, cross_polarised: bool, folder: Path, doubts: tuple[Doubt, ...]
) -> None:
    """Print the results, and doubts on standard error."""
    left, right, top, bottom = found.crop()
    rows, columns = found.photograph.shape
    eyes = found.boundaries.eyes
    if eyes > 1 or (right - left) * (bottom - top) < _SMALL_PART * rows * columns:
        which = f"of {eyes} eyes the one" if eyes > 1 else "the eye"
        other = " (--eye takes another)" if eyes > 1 else ""
        done = "cloned" if isinstance(found, cloning.Fitted) else "looked at"
        print(f"{which} in columns {left} to {right}, rows {top} to {bottom} is {done}{other}")
    for doubt in doubts:
        opt.notice(f"WARNING: {doubt.sentence}")
    if isinstance(found, cloning.Posed):
        pose = found.pose
        distance = "" if pose.distance is None else f", {pose.distance:.0f} mm away"
        low, high = np.degrees(pose.tilt_interval)
        print(
            f"camera: {np.degrees(pose.tilt):.1f} ({low:.1f} to {high:.1f}) degrees off the "
            f"eye's axis{distance}; pupil {2 * pose.pupil_radius:.2f} mm wide, lengths for "
            f"a limbus of {2 * float(pose.eye.limbus_radius):.1f} mm"
        )
        if pose.distance is None:
            opt.notice("no focal length in the file: the distance is not known; give --focal-px")
    if isinstance(found, cloning.Fitted):
        if cross_polarised:
            opt.notice(
                "WARNING: the model's iris keeps 98 % and more of the light's polarisation, so "
                "crossed polarisers would make it black; the pigments are those of an iris that "
                "depolarises"
            )
        if found.lighting.found == 0 and found.pose.eye.cornea is not None:
            opt.notice(
                "no highlight on the cornea shows a lamp: light from all round is assumed; if the "
                "picture shows no cornea, painted or a texture, give --media flat"
            )
    melanin = found.abl_melanin() if isinstance(found, cloning.Coloured) else None
    if melanin is not None:
        mean, low, high = melanin
        print(f"melanin of the ABL, mean of the texels: {mean:.3g} ({low:.3g} to {high:.3g}) mg/ml")
    if isinstance(found, cloning.Sampled) and pigments_withheld(found, doubts):
        which = "the pigments are" if melanin is None else "otherwise the pigments are"
        print(f"{which} not printed, for the doubts above; clone.json has them")
    elif isinstance(found, cloning.Sampled):
        print(f"{'parameter':<20}{'median':>10}{'95 %':>22}{'contraction':>13}")
        for name, e in found.posterior.estimates.items():
            span = f"{e.low:.3g} to {e.high:.3g}"
            print(f"{name:<20}{e.median:>10.3g}{span:>22}{e.contraction:>13.2f}")
        print("the intervals allow for a thickness and shading unlike the model's")
    print(f"written: {folder}")


def colour_lines(colours: EyeColour) -> list[str]:
    """Return the colours of an eye as sentences."""
    lines = ["colours in L*a*b* (D65) with 95 % intervals, by the white that colour.png marks:"]
    for name, region in colours.regions.items():
        place = f"{100 * region.share:.0f} % visible"
        if name in RINGS:
            low, high = (f"{100 * border:.0f}" for border in RINGS[name])
            place = f"{low} to {high} % of the way from pupil to limbus, {place}"
        lines.append(f"{name} ({place}): {_lab_in_words(region)}")
    for region in colours.dominant:
        lines.append(f"{100 * region.share:.0f} % of what is visible: {_lab_in_words(region)}")
    if colours.difference is not None:
        spans = zip("Lab", *colours.difference, strict=True)
        differences = ", ".join(
            f"{c}* {x:+.0f} ({low:+.0f} to {high:+.0f})" for c, x, low, high in spans
        )
        lines.append(f"the pupillary ring differs from the ciliary ring by {differences}")
    return lines


def _lab_in_words(region: RegionColour) -> str:
    spans = zip("Lab", region.lab, region.low, region.high, strict=True)
    return ", ".join(f"{c}* {x:.0f} ({low:.0f} to {high:.0f})" for c, x, low, high in spans)


def pigments_withheld(found: cloning.Outlined, doubts: tuple[Doubt, ...]) -> bool:
    """Return whether a clone has no pigments, or they are too doubtful to be printed."""
    return not isinstance(found, cloning.Sampled) or any(d.kind == "model" for d in doubts)


def _settings(picture: ClonePicture, model: CloneModel) -> cloning.CloneSettings:
    azimuth, sigma = picture.tilt_azimuth, model.deconvolution
    if model.integrator is not None and "process" in model.typed:
        raise ValueError("--integrator names the process too; give no --process")
    integrator: Any = _INTEGRATORS.get(model.integrator or "", _PROCESSES[model.process])
    return cloning.CloneSettings(
        focal_px=picture.focal_px,
        azimuth=None if azimuth is None else float(np.radians(azimuth)),
        sigma=None if isinstance(sigma, str) else sigma,
        integrator=integrator(),
        **{n: getattr(model, n) for n in ("media", "iris_depth", "beta", "method")},
    )


def _mask(path: Path | None) -> np.ndarray | None:
    return None if path is None else io.read_image(path).pixels[..., 0] > 0.5
