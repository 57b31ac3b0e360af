"""The command `irisjax`: settings in, files out. It contains no equations."""

import importlib
import importlib.util
import os
import sys
from contextlib import nullcontext
from typing import Any

import jax
import typer
from typer.main import get_command

import irisjax as ij
from irisjax import _interrupt
from irisjax.cli.compiled import keep_compiled, reading_ahead

_COMMANDS = {
    "spectrum": ("measure",),
    "brdf": ("measure",),
    "colour": ("measure",),
    "simulate-measurement": ("measure",),
    "fit": ("fit",),
    "compare-groups": ("groups",),
    "map": ("map", "spectral", "xarray", "OpenImageIO", "tomlkit"),
    "simulate-cube": ("simulate_cube",),
    "render": ("render", "OpenImageIO"),
    "export": ("export", "OpenImageIO", "trimesh"),
    "view": ("view", "OpenImageIO", "tomlkit", "viser"),
    "clone": ("clone", "OpenImageIO", "skimage"),
    "paint": ("paint", "OpenImageIO", "tomlkit"),
}
"""Commands in the order of the help, each with its module of this package and with the modules of
extras that it needs.
"""
_EXTRAS = {
    "images": ("OpenImageIO", "PIL", "tomlkit"),
    "photo": ("skimage",),
    "mesh": ("trimesh",),
    "view": ("viser",),
    "video": ("av",),
    "raw": ("rawpy",),
    "cubes": ("spectral", "xarray", "zarr"),
    "cluster": ("dask", "distributed"),
    "posteriors": ("flowjax", "optax", "paramax"),
}
"""Extras of the package and the modules that they install; several may install one."""


def run(arguments: list[str] | None = None) -> int:
    """Run the command with these arguments (default: the process's own) and return its exit status.

    The status is 0, or 2 for wrong input, 130 for Ctrl-C, 1 for a fault of the program; every error
    ends in one line on standard error. With IRISJAX_DEBUG=1 exceptions are raised.
    """
    _interrupt.begin()
    try:
        # The one place where the package chooses a precision.
        jax.config.update("jax_enable_x64", True)
        keep_compiled()
        arguments = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
        with reading_ahead(arguments[0]) if arguments[0] in _COMMANDS else nullcontext():
            status = parser(arguments).main(arguments, prog_name="irisjax", standalone_mode=False)
        sys.stdout.flush()
        if status == _interrupt.STATUS:  # typer's way of passing on an interrupt
            _interrupt.say()
        return status if isinstance(status, int) else 0
    except (KeyboardInterrupt, typer.Abort):
        _interrupt.say()
        return _interrupt.STATUS
    except BrokenPipeError:
        # `irisjax spectrum | head` is no fault, nor may the flush at exit complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if os.environ.get("IRISJAX_DEBUG"):
            raise
        message = _describe_error(error)
        fault = f"internal error: {type(error).__name__}: {error} (IRISJAX_DEBUG=1 shows where)"
        print("irisjax:", " ".join((message or fault).split()), file=sys.stderr)
        return 2 if message else 1


def _describe_error(error: Exception) -> str:
    """Return what is wrong with the input; an empty text means a fault of the program."""
    # Typer's own errors have this method in all versions, but not one base class.
    if (format_message := getattr(error, "format_message", None)) is not None:
        return _describe_value(error) or format_message()
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    if isinstance(error, ModuleNotFoundError):
        return _describe_extra(error)
    if isinstance(error, MemoryError):
        return "not enough memory for so many wavelengths, directions or photons"
    return str(error) if isinstance(error, ValueError) else ""


def _describe_value(error: Exception) -> str:
    """Describe an error in a value, after the name of its option, or its file and key."""
    parameter, context = getattr(error, "param", None), getattr(error, "ctx", None)
    message = getattr(error, "message", "")
    if parameter is None or context is None or not message:
        return ""
    source = context.get_parameter_source(parameter.name)
    if source is not None and source.name == "DEFAULT_MAP":
        return f"{context.params['source']}: {parameter.name}: {message}"
    return f"{parameter.opts[-1]}: {message}"


def _describe_extra(error: ModuleNotFoundError) -> str:
    """Return how to install a package of an extra; an empty text for other modules."""
    package = (error.name or "").split(".")[0]
    for extra, packages in _EXTRAS.items():
        if package in packages:
            return f"this needs {package}, which is not installed: pip install 'irisjax[{extra}]'"
    return ""


def parser(arguments: list[str]) -> Any:
    """Make the parser of these arguments, which imports only the modules of their command."""
    app = typer.Typer(
        add_completion=False,
        rich_markup_mode="rich",
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback(invoke_without_command=True)(_irisjax)
    asked, *needed = _COMMANDS.get(arguments[0], (None,))
    for package in () if {"-h", "--help"} & set(arguments) else needed:
        if importlib.util.find_spec(package) is None:
            raise ModuleNotFoundError(package, name=package)
    for name, (module, *_) in _COMMANDS.items():
        # Commands of one module take each other's files by `--from`, so all of them are needed.
        if arguments[0] != "--version" and asked in (None, module):
            try:
                imported = importlib.import_module(f"irisjax.cli.{module}")
            except ModuleNotFoundError as error:
                if asked is not None or not _describe_extra(error):
                    raise
                app.command(name, help=f"Not installed: {_describe_extra(error)}")(lambda: None)
                continue
            epilog = getattr(imported, "EPILOG", None)
            app.command(name, epilog=epilog)(getattr(imported, f"{name.replace('-', '_')}_command"))
    return get_command(app)


def _irisjax(
    version: bool = typer.Option(False, "--version", help="Print the version and exit."),
) -> None:
    """Predictive spectra, BRDF and colour of the human iris from its pigments.

    Its spectra and colours are simulated. Files carry every setting in their header; `--from
    FILE.csv` runs one again.
    """
    if version:
        typer.echo(f"irisjax {ij.__version__}")
        raise typer.Exit
