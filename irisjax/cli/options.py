"""Groups of options as dataclasses, and parsers that turn a text into a value."""

import dataclasses
import functools
import inspect
import math
import sys
import typing
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeAlias, dataclass_transform

import numpy as np
import typer

import irisjax as ij
from irisjax.numerics.checks import Range

_MOST_WAVELENGTHS = 1_000_000
OnlyWith: TypeAlias = Mapping[str, tuple[str, tuple[str, ...]]]


def option(help: str, default: object = None, *, names: str = "", **metadata: Any) -> Any:
    """Make an option of the command line, a field of a `Group`.

    Args:
        help: Its line in the help.
        default: Its value if it is not typed; `...` if it must be typed.
        names: Its names on the command line, if not the field's.
        **metadata: `metavar`; `parse`, a function of the text that raises `ValueError` where it
            cannot take it (the option, or the file and the key, is put in front of the message);
            `overrules`, names of what a file cannot set where this is typed; other arguments of
            `typer.Option`.
    """
    value = dataclasses.MISSING if default is ... else default
    return dataclasses.field(
        default=value, metadata={"help": help, "names": tuple(names.split()), **metadata}
    )


def argument(help: str, metavar: str, default: object = None) -> Any:
    """Make a positional argument of the command line."""
    return option(help, default, metavar=metavar, positional=True)


def output(help: str, metavar: str, default: object = None) -> Any:
    """Make the option of the file or folder for results."""
    return option(help, default, names="-o --output", metavar=metavar)


def flag(help: str, default: bool = False) -> Any:
    """Make an option without a value; one that is on by default also has a `--no-` name."""
    return option(help, default)


def number(
    help: str,
    allowed: Range | None = None,
    default: object = None,
    metavar: str = "",
    *,
    whole: bool = False,
    **more: Any,
) -> Any:
    """Make an option that takes a number; `{}` in its help is replaced by the range."""
    words, unit = (help.replace("{}", in_words(allowed)), allowed.unit) if allowed else (help, "")
    parse = number_in(allowed, whole)
    return option(words, default, parse=parse, metavar=metavar or unit or "number", **more)


def whole(help: str, allowed: Range, default: int | None = None, metavar: str = "count") -> Any:
    """Make an option that takes a whole number, such as 1e6."""
    return number(help, allowed, default, metavar, whole=True)


def seeded(what: str) -> Any:
    """Make the option of a seed of 32 bits: larger ones give other streams in a float32 session."""
    return whole(f"{{}}; equal seeds give equal {what}", Range(0, 2**32 - 1), 0, "number")


def choice(help: str, known: Iterable[str], default: str | None = None, **more: Any) -> Any:
    """Make an option that takes one of the known names, with which its help begins."""
    words = f"{', '.join(known)}: {help}"
    return option(words, default, parse=one_of(*known), metavar="name", **more)


@dataclass_transform(
    frozen_default=True,
    kw_only_default=True,
    field_specifiers=(option, argument, output, flag, number, whole, seeded, choice),
)
@dataclasses.dataclass(frozen=True, kw_only=True)
class Group:
    """Options that belong together: a frozen dataclass, as are its subclasses.

    A subclass states the heading of its options in the help, `class Iris(Group, panel="Iris")`.

    Attributes:
        PANEL: Heading of the options in the help.
        ONLY_WITH: Options that apply only if another option of the group has one of these values
            (any value, or a flag that is on, if there are none); otherwise it is an error to type
            them.
        typed: The options that were typed on the command line, rather than set by defaults or a
            file.
    """

    PANEL: ClassVar[str] = ""
    ONLY_WITH: ClassVar[OnlyWith] = {}
    typed: frozenset[str] = frozenset()

    def __init_subclass__(cls, panel: str | None = None) -> None:
        cls.PANEL = panel or cls.PANEL
        dataclasses.dataclass(frozen=True, kw_only=True)(cls)

    def __post_init__(self) -> None:
        if {"resume", "overwrite"} <= self.typed:
            raise ValueError("--resume continues a run, --overwrite starts again: give one of them")
        for name, (other, values) in self.ONLY_WITH.items():
            if name in self.typed and not self.applies(name):
                either = f" {' or '.join(values)}" if values else ""
                raise ValueError(
                    f"{dashed(name)} means something only with {dashed(other)}{either}"
                )

    def applies(self, name: str) -> bool:
        """Return whether an option applies, given the others."""
        if name not in self.ONLY_WITH:
            return True
        other, values = self.ONLY_WITH[name]
        given = getattr(self, other)
        return given in values if values else given is not None and given is not False

    def settings(self) -> dict[str, Any]:
        """Return the options that apply and are set, from which the group can be made again."""
        values = {name: getattr(self, name) for name in _options_of(type(self))}
        return {n: v for n, v in values.items() if v is not None and self.applies(n)}


def grouped(function: Callable[..., None]) -> Callable[..., None]:
    """Make a command for typer from a function whose parameters are `Group`s.

    Typer gets every field of a group as an option under the group's heading; the function gets the
    groups made of their values.
    """
    groups = {n: p.annotation for n, p in inspect.signature(function).parameters.items()}
    parameters = [inspect.Parameter("context", _KEYWORD, annotation=typer.Context)]
    parameters += [p for group in groups.values() for p in _options_of(group).values()]

    @functools.wraps(function)
    def command(context, **values):
        typed = frozenset(n for n in values if _is_typed(context, n))
        arguments = {}
        for name, group in groups.items():
            fields = {n: values[n] for n in _options_of(group)}
            arguments[name] = group(**fields, typed=typed & frozenset(fields))
        function(**arguments)

    # typer reads a command's options from these two.
    command.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportAttributeAccessIssue]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return command


def _overrule(names: tuple[str, ...]) -> Callable[..., Any]:
    """Make the callback of an option that, if typed, replaces a file's settings of these names."""

    # Typer processes the options that were typed before those that take defaults.
    def callback(context, param, value):
        if _is_typed(context, param.name) and value is not False:
            for name in names:
                (context.default_map or {}).pop(name, None)
        return value

    return callback


def _is_typed(context: Any, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def notice(text: str) -> None:
    """Print a line on standard error."""
    print(f"irisjax: {text}", file=sys.stderr)


def dashed(name: str) -> str:
    """Return an option's name as it is typed."""
    return f"--{name.replace('_', '-')}"


_KEYWORD = inspect.Parameter.KEYWORD_ONLY


@functools.cache
def _options_of(group: type[Group]) -> dict[str, inspect.Parameter]:
    """Return the fields that are options, as parameters for typer."""
    hints, options = typing.get_type_hints(group), {}
    for field in dataclasses.fields(group):
        if field.name == "typed":
            continue
        kind, metadata = hints[field.name], dict(field.metadata)
        kinds, names = (kind, *typing.get_args(kind)), metadata.pop("names")
        if metadata.pop("positional", False):
            info = typer.Argument(show_default=False, **metadata)
        else:
            if bool in kinds:
                off = f"/--no-{dashed(field.name)[2:]}" if field.default else ""
                names, metadata["metavar"] = names or (dashed(field.name) + off,), ""
            if parse := metadata.pop("parse", _path if Path in kinds else None):
                is_repeatable = any(typing.get_origin(k) is list for k in kinds)
                kind, metadata["parser"] = list[Any] if is_repeatable else Any, _parser(parse)
            if "overrules" in metadata:
                metadata["callback"] = _overrule(metadata.pop("overrules"))
            info = typer.Option(*names, rich_help_panel=group.PANEL, **metadata)
        is_required = field.default is dataclasses.MISSING
        default = inspect.Parameter.empty if is_required else field.default
        options[field.name] = inspect.Parameter(
            field.name, _KEYWORD, default=default, annotation=Annotated[kind, info]
        )
    return options


def _parser(parse: Callable[[str], Any]) -> Callable[[Any], Any]:
    def read(text):
        try:
            return parse(str(text))  # a default is a value, not a text
        except ValueError as error:
            raise typer.BadParameter(str(error)) from None

    return read


def _path(text: str) -> Path:
    """Parse a path; `pathlib` would take an empty text for the working folder."""
    if not text:
        raise ValueError("no file or folder is named")
    return Path(text)


class Grid(str):
    """The text of a grid of wavelengths, without spaces.

    Attributes:
        values: Wavelengths, nm.
    """

    values: np.ndarray

    def __new__(cls, text: str) -> "Grid":
        """Raises `ValueError` for a text that is no grid."""
        grid = super().__new__(cls, "".join(text.split()))
        message = f"{str(grid)!r} is not a grid; give start:stop:step or a list 450,550,650, in nm"
        values, is_range = numbers(grid.replace(":", ",")), ":" in grid
        if not values or (is_range and ("," in grid or len(values) != 3)):
            raise ValueError(message)
        if not is_range:
            grid.values = np.array(values)
            return grid
        start, stop, step = values
        if step > 0 and (stop - start) / step >= _MOST_WAVELENGTHS:
            raise ValueError(f"{str(grid)!r} has more than {_MOST_WAVELENGTHS} wavelengths")
        grid.values = ij.wavelengths(start, stop, step)
        return grid


def numbers(text: str) -> list[float]:
    """Parse numbers separated by commas; none if a part is not a number."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return []


def number_in(allowed: Range | None = None, whole: bool = False) -> Callable[[str], Any]:
    """Make a parser of numbers, in a range if there is one, and of whole ones to `int`."""
    within = "" if allowed is None else f" in {allowed}"

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise ValueError(f"{text!r} is not a number{within}") from None
        if whole and not value.is_integer():
            raise ValueError(f"{text} is not a whole number{within}")
        if allowed is not None and not allowed.holds(value):
            raise ValueError(f"{text} is outside {allowed}")
        return int(value) if whole else value

    return parse


def one_of(*names: str) -> Callable[[str], str]:
    """Make a parser of names."""

    def parse(text: str) -> str:
        if text not in names:
            raise ValueError(f"unknown {text!r}; known: {', '.join(names)}")
        return text

    return parse


def number_or(word: str, allowed: Range) -> Callable[[str], float | str]:
    """Make a parser of numbers in a range, or of a word in place of one."""

    def parse(text: str) -> float | str:
        if text == word:
            return word
        try:
            return number_in(allowed)(text)
        except ValueError as error:
            raise ValueError(f"{error}; or write {word}") from None

    return parse


cosine: Callable[[str], float | str] = number_or(ij.DIFFUSE, Range(0, 1))
"""Parser of a cosine of incidence, or of the word for diffuse light."""


def in_words(allowed: Range) -> str:
    """Describe a range in the words of the help."""
    low, high = (f"{limit:.10g}" for limit in allowed[:2])
    if allowed.above:
        return f"above {low}, at most {high}" if math.isfinite(allowed.high) else f"above {low}"
    return f"{low} to {high}" if math.isfinite(allowed.high) else f"at least {low}"
