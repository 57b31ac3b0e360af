"""Files in and out: `--from` runs a file's header again; results are written all or none."""

import dataclasses
import errno
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import irisjax as ij
from irisjax import io, plot
from irisjax.cli import options as opt
from irisjax.cli.light import LightOptions
from irisjax.cli.model import RANGES, IrisOptions, ProcessOptions
from irisjax.io.images import encode_png
from irisjax.tissue.iris import BLOOD, FRACTIONS, LIMITS
from irisjax.transport.process import AbstractProcess, Ilit
from irisjax.transport.solver import AbstractSolver

FOR_PEOPLE = (
    "irisjax",
    "simulated",
    "command",
    "approximation",
    "melanin load that follows",
    "transport",
    "solver settings",
    "unit",
    "directions",
    "truth",
)
"""Keys of a header that are not options."""


def check_folder(
    folder: Path, file: str, contents: str, allowed: bool, advice: str = "--overwrite starts again"
) -> None:
    """Raise before the work if a folder cannot be written, or already has a `file`."""
    check_is_folder(folder)
    if (folder / file).exists() and not allowed:
        raise ValueError(f"{folder}: has {contents}; {advice}")


def check_is_folder(folder: Path) -> None:
    """Raise `ValueError` if a folder or a parent is a file, `OSError` if it may not be written."""
    first = next(f for f in (folder, *folder.absolute().parents) if f.exists())
    if not first.is_dir():
        raise ValueError(f"{first}: is a file, not a folder")
    if not os.access(first, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, "no permission to write in this folder", str(first))


def encode_picture(path: Path, encoded: Any, remark: str) -> bytes:
    """Return the bytes of a PNG of encoded values; warns of values that are clipped."""
    data, clipped = encode_png(path, encoded, remark=remark)
    if clipped:
        opt.notice(f"{path}: {clipped} pixels out of sRGB's range are clipped")
    return data


def _take_settings(context, param, source: Path | None) -> Path | None:
    """Use a file's settings as defaults of the options that were not typed; from a file of another
    command only iris, process and solver.
    """
    if source is None:
        return None
    entries, command = io.read_header(source), context.command
    known = _settings_of(*context.find_root().command.commands.values())
    if not known & set(entries):
        raise ValueError(f"{source}: no header of settings (lines like '# eumelanin: 0.1201')")
    if wrong := [name for name in entries if name not in known and name not in FOR_PEOPLE]:
        known_names = ", ".join(sorted(known))
        raise ValueError(
            f"{source}: unknown setting {wrong[0]!r} in the header; known: {known_names}"
        )
    context.default_map = {n: v for n, v in entries.items() if n in _settings_of(command)}
    if entries.get("command", command.name) != command.name:
        light_options = {p.name for p in command.params if _panel(p) == LightOptions.PANEL}
        if not_taken := [name for name in context.default_map if name in light_options]:
            names = ", ".join(not_taken)
            opt.notice(f"note: {source} is of another command; not taken from it: {names}")
        for name in not_taken:
            del context.default_map[name]
    return source


def _panel(parameter) -> str | None:
    return getattr(parameter, "rich_help_panel", None)


def _settings_of(*commands) -> set[str]:
    """Options that a file's header may set: those of commands with `--from`, files left out."""
    with_from = [c.params for c in commands if any(p.name == "source" for p in c.params)]
    return {p.name for params in with_from for p in params if _panel(p) not in (None, Source.PANEL)}


class Source(opt.Group, panel="Files"):
    source: Path | None = opt.option(
        "run this file's header again, with what other options change",
        names="--from",
        metavar="FILE.csv",
        is_eager=True,
        callback=_take_settings,
    )


class TableFile(Source):
    output: Path | None = opt.output(
        "write the CSV here; without it, to standard output", "FILE.csv"
    )


class TableFiles(TableFile):
    plot: Path | None = opt.option("draw a figure: .png, .pdf or .svg", metavar="FILE.png")


class SwatchFile(Source):
    swatch: Path | None = opt.option("paint the colour", metavar="FILE.png")


def check_files(output: Path | None = None, picture: Path | None = None, *suffixes: str) -> None:
    """Raise before the work if its results cannot be written."""
    paths = [path for path in (output, picture) if path is not None]
    for path in paths:
        io.check_writable(path)
    if len({path.resolve() for path in paths}) < len(paths):
        raise ValueError(f"{paths[0]}: data and figure cannot go to the same file")
    suffix = "" if output is None or io.is_device(output) else output.suffix.lower()
    if suffix not in (".csv", ".txt", ""):
        raise ValueError(f"{output}: is written as CSV; its name must end in .csv or .txt")
    if picture is not None:
        plot.check_suffix(picture, *([suffixes] if suffixes else []))


def write_table(
    to: TableFile,
    lines: Mapping[str, str],
    columns: Mapping[str, Any],
    figure: Callable[[], Any] | None = None,
) -> None:
    """Write CSV, to standard output if there is no file, and the figure, once both are made."""
    output, picture = to.output, getattr(to, "plot", None)
    text = io.format_table(lines, {name: np.asarray(column) for name, column in columns.items()})
    files = {} if output is None else {output: text.encode()}
    if picture is not None and figure is not None:
        files[picture] = plot.picture(figure(), picture.suffix)
    io.write_together(files)
    if output is None:
        sys.stdout.write(text)


def file_header(
    command: str,
    quantity: str,
    iris: ij.Iris,
    process: AbstractProcess,
    groups: tuple[IrisOptions, ProcessOptions, *tuple[opt.Group, ...]],
    solver: AbstractSolver | None = None,
    left_out: str | None = None,
) -> dict[str, str]:
    """Make the header of a file of simulated values, complete enough for `--from`.

    Args:
        command: The command that writes it.
        quantity: Name of the quantity in the file.
        iris: The iris that the first of the `groups` describes.
        process: The process that the second of them describes.
        groups: The command's options.
        solver: The solver, if the values are its results and nothing else.
        left_out: How polarisation would change the values.
    """
    lines = {
        "irisjax": ij.__version__,
        "simulated": f"{quantity} of a modelled human iris, not a measurement",
        "command": command,
    }
    if solver is not None:
        lines["approximation"] = _approximation(process, left_out)
    # Python's floats, since NumPy's are written with fewer digits once colour-science is imported.
    numbers = {
        name: float(getattr(iris if name in LIMITS else iris.power_law, name))
        for name in iris.parameters()
    }
    numbers |= {"melanin_load": float(iris.melanin_load), **dict.fromkeys((*BLOOD, *FRACTIONS))}
    written = (
        dataclasses.replace(groups[0], **numbers, absorption=iris.absorption),
        dataclasses.replace(groups[1], **process.describe()),
        *groups[2:],
    )
    for name, value in (pair for group in written for pair in group.settings().items()):
        unit = RANGES[name].unit if name in RANGES else {"wavelengths": "nm"}.get(name)
        text = {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)
        if name == "melanin_load":  # both melanins say it already
            lines["melanin load that follows"] = f"{value:.12g} [ug/mm2]"
        elif (name, value) == ("absorption", "lb06"):
            pass
        elif name != "level" and not (name == "scattering" and iris.power_law is not None):
            lines[name] = f"{text}{f' [{unit}]' if unit else ''}"
    if solver is not None:
        # The process is written in its own lines.
        fields = {n: v for n, v in vars(solver).items() if n != "process" and v is not None}
        lines["transport"] = process.transport
        lines["solver settings"] = ", ".join(f"{n} = {v}" for n, v in fields.items())
    return lines


def _approximation(process: AbstractProcess, left_out: str | None) -> str:
    """Return the caveats of the process that made the numbers."""
    if process.polarised:
        return (
            "Stokes vectors, Rayleigh's phase matrix: this model depolarises less than photographs "
            "of irides through crossed polarisers show"
        )
    if not isinstance(process, Ilit):
        return f"scalar theory, no polarisation: {left_out}"
    retest = process.rescatter == "retest"
    return (
        "ILIT tests whole layers at once: in the blue, light eyes come out "
        f"{'darker than' if retest else 'about twice as bright as'} by depth-resolved transport of "
        f"the same layers ({0.0148 if retest else 0.0405} against 0.0202 at 450 nm, low "
        f"pigmentation, rescatter = {process.rescatter})"
    )
