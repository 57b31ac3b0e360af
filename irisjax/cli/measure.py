"""`irisjax spectrum`, `brdf` and `colour`: virtual instruments, CSV out."""

import re
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import typer

import irisjax as ij
from irisjax import io, plot
from irisjax.cli.files import SwatchFile, TableFiles, check_files, write_table
from irisjax.cli.header import head
from irisjax.cli.jobs import few_photons, left_out_by_scalar_theory, measured
from irisjax.cli.light import POLARIMETERS, BrdfLight, ColourLight, Light, SpectrumLight
from irisjax.cli.model import (
    IrisOptions,
    ProcessOptions,
    SolverOptions,
    check_scattering,
    modelled_iris,
    process_of,
    sampling_key,
    solver_of,
)
from irisjax.cli.options import grouped
from irisjax.measure.instrument import AbstractInstrument
from irisjax.measure.photometers import (
    Colorimeter,
    Goniophotometer,
    Radiometer,
    Spectrophotometer,
)
from irisjax.measure.polarimeter import (
    Analyser,
    AnalyserSetting,
    Polarimeter,
    PolarisedReading,
)
from irisjax.transport.process import DEPTH_RESOLVED

_QUANTITIES = {
    "cross-polarised": "cross-polarised reflectance",
    "co-polarised": "co-polarised reflectance",
    "degree-of-polarisation": "degree of linear polarisation",
}
_SETTINGS: dict[str, AnalyserSetting] = {"cross-polarised": "crossed", "co-polarised": "parallel"}


@grouped
def spectrum_command(
    iris: IrisOptions,
    process: ProcessOptions,
    solver: SolverOptions,
    light: SpectrumLight,
    files: TableFiles,
) -> None:
    """Compute the reflectance of an iris, or its radiance under an illuminant, as CSV."""
    check_files(files.output, files.plot)
    if light.instrument in POLARIMETERS:
        process = process.seeing_polarisation(light.instrument)
    grid = light.wavelengths.values
    make = partial(_instrument, light)
    quantity = _QUANTITIES.get(light.instrument, light.instrument)
    result, lines = _read(make, quantity, "spectrum", iris, process, solver, light)
    columns = {"wavelength_nm": grid, re.sub(r"\W", "_", result.quantity): result.values}
    if isinstance(result, PolarisedReading):
        columns["angle_deg"] = np.degrees(result.angle)
    if result.standard_error is not None:
        columns["standard_error"] = result.standard_error
    if result.unit:
        lines["unit"] = f"{result.unit} [the illuminant is 1 at 560 nm]"
    title = _title(result.quantity, process, solver)
    write_table(
        files.output, lines, columns, files.plot, lambda: plot.spectra_figure({"": result}, title)
    )


@grouped
def brdf_command(
    iris: IrisOptions,
    process: ProcessOptions,
    solver: SolverOptions,
    light: BrdfLight,
    files: TableFiles,
) -> None:
    """Compute the BRDF of an iris in the aqueous humour, without its surface's reflection."""
    check_files(files.output, files.plot)
    angle, azimuth = _exits(light.plane, light.angles)
    grid, told = light.wavelengths.values, light.before_the_iris()
    make = partial(Goniophotometer, cos_exit=np.cos(angle), azimuth=azimuth, **told)
    result, lines = _read(make, "BRDF", "brdf", iris, process, solver, light)
    rows = np.broadcast_to(grid[:, None], result.values.shape)
    columns = {
        "wavelength_nm": rows.ravel(),
        "angle_deg": np.broadcast_to(np.degrees(angle), rows.shape).ravel(),
        "azimuth_deg": np.broadcast_to(np.degrees(azimuth), rows.shape).ravel(),
        "brdf_per_sr": result.values.ravel(),
    }
    if result.standard_error is not None:
        columns["standard_error"] = result.standard_error.ravel()
    lines["directions"] = (
        "angle from the normal; azimuth 0 is the mirror direction's side, 180 the light's"
    )
    title = _title("BRDF", process, solver)
    write_table(files.output, lines, columns, files.plot, lambda: plot.brdf_figure(result, title))


@grouped
def colour_command(
    iris: IrisOptions,
    process: ProcessOptions,
    solver: SolverOptions,
    light: ColourLight,
    files: SwatchFile,
) -> None:
    """Compute the colour of an iris under an illuminant: XYZ, CIE L*a*b*, sRGB, and a swatch."""
    check_files(None, files.swatch, ".png")
    make = partial(
        Colorimeter,
        illuminant=light.illuminant,
        observer=light.observer,
        **light.before_the_iris(),
    )
    result, lines = _read(make, "colour", "colour", iris, process, solver, light)
    red, green, blue = (int(v) for v in np.rint(255 * np.clip(np.asarray(result.srgb), 0, 1)))
    srgb8 = (red, green, blue)
    clipped = "" if result.in_gamut else "outside sRGB's gamut: the 8-bit values are clipped"
    rows = [
        *(f"# {key}: {value}" for key, value in lines.items()),
        _row("XYZ", result.xyz, ".6f", "(white has Y = 1)"),
        _row("L*a*b*", result.lab, ".4f"),
        _row("sRGB linear", result.srgb_linear, ".6f"),
        _row("sRGB 8 bit", srgb8, "d", "#" + "".join(f"{v:02x}" for v in srgb8)),
        f"{'gamut':<12}{clipped or 'inside sRGB'}",
    ]
    if files.swatch is not None:
        _paint(files.swatch, srgb8, f"under {light.illuminant}; {clipped}".rstrip("; "))
    typer.echo("\n".join(rows))


def _instrument(light: SpectrumLight, grid: np.ndarray) -> AbstractInstrument:
    """What measures the spectrum."""
    told = light.before_the_iris()
    if light.instrument == "radiance":
        return Radiometer(grid, illuminant=light.illuminant, **told)
    if light.instrument == "reflectance":
        return Spectrophotometer(grid, **told)
    told |= light.exit()
    if light.instrument == "degree-of-polarisation":
        return Polarimeter(grid, **told)
    return Analyser(grid, _SETTINGS[light.instrument], **told)


def _read(
    make: Callable[[np.ndarray], AbstractInstrument],
    quantity: str,
    command: str,
    iris: IrisOptions,
    process: ProcessOptions,
    solver: SolverOptions,
    light: Light,
) -> tuple[Any, dict[str, str]]:
    """What the instrument that is made for the wavelengths reads, and the header that says how."""
    modelled, rules = modelled_iris(iris), process_of(process)
    check_scattering(modelled, rules)
    grid = light.wavelengths.values
    instrument = make(grid)
    method = solver_of(solver, rules, modelled, exits=instrument.exits is not None)
    result = measured(modelled, instrument, method, sampling_key(solver))
    if (doubt := few_photons(result)) is not None:
        print(f"irisjax: WARNING: {doubt}", file=sys.stderr)
    left_out = None
    if rules == DEPTH_RESOLVED:
        left_out = left_out_by_scalar_theory(modelled, make, grid)
    groups = (iris, process, solver, light)
    return result, head(command, quantity, modelled, rules, method, groups, left_out)


def _exits(plane: str, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Exit angles from the normal and azimuths, radians; n over 180 degrees, grazing left out."""
    if plane == "principal":
        signed, _, azimuth = (np.asarray(a) for a in ij.principal_plane(n))
        return np.abs(signed), azimuth
    polar = (np.arange(n // 2) + 0.5) / (n // 2) * np.pi / 2
    azimuth = np.arange(n) / n * 2 * np.pi
    polar, azimuth = np.meshgrid(polar, azimuth, indexing="ij")
    return polar.ravel(), azimuth.ravel()


def _title(quantity: str, process: ProcessOptions, solver: SolverOptions) -> str:
    how = "exact" if solver.solver == "exact" else f"{solver.photons:g} photons"
    rules = f"{process.process}{', polarised' if process.polarised else ''}"
    return f"Simulated {quantity} of an iris ({rules}, {how})"


def _row(name: str, numbers, form: str, remark: str = "") -> str:
    shown = " ".join(f"{format(v, form):>11}" for v in np.asarray(numbers).tolist())
    return f"{name:<12}{shown}   {remark}".rstrip()


def _paint(path: Path, srgb8: tuple[int, int, int], remark: str) -> None:
    io.write_atomically(path, plot.swatch(srgb8, f"simulated colour of an iris {remark}"))
