"""`irisjax spectrum`, `brdf` and `colour`: virtual instruments, CSV out."""

from pathlib import Path

import numpy as np
import typer

import irisjax as ij
from irisjax import io, plot
from irisjax.cli.files import SwatchFile, TableFiles, check_files, write_table
from irisjax.cli.header import head
from irisjax.cli.jobs import measured
from irisjax.cli.light import BrdfLight, ColourLight, SpectrumLight
from irisjax.cli.model import (
    IrisOptions,
    ProcessOptions,
    SolverOptions,
    iris_of,
    process_of,
)
from irisjax.cli.options import grouped


@grouped
def spectrum(
    iris: IrisOptions,
    process: ProcessOptions,
    solver: SolverOptions,
    light: SpectrumLight,
    files: TableFiles,
) -> None:
    """Spectral reflectance of an iris, or its radiance under an illuminant, as CSV."""
    check_files(files.output, files.plot)
    modelled, rules, grid = iris_of(iris), process_of(process), light.wavelengths.values
    if light.instrument == "radiance":
        instrument = ij.Radiometer(illuminant=light.illuminant, **light.setup())
    else:
        instrument = ij.Spectrophotometer(**light.setup())
    result = measured(modelled, instrument, rules, solver)
    columns = {"wavelength_nm": grid, result.quantity: result.values}
    if result.standard_error is not None:
        columns["standard_error"] = result.standard_error
    lines = head("spectrum", result.quantity, modelled, rules, (iris, process, solver, light))
    if result.unit:
        lines["unit"] = f"{result.unit} [the illuminant is 1 at 560 nm]"
    title = _title(result.quantity, process, solver)
    write_table(
        files.output, lines, columns, files.plot, lambda: plot.spectra_figure({"": result}, title)
    )


@grouped
def brdf(
    iris: IrisOptions,
    process: ProcessOptions,
    solver: SolverOptions,
    light: BrdfLight,
    files: TableFiles,
) -> None:
    """BRDF of an iris in the aqueous humour, without the light mirrored by its surface, as CSV."""
    check_files(files.output, files.plot)
    angle, azimuth = _exits(light.plane, light.angles)
    modelled, rules, grid = iris_of(iris), process_of(process), light.wavelengths.values
    instrument = ij.Goniophotometer(cos_exit=np.cos(angle), azimuth=azimuth, **light.setup())
    result = measured(modelled, instrument, rules, solver)
    rows = np.broadcast_to(grid[:, None], result.values.shape)
    columns = {
        "wavelength_nm": rows.ravel(),
        "angle_deg": np.broadcast_to(np.degrees(angle), rows.shape).ravel(),
        "azimuth_deg": np.broadcast_to(np.degrees(azimuth), rows.shape).ravel(),
        "brdf_per_sr": result.values.ravel(),
    }
    if result.standard_error is not None:
        columns["standard_error"] = result.standard_error.ravel()
    lines = head("brdf", "BRDF", modelled, rules, (iris, process, solver, light))
    lines["directions"] = (
        "angle from the normal; azimuth 0 is the mirror direction's side, 180 the light's"
    )
    title = _title("BRDF", process, solver)
    write_table(files.output, lines, columns, files.plot, lambda: plot.brdf_figure(result, title))


@grouped
def colour(
    iris: IrisOptions,
    process: ProcessOptions,
    solver: SolverOptions,
    light: ColourLight,
    files: SwatchFile,
) -> None:
    """Colour of an iris under an illuminant: XYZ, CIE L*a*b*, sRGB, and a swatch."""
    check_files(None, files.swatch, ".png")
    modelled, rules = iris_of(iris), process_of(process)
    instrument = ij.Colorimeter(
        illuminant=light.illuminant, observer=light.observer, **light.setup()
    )
    result = measured(modelled, instrument, rules, solver)
    red, green, blue = (int(v) for v in np.rint(255 * np.clip(np.asarray(result.srgb), 0, 1)))
    srgb8 = (red, green, blue)
    clipped = "" if result.in_gamut else "outside sRGB's gamut: the 8-bit values are clipped"
    lines = head("colour", "colour", modelled, rules, (iris, process, solver, light))
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
    return f"Simulated {quantity} of an iris ({process.process}, {how})"


def _row(name: str, numbers, form: str, remark: str = "") -> str:
    shown = " ".join(f"{format(v, form):>11}" for v in np.asarray(numbers).tolist())
    return f"{name:<12}{shown}   {remark}".rstrip()


def _paint(path: Path, srgb8: tuple[int, int, int], remark: str) -> None:
    io.write_atomically(path, plot.swatch(srgb8, f"simulated colour of an iris {remark}"))
