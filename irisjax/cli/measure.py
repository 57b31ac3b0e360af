"""`irisjax spectrum`, `brdf`, `colour`, `simulate-measurement`: virtual instruments, CSV out."""

import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import typer
from tqdm import tqdm

import irisjax as ij
from irisjax import io, plot
from irisjax.cli import light as lights
from irisjax.cli import model
from irisjax.cli import options as opt
from irisjax.cli.files import (
    SwatchFile,
    TableFile,
    TableFiles,
    check_files,
    file_header,
    write_table,
)
from irisjax.infer.parameters import of_iris
from irisjax.measure.observe import observe
from irisjax.measure.polarimeter import PolarisedReading
from irisjax.numerics.streams import key_of
from irisjax.transport.montecarlo import MonteCarlo
from irisjax.transport.process import DEPTH_RESOLVED, POLARISED
from irisjax.transport.solver import AbstractSolver

_QUANTITIES = {
    "cross-polarised": "cross-polarised reflectance",
    "co-polarised": "co-polarised reflectance",
    "degree-of-polarisation": "degree of linear polarisation",
}
_FEW_WAVELENGTHS, _FEW_PHOTONS = 7, 10


@opt.grouped
def spectrum_command(
    iris: model.IrisOptions,
    process: model.ProcessOptions,
    solver: model.SolverOptions,
    light: lights.SpectrumLight,
    files: TableFiles,
) -> None:
    """Compute the reflectance of an iris, or its radiance under an illuminant, as CSV."""
    check_files(files.output, files.plot)
    if light.instrument in lights.POLARIMETERS:
        process = process.seeing_polarisation(light.instrument)
    quantity = _QUANTITIES.get(light.instrument, light.instrument)
    light = lights.with_band_centres(light)
    result, lines = _read_instrument("spectrum", quantity, iris, process, solver, light)
    column = re.sub(r"\W", "_", result.quantity)
    columns = {"wavelength_nm": result.wavelengths, column: result.values}
    if isinstance(result, PolarisedReading):
        columns["angle_deg"] = np.degrees(result.angle)
    if result.standard_error is not None:
        columns["standard_error"] = result.standard_error
    if result.unit:
        lines["unit"] = f"{result.unit} [the illuminant is 1 at 560 nm]"
    title = _title(result.quantity, process, solver)
    write_table(files, lines, columns, lambda: plot.spectra_figure({"": result}, title))


@opt.grouped
def brdf_command(
    iris: model.IrisOptions,
    process: model.ProcessOptions,
    solver: model.SolverOptions,
    light: lights.BrdfLight,
    files: TableFiles,
) -> None:
    """Compute the BRDF of an iris in the aqueous humour, without its surface's reflection."""
    check_files(files.output, files.plot)
    result, lines = _read_instrument("brdf", "BRDF", iris, process, solver, light)
    angle, azimuth = light.exits()
    rows = np.broadcast_to(light.wavelengths.values[:, None], result.values.shape)
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
    write_table(files, lines, columns, lambda: plot.brdf_figure(result, title))


@opt.grouped
def colour_command(
    iris: model.IrisOptions,
    process: model.ProcessOptions,
    solver: model.SolverOptions,
    light: lights.ColourLight,
    files: SwatchFile,
) -> None:
    """Compute the colour of an iris under an illuminant: XYZ, CIE L*a*b*, sRGB, and a swatch."""
    check_files(None, files.swatch, ".png")
    result, lines = _read_instrument("colour", "colour", iris, process, solver, light)
    srgb8 = red, green, blue = np.rint(255 * np.clip(result.srgb, 0, 1)).astype(int).tolist()
    clipped = "" if result.in_gamut else "outside sRGB's gamut: the 8-bit values are clipped"
    rows = [
        *(f"# {key}: {value}" for key, value in lines.items()),
        _row("XYZ", result.xyz, ".6f", "(white has Y = 1)"),
        _row("L*a*b*", result.lab, ".4f"),
        _row("sRGB linear", result.srgb_linear, ".6f"),
        _row("sRGB 8 bit", srgb8, "d", f"#{red:02x}{green:02x}{blue:02x}"),
        f"{'gamut':<12}{clipped or 'inside sRGB'}",
    ]
    if files.swatch is not None:
        remark = f"simulated colour of an iris under {light.illuminant}; {clipped}".rstrip("; ")
        io.write_atomically(files.swatch, plot.swatch((red, green, blue), remark))
    typer.echo("\n".join(rows))


@opt.grouped
def simulate_measurement_command(
    iris: model.IrisOptions,
    process: model.ProcessOptions,
    light: lights.NoisyLight,
    files: TableFile,
) -> None:
    """Simulate a noisy spectrum of an iris, with its truth in the header, to try `irisjax fit`."""
    check_files(files.output)
    light = lights.with_band_centres(light)
    eye, rules = model.build_model(iris, process)
    truth = {n: float(v) for n, v in of_iris(eye).items() if n != "noise"}
    truth["gain"] = light.gain
    groups = (iris, process, light)
    lines = file_header("simulate-measurement", "noisy reflectance", eye, rules, groups)
    lines["truth"] = ", ".join(f"{name} = {value:.6g}" for name, value in truth.items())
    grid = light.wavelengths.values
    levels: Any = light.relative_noise, light.absolute_noise
    problem = ij.problem(
        ij.spectrum(grid, np.zeros(grid.size), **light.instrument_arguments()),
        free=["noise"],
        fixed={"gain": light.gain},
        base=eye,
        solver=model.exact_solver(rules, eye),
        noise=ij.Noise(*levels),
    )
    key = key_of(light.seed)
    draw = jax.jit(lambda k: problem.simulate(jnp.zeros(1), k)[0])
    names = [f"scan_{i + 1}" for i in range(light.scans)] if light.scans > 1 else ["reflectance"]
    scans = {n: draw(jax.random.fold_in(key, i)) for i, n in enumerate(names)}
    write_table(files, lines, {"wavelength_nm": grid, **scans})


def _read_instrument(
    command: str,
    quantity: str,
    iris: model.IrisOptions,
    process: model.ProcessOptions,
    solver: model.SolverOptions,
    light: lights.LightOptions,
) -> tuple[Any, dict[str, str]]:
    """Return the reading of the light's instrument, and the header of its file."""
    eye, rules = model.build_model(iris, process)
    instrument = light.instrument_at(light.wavelengths.values)
    method = model.make_solver(solver, rules, eye, exits=instrument.exits is not None)
    result = _observe(eye, instrument, method, solver.key)
    _warn_few_photons(result)
    left_out = _scalar_theory_error(eye, light) if rules == DEPTH_RESOLVED else None
    groups = (iris, process, solver, light)
    return result, file_header(command, quantity, eye, rules, groups, method, left_out)


def _observe(iris, instrument, solver: AbstractSolver, key: jax.Array | None) -> Any:
    """Return the reading; photons are followed in blocks, with a progress bar."""
    if not isinstance(solver, MonteCarlo):
        return observe(iris, instrument, solver, key=key)
    # Runs of less than a second show no bar (`delay`).
    bar_options = {"unit": "photon", "unit_scale": True, "delay": 1}
    with tqdm(total=solver.n_photons, disable=None, **bar_options) as bar:
        return observe(iris, instrument, solver, key=key, progress=bar.update)


def _scalar_theory_error(iris: ij.Iris, light: lights.LightOptions) -> str:
    """Describe the error of scalar theory at some of the wavelengths."""
    if iris.power_law is not None:
        return "how far that is off is not known under a power law of scattering"
    grid, colour = light.wavelengths.values, isinstance(light, lights.ColourLight)
    if not colour:  # a colour needs all wavelengths
        chosen = np.linspace(0, grid.size - 1, _FEW_WAVELENGTHS).round().astype(int)
        grid = grid[np.unique(chosen)]
    instrument = light.instrument_at(grid)
    readings = (
        observe(iris, instrument, model.exact_solver(p)) for p in (DEPTH_RESOLVED, POLARISED)
    )
    scalar, polarised = (np.asarray(r.xyz[1:2] if colour else r.values) for r in readings)
    dark = polarised <= 0
    errors = 100 * (1 - np.where(dark, 1, scalar) / np.where(dark, 1, polarised))
    first, last = float(errors.min()), float(errors.max())
    name = "luminance" if colour else "values"
    if max(abs(first), abs(last)) < 0.05:
        return f"{name} within 0.05 % of polarised transport of the same layers"
    texts = [f"{abs(error):.1f} % {'low' if error >= 0 else 'high'}" for error in (first, last)]
    if texts[0] == texts[1]:
        texts = texts[1:]
    elif first >= 0:
        texts[0] = f"{first:.1f}"
    return f"{name} {' to '.join(texts)} against polarised transport of the same layers"


def _warn_few_photons(reading: Any) -> None:
    """Warn of standard errors that rest on too few photons."""
    error = getattr(reading, "standard_error", None)
    if error is None:
        return
    # N photons of equal weight have a relative standard error of 1/√N.
    rare = np.asarray(error) > np.abs(np.asarray(reading.values)) / np.sqrt(_FEW_PHOTONS)
    if rare.any():
        opt.notice(
            f"WARNING: {rare.sum()} of {rare.size} values come from fewer than {_FEW_PHOTONS} "
            "photons' worth: their standard errors may be far too small; give more --photons"
        )


def _title(quantity: str, process: model.ProcessOptions, solver: model.SolverOptions) -> str:
    method = "exact" if solver.solver == "exact" else f"{solver.photons:g} photons"
    rules = f"{process.process}{', polarised' if process.polarised else ''}"
    return f"Simulated {quantity} of an iris ({rules}, {method})"


def _row(name: str, numbers, form: str, remark: str = "") -> str:
    cells = " ".join(f"{format(v, form):>11}" for v in np.asarray(numbers).tolist())
    return f"{name:<12}{cells}   {remark}".rstrip()
