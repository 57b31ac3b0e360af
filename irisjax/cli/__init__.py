"""The command `irisjax`: settings in, files out. Thin; no equations here."""

import inspect
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
import typer
from typer.main import get_command

import irisjax as ij
from irisjax import io, plot
from irisjax.cli import cache
from irisjax.cli.export import export
from irisjax.cli.fit import EPILOG, fit
from irisjax.cli.jobs import directions, head, measured, problem, simulated_measurement, truth
from irisjax.cli.render import render
from irisjax.cli.settings import COMMANDS, header, settled
from irisjax.cli.view import view

app = typer.Typer(
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main(arguments: list[str] | None = None) -> None:
    """Run the command and leave with its status; see `run`."""
    sys.exit(run(arguments))


def run(arguments: list[str] | None = None) -> int:
    """Run the command with these arguments (default: the process's own) and return its exit status.

    0, or 2 for wrong input, 130 for Ctrl-C, 1 for a fault of our own; whatever goes wrong ends in
    one line on standard error. With IRISJAX_DEBUG=1 exceptions pass.
    """
    try:
        jax.config.update(
            "jax_enable_x64", True
        )  # the one place where the package chooses a precision
        cache.keep_compiled()
        arguments = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
        status = get_command(app).main(arguments, prog_name="irisjax", standalone_mode=False)
        sys.stdout.flush()
        if status == 130:  # typer's way of passing on an interrupt
            return _complain("interrupted", 130)
        return status if isinstance(status, int) else 0
    except (KeyboardInterrupt, typer.Abort):
        return _complain("interrupted", 130)
    except (
        BrokenPipeError
    ):  # `irisjax spectrum | head` is no fault, nor may the flush at exit complain
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if os.environ.get("IRISJAX_DEBUG"):
            raise
        # typer's own errors: their base class has moved between versions, the method has not.
        if (format_message := getattr(error, "format_message", None)) is not None:
            return _complain(format_message(), 2)
        if isinstance(error, OSError) and error.strerror:
            return _complain(
                f"{error.filename}: {error.strerror}" if error.filename else error.strerror, 2
            )
        if isinstance(error, ValueError):
            return _complain(str(error), 2)
        if isinstance(error, MemoryError):
            return _complain("not enough memory for so many wavelengths, directions or photons", 2)
        return _complain(
            f"internal error: {type(error).__name__}: {error} (IRISJAX_DEBUG=1 tells more)", 1
        )


def _complain(message: str, status: int) -> int:
    print("irisjax:", " ".join(message.split()), file=sys.stderr)
    return status


def _command(function: Callable[[dict[str, Any]], None]) -> None:
    """Make `function(values)` a command with the options of its table in `COMMANDS`."""
    name = function.__name__.replace("_", "-")
    parameters = [setting.parameter() for setting in COMMANDS[name]]

    def command(**given):
        function(
            settled(name, {option: value for option, value in given.items() if value is not None})
        )

    command.__doc__ = function.__doc__
    # typer reads a command's options from its signature and annotations.
    command.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportFunctionMemberAccess]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    app.command(name)(command)


@app.callback(invoke_without_command=True)
def _irisjax(
    version: bool = typer.Option(False, "--version", help="Print the version and leave."),
) -> None:
    """Predictive spectra, BRDF and colour of the human iris from its pigments.

    Its spectra and colours are simulated. Files carry every setting in their header; `--from
    FILE.csv` runs one again.
    """
    if version:
        typer.echo(f"irisjax {ij.__version__}")
        raise typer.Exit


@_command
def spectrum(values: dict[str, Any]) -> None:
    """Spectral reflectance of an iris, or its radiance under an illuminant, as CSV."""
    _check_files(values, "output", "plot")
    iris, grid, options = problem(values)
    options["first_surface"] = values["first_surface"]
    if values["instrument"] == "radiance":
        options["illuminant"] = values["illuminant"]
    instrument = {"reflectance": ij.reflectance, "radiance": ij.radiance}[values["instrument"]]
    result = measured(instrument, iris, grid, options)
    notes = {"unit": result.unit + " [the illuminant is 1 at 560 nm]"} if result.unit else {}
    columns = {"wavelength_nm": grid, result.quantity: result.values}
    if result.standard_error is not None:
        columns["standard_error"] = result.standard_error
    lines = head("spectrum", result.quantity, values, iris, options) | notes
    _write(
        values,
        lines,
        columns,
        lambda: plot.spectra_figure({"": result}, _title(values, result.quantity)),
    )


@_command
def brdf(values: dict[str, Any]) -> None:
    """BRDF of an iris in the aqueous humour, without the light mirrored by its surface, as CSV."""
    _check_files(values, "output", "plot")
    iris, grid, options = problem(values)
    angle, azimuth = directions(values["plane"], values["angles"])
    result = measured(
        ij.brdf, iris, grid, options | {"cos_exit": np.cos(angle), "azimuth": azimuth}
    )
    rows = np.broadcast_to(grid[:, None], result.values.shape)
    columns = {
        "wavelength_nm": rows.ravel(),
        "angle_deg": np.broadcast_to(np.degrees(angle), rows.shape).ravel(),
        "azimuth_deg": np.broadcast_to(np.degrees(azimuth), rows.shape).ravel(),
        "brdf_per_sr": result.values.ravel(),
    }
    if result.standard_error is not None:
        columns["standard_error"] = result.standard_error.ravel()
    lines = head("brdf", "BRDF", values, iris, options)
    lines["directions"] = (
        "angle from the normal; azimuth 0 is the mirror direction's side, 180 the light's"
    )
    _write(values, lines, columns, lambda: plot.brdf_figure(result, _title(values, "BRDF")))


@_command
def colour(values: dict[str, Any]) -> None:
    """Colour of an iris under an illuminant: XYZ, CIE L*a*b*, sRGB, and a swatch."""
    _check_files(values, "swatch")
    if (swatch := values["swatch"]) is not None:
        plot.check_suffix(swatch, (".png",))
    iris, grid, options = problem(values)
    options |= {name: values[name] for name in ("first_surface", "illuminant", "observer")}
    result = measured(ij.colour, iris, grid, options)
    red, green, blue = (int(v) for v in np.rint(255 * np.clip(np.asarray(result.srgb), 0, 1)))
    srgb8 = (red, green, blue)
    clipped = "" if result.in_gamut else "outside sRGB's gamut: the 8-bit values are clipped"

    lines = [
        f"# {key}: {value}"
        for key, value in head("colour", "colour", values, iris, options).items()
    ]
    lines += [
        _row("XYZ", result.xyz, ".6f", "(white has Y = 1)"),
        _row("L*a*b*", result.lab, ".4f"),
        _row("sRGB linear", result.srgb_linear, ".6f"),
        _row("sRGB 8 bit", srgb8, "d", "#" + "".join(f"{v:02x}" for v in srgb8)),
        f"{'gamut':<12}{clipped or 'inside sRGB'}",
    ]
    if swatch is not None:
        remark = f"simulated colour of an iris under {values['illuminant']}; {clipped}".rstrip("; ")
        io.write_atomically(swatch, plot.swatch(srgb8, remark))
    typer.echo("\n".join(lines))


@_command
def simulate_measurement(values: dict[str, Any]) -> None:
    """A noisy spectrum of a modelled iris with its truth in the header, to try `irisjax fit` on."""
    _check_files(values, "output")
    iris, grid, process, reading = simulated_measurement(values)
    lines = {
        "irisjax": ij.__version__,
        "simulated": "noisy reflectance of a modelled human iris, not a measurement",
        "command": "simulate-measurement",
        **header("simulate-measurement", values, iris, process),
        "truth": truth(iris, values),
    }
    names = ["reflectance"] if len(reading) == 1 else [f"scan_{i + 1}" for i in range(len(reading))]
    text = io.format_table(lines, {"wavelength_nm": grid, **dict(zip(names, reading, strict=True))})
    if values["output"] is None:
        sys.stdout.write(text)
    else:
        io.write_atomically(values["output"], text.encode())


app.command("fit", epilog=EPILOG)(fit)
app.command("render")(render)
app.command("export")(export)
app.command("view")(view)


def _row(name: str, numbers, form: str, remark: str = "") -> str:
    shown = " ".join(f"{format(v, form):>11}" for v in np.asarray(numbers).tolist())
    return f"{name:<12}{shown}   {remark}".rstrip()


def _title(values: Mapping[str, Any], quantity: str) -> str:
    solver = values["solver"] if values["solver"] == "exact" else f"{values['photons']:g} photons"
    return f"Simulated {quantity} of an iris ({values['process']}, {solver})"


def _check_files(values: Mapping[str, Any], *names: str) -> None:
    """Find out before the work whether its results can be kept."""
    paths = [Path(values[name]) for name in names if values[name] is not None]
    for path in paths:
        io.check_writable(path)
    if len({path.resolve() for path in paths}) < len(paths):
        raise ValueError(f"{paths[0]}: data and figure cannot go to the same file")
    if "plot" in names and values["plot"] is not None:
        plot.check_suffix(values["plot"])


def _write(values: Mapping[str, Any], lines, columns, figure: Callable[[], Any]) -> None:
    """Write CSV and figure, both made before either is written."""
    text = io.format_table(lines, {name: np.asarray(column) for name, column in columns.items()})
    target = values["plot"]
    picture = None if target is None else plot.picture(figure(), target.suffix)
    files = {} if values["output"] is None else {values["output"]: text.encode()}
    if target is not None and picture is not None:
        files[target] = picture
    io.write_together(files)
    if values["output"] is None:
        sys.stdout.write(text)
