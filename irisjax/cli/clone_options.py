"""Options of `irisjax clone`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from irisjax import io
from irisjax.cli.options import (
    SEED_HELP,
    Group,
    named_option,
    number_or,
    number_parser,
    option,
    read_seed,
    whole_parser,
)
from irisjax.cli.scenes import lamps
from irisjax.io.photographs import read_photograph
from irisjax.photo import clone as cloning
from irisjax.photo.photograph import Ellipse
from irisjax.render.environment import Environment
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.separable import Separable

_PROCESSES = {"ilit-2006": Separable, "depth-resolved": RadiativeIntegrator}


@dataclass(frozen=True, kw_only=True)
class ClonePicture(Group):
    """Options: the photograph and what is known about it."""

    PANEL = "Photograph"

    photograph: Annotated[
        Path,
        typer.Argument(
            metavar="PHOTO", help="JPEG, PNG, TIFF, EXR or camera raw", show_default=False
        ),
    ]
    focal_px: Annotated[
        float | None,
        option(
            parse=number_parser(10, 1e6),
            metavar="pixels",
            help="focal length; default: the file's own",
        ),
    ] = None
    limbus: Annotated[
        str | None,
        option(
            metavar="X,Y,A,B,DEG",
            help="outline of the limbus, in place of the one that is found: centre (column, row), "
            "semi-axes (pixels), angle of the larger one from the right towards the top",
        ),
    ] = None
    pupil: Annotated[
        str | None, option(metavar="X,Y,A,B,DEG", help="the same for the pupil as it appears")
    ] = None
    tilt_azimuth: Annotated[
        float | None,
        option(
            parse=number_parser(-360, 360),
            metavar="degrees",
            help="azimuth of the camera around the eye, from the picture's right to its top; "
            "default: inferred from the pupil",
        ),
    ] = None
    light: Annotated[
        list[str] | None,
        option(
            metavar="POLAR,AZIMUTH[,E]",
            help="as in render, E its irradiance; repeatable; default: inferred from highlights on "
            "the cornea",
        ),
    ] = None
    environment: Annotated[
        str | None,
        option(metavar="FILE|uniform", help="latitude-longitude panorama, or uniform light"),
    ] = None
    cross_polarised: Annotated[
        bool,
        option("--cross-polarised", metavar="", help="the photograph was taken through polarisers"),
    ] = False
    second: Annotated[
        Path | None,
        option(
            metavar="FILE",
            help="another photograph of the eye, best through crossed polarisers: it shows the "
            "texture without highlights; light and pigments are inferred from PHOTO",
        ),
    ] = None
    maps: Annotated[
        Path | None,
        option(
            metavar="FILE.exr",
            help="thickness (maps.exr), in place of the estimate from the texture",
        ),
    ] = None
    freckles: Annotated[
        Path | None,
        option(metavar="FILE.png", help="mask in place of freckles.png, white where a freckle is"),
    ] = None

    visible: Annotated[
        Path | None,
        option(
            metavar="FILE.png",
            help="mask in place of visible.png, white where nothing hides the iris",
        ),
    ] = None

    def given(self) -> cloning.Given:
        """Return what is given, read from its files."""
        lights = lamps(self.light) if self.light else None
        around = None
        if self.environment == "uniform":
            around = Environment.uniform()
        elif self.environment is not None:
            around = io.read_environment(self.environment)
        return cloning.Given(
            limbus=_outline("--limbus", self.limbus),
            pupil=_outline("--pupil", self.pupil),
            lights=lights,
            environment=around,
            freckles=_mask(self.freckles),
            visible=_mask(self.visible),
            maps=None if self.maps is None else io.read_maps(self.maps),
            second=None if self.second is None else read_photograph(self.second),
        )


@dataclass(frozen=True, kw_only=True)
class CloneModel(Group):
    """Options: the model of the eye."""

    PANEL = "Model"

    media: Annotated[str, named_option("what light crosses before the iris", *cloning.MEDIA)] = (
        "cornea-aqueous"
    )
    iris_depth: Annotated[
        float,
        option(
            parse=number_parser(2.5, 8),
            metavar="mm",
            help="depth of the iris behind the cornea, 2.5 to 8",
        ),
    ] = 3.6
    beta: Annotated[
        float | None,
        option(
            parse=number_parser(0, 5),
            metavar="mm",
            help="thickness by F09's Eq. 7, where it is 0.35; default: by the model's response",
        ),
    ] = None
    deconvolution: Annotated[
        Any,  # a number or the word
        option(
            parse=number_or("fit", 0, 2),
            metavar="mm|fit",
            help="with --beta: width of the blur by scattering, 0 to 2, or fit: nearest picture",
        ),
    ] = 0.5
    relief: Annotated[
        float,
        option(
            parse=number_parser(0, 1),
            metavar="share",
            help="share of the stroma's unevenness that stands out towards the cornea, 0 to 1; in "
            "light eyes its shading is removed",
        ),
    ] = 0.0
    method: Annotated[
        str, named_option("search for the pigments; simplex is F09's", *cloning.METHODS)
    ] = "least-squares"
    process: Annotated[str, named_option("light in the iris", *_PROCESSES)] = "ilit-2006"
    max_steps: Annotated[
        int,
        option(
            parse=whole_parser(150, 100_000),
            metavar="count",
            help="most steps of the posterior's chain",
        ),
    ] = 8000
    seed: Annotated[
        int,
        option(
            parse=read_seed,
            metavar="number",
            help=SEED_HELP + "files, but for the seconds in clone.json",
        ),
    ] = 0

    def __post_init__(self):
        super().__post_init__()
        if self.beta is None and "deconvolution" in self.typed:
            raise ValueError("--deconvolution means something only with --beta")


@dataclass(frozen=True, kw_only=True)
class CloneResults(Group):
    """Options: the files."""

    PANEL = "Files"

    output: Annotated[Path, option("-o", "--output", metavar="DIR", help="folder for the clone")]
    stop_after: Annotated[str, named_option("last stage", *cloning.STAGES)] = "posterior"
    overwrite: Annotated[
        bool, option("--overwrite", metavar="", help="replace a clone in that folder")
    ] = False


def settings_of(picture: ClonePicture, model: CloneModel) -> cloning.CloneSettings:
    """Return the settings of a clone."""
    return cloning.CloneSettings(
        model.media,
        model.iris_depth,
        picture.focal_px,
        None if picture.tilt_azimuth is None else float(np.radians(picture.tilt_azimuth)),
        sigma=None if model.deconvolution == "fit" else model.deconvolution,
        beta=model.beta,
        relief=model.relief,
        method=model.method,
        integrator=_PROCESSES[model.process](),
        steps=model.max_steps,
    )


def _mask(path: Path | None) -> np.ndarray | None:
    return None if path is None else io.read_image(path).pixels[..., 0] > 0.5


def _outline(name: str, text: str | None) -> Ellipse | None:
    if text is None:
        return None
    try:
        x, y, a, b, degrees = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} {text!r}: write X,Y,A,B,DEG, five numbers") from None
    if not (a >= b > 0 and np.isfinite([x, y, a, b, degrees]).all()):
        raise ValueError(f"{name} {text!r}: the semi-axes must be A >= B > 0")
    return Ellipse((x, y), (a, b), float(np.radians(degrees)))
