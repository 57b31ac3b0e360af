"""Files in and out: `--from` runs a file's header again; results are written together or not."""

import errno
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from irisjax import io, plot
from irisjax.cli.light import Light
from irisjax.cli.options import Group, option
from irisjax.io.images import encode_png

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
"""Keys of a header that set nothing."""


def check_folder(folder: Path, file: str, what: str, overwrite: bool) -> None:
    """Find out before the work whether a folder can keep its results; `file` says that it has
    `what` already.
    """
    check_is_folder(folder)
    if (folder / file).exists() and not overwrite:
        raise ValueError(f"{folder}: has {what}; --overwrite starts again")


def check_is_folder(folder: Path) -> None:
    """Raise `ValueError` where a folder, or one that it would lie in, is a file, and `OSError`
    where nothing may be written there.
    """
    first = next(f for f in (folder, *folder.absolute().parents) if f.exists())
    if not first.is_dir():
        raise ValueError(f"{first}: is a file, not a folder")
    if not os.access(first, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, "no permission to write in this folder", str(first))


def png_of(path: Path, encoded: Any, remark: str) -> bytes:
    """The bytes of a PNG of encoded values; what is out of range is clipped, and said so."""
    data, clipped = encode_png(path, encoded, remark=remark)
    if clipped:
        print(f"irisjax: {path}: {clipped} pixels out of sRGB's range are clipped", file=sys.stderr)
    return data


def _take_settings(context, param, source: Path | None) -> Path | None:
    """Let a file's settings stand in for the defaults of the options that were not typed.

    Another command's file lends its iris, process and solver; what it measured is its own affair.
    """
    if source is None:
        return None
    entries = io.read_header(source)
    known = _settings_of(*context.find_root().command.commands.values())
    if not known & set(entries):
        raise ValueError(f"{source}: no header of settings (lines like '# eumelanin: 0.1201')")
    for name in entries:
        if name not in known and name not in FOR_PEOPLE:
            raise ValueError(
                f"{source}: unknown setting {name!r} in the header; known: "
                f"{', '.join(sorted(known))}"
            )
    taken = {n: v for n, v in entries.items() if n in _settings_of(context.command)}
    command = context.command.name
    if entries.get("command", command) != command:
        own = [p.name for p in context.command.params if _panel(p) == Light.PANEL]
        if left := [name for name in taken if name in own]:
            print(
                f"irisjax: note: {source} is of another command; not taken from it: "
                f"{', '.join(left)}",
                file=sys.stderr,
            )
        taken = {n: v for n, v in taken.items() if n not in left}
    context.default_map = taken
    return source


def _panel(parameter) -> str | None:
    return getattr(parameter, "rich_help_panel", None)


def _settings_of(*commands) -> set[str]:
    """Options that a file's header may set: those of commands with `--from`, files left out."""
    return {
        parameter.name
        for command in commands
        if any(p.name == "source" for p in command.params)
        for parameter in command.params
        if _panel(parameter) not in (None, Source.PANEL)
    }


@dataclass(frozen=True, kw_only=True)
class Source(Group):
    """The file that is run again."""

    PANEL = "Files"

    source: Annotated[
        Path | None,
        option(
            "--from",
            metavar="FILE.csv",
            is_eager=True,
            callback=_take_settings,
            help="run this file's header again, with what other options change",
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class TableFile(Source):
    """The file that is made."""

    output: Annotated[
        Path | None,
        option(
            "-o",
            "--output",
            metavar="FILE.csv",
            help="write the CSV here; without it, to standard output",
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class TableFiles(TableFile):
    """The files that are made."""

    plot: Annotated[
        Path | None, option(metavar="FILE.png", help="draw a figure: .png, .pdf or .svg")
    ] = None


@dataclass(frozen=True, kw_only=True)
class SwatchFile(Source):
    """The picture that is made."""

    swatch: Annotated[Path | None, option(metavar="FILE.png", help="paint the colour")] = None


_TABLES = (".csv", ".txt", "")


def check_files(output: Path | None = None, picture: Path | None = None, *suffixes: str) -> None:
    """Find out before the work whether its results can be kept."""
    paths = [path for path in (output, picture) if path is not None]
    for path in paths:
        io.check_writable(path)
    if len({path.resolve() for path in paths}) < len(paths):
        raise ValueError(f"{paths[0]}: data and figure cannot go to the same file")
    if output is not None and output.suffix.lower() not in _TABLES and not io.is_device(output):
        raise ValueError(f"{output}: is written as CSV; its name must end in .csv or .txt")
    if picture is not None:
        plot.check_suffix(picture, *([suffixes] if suffixes else []))


def write_table(
    output: Path | None,
    lines: Mapping[str, str],
    columns: Mapping[str, Any],
    picture: Path | None = None,
    figure: Callable[[], Any] | None = None,
) -> None:
    """Write CSV (without a file, to standard output) and figure, both made before either is
    written.
    """
    text = io.format_table(lines, {name: np.asarray(column) for name, column in columns.items()})
    files = {} if output is None else {output: text.encode()}
    if picture is not None and figure is not None:
        files[picture] = plot.picture(figure(), picture.suffix)
    io.write_together(files)
    if output is None:
        sys.stdout.write(text)
