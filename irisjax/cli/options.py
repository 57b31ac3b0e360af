"""Options: groups of them as dataclasses, and the parsers that turn a text into a value."""

import copy
import dataclasses
import functools
import inspect
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, get_args, get_type_hints

import numpy as np
import typer
from typer.models import OptionInfo

import irisjax as ij
from irisjax.numerics.checks import Range

_MOST_WAVELENGTHS = 1_000_000


@dataclasses.dataclass(frozen=True, kw_only=True)
class Group:
    """Options that belong together: a frozen dataclass whose fields are `Annotated` for typer.

    Attributes:
        PANEL: Heading of the options in the help.
        ONLY_WITH: An option that means nothing unless another of the group has one of these values;
            to type it then is an error.
        typed: The options that stand on the command line, as against defaults and a file's values.
    """

    PANEL: ClassVar[str] = ""
    ONLY_WITH: ClassVar[Mapping[str, tuple[str, tuple[str, ...]]]] = {}
    typed: frozenset[str] = frozenset()

    def __post_init__(self):
        for name in self.ONLY_WITH:
            if name in self.typed and not self.applies(name):
                other, values = self.ONLY_WITH[name]
                raise ValueError(
                    f"{dashed(name)} means something only with {dashed(other)} "
                    f"{' or '.join(values)}"
                )

    def applies(self, name: str) -> bool:
        """Whether an option means something beside the others."""
        other, values = self.ONLY_WITH.get(name, (name, ()))
        return other == name or getattr(self, other) in values

    def settings(self) -> dict[str, Any]:
        """What a file must say of the group to be made again: options that apply and are set."""
        found = {name: getattr(self, name) for name in _options_of(type(self))}
        return {n: v for n, v in found.items() if v is not None and self.applies(n)}


def grouped(function: Callable[..., None]) -> Callable[..., None]:
    """A command for typer of a function some of whose parameters are a `Group`.

    typer is shown every field of a group as an option under the group's heading; the function gets
    the groups made of their values. Other parameters pass as they are.
    """
    parameters = inspect.signature(function).parameters.values()
    groups = {p.name: p.annotation for p in parameters if _is_group(p.annotation)}
    shown = [inspect.Parameter("context", _KEYWORD, annotation=typer.Context)]
    for parameter in parameters:
        if parameter.name in groups:
            shown += _options_of(parameter.annotation).values()
        else:
            shown.append(parameter.replace(kind=_KEYWORD))

    @functools.wraps(function)
    def command(context, **given):
        typed = frozenset(n for n in given if stands_on_command_line(context, n))
        for name, group in groups.items():
            fields = {n: given.pop(n) for n in _options_of(group)}
            given[name] = group(**fields, typed=typed & frozenset(fields))
        function(**given)

    # typer reads a command's options from these two.
    command.__signature__ = inspect.Signature(shown)  # pyright: ignore[reportAttributeAccessIssue]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in shown}
    return command


def option(*names: str, parse: Callable[[str], Any] | None = None, **shown: Any) -> Any:
    """`typer.Option` whose value is what `parse` makes of the text.

    `parse` raises `ValueError` for a text that it cannot take; the command names the option, or the
    file and the key, in front of what it says.
    """

    def read(text):
        assert parse is not None
        try:
            return parse(str(text))  # defaults come as values
        except ValueError as error:
            raise typer.BadParameter(str(error)) from None

    return typer.Option(*names, parser=None if parse is None else read, **shown)


def named_option(help: str, *names: str, **more: Any) -> Any:
    """An option that takes one of these names."""
    return option(
        parse=name_parser(*names), metavar="name", help=f"{', '.join(names)}: {help}", **more
    )


def overrules(*names: str) -> Callable[..., Any]:
    """Callback of an option that, typed, sets what a file would set by these names."""

    # typer goes through the options that were typed before those that take defaults.
    def callback(context, param, value):
        if stands_on_command_line(context, param.name):
            for name in names:
                (context.default_map or {}).pop(name, None)
        return value

    return callback


def stands_on_command_line(context: Any, name: str) -> bool:
    """Whether an option was typed."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def dashed(name: str) -> str:
    """An option as it is typed."""
    return f"--{name.replace('_', '-')}"


_KEYWORD = inspect.Parameter.KEYWORD_ONLY


def _is_group(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, Group)


@functools.cache
def _options_of(group: type[Group]) -> dict[str, inspect.Parameter]:
    """Fields that are options, as typer reads them."""
    hints = get_type_hints(group, include_extras=True)
    found = {}
    for field in dataclasses.fields(group):
        if field.name == "typed":
            continue
        kind, info = get_args(hints[field.name])
        if isinstance(info, OptionInfo):
            info = copy.copy(info)
            info.rich_help_panel = group.PANEL
            if Path in (kind, *get_args(kind)) and info.parser is None:
                info.parser = _path
        must = field.default is dataclasses.MISSING
        default = inspect.Parameter.empty if must else field.default
        found[field.name] = inspect.Parameter(
            field.name, _KEYWORD, default=default, annotation=Annotated[kind, info]
        )
    return found


def _path(text: str | Path) -> Path:
    """A file or folder; an empty text, of a shell's variable that is not set, is the working folder
    to `pathlib`.
    """
    if not str(text):
        raise typer.BadParameter("no file or folder is named")
    return Path(text)


@dataclasses.dataclass(frozen=True)
class WavelengthGrid:
    """Wavelengths as they are written, and their values (nm)."""

    text: str

    @functools.cached_property
    def values(self) -> np.ndarray:
        """Wavelengths, nm.

        Raises:
            ValueError: For a text that is no grid.
        """
        text = "".join(self.text.split())
        form = "give start:stop:step or a list 450,550,650, in nm"
        try:
            numbers = [float(part) for part in text.replace(":", ",").split(",")]
        except ValueError:
            raise ValueError(f"{text!r} is not a grid; {form}") from None
        if ":" not in text:
            return np.array(numbers)
        if "," in text or len(numbers) != 3:
            raise ValueError(f"{text!r} is not a grid; {form}")
        start, stop, step = numbers
        if step > 0 and (stop - start) / step >= _MOST_WAVELENGTHS:
            raise ValueError(f"{text!r} has more than {_MOST_WAVELENGTHS} wavelengths")
        return ij.wavelengths(start, stop, step)

    def __str__(self):
        return self.text


def grid_parser(
    check: Callable[[np.ndarray], None] | None = None,
) -> Callable[[str], WavelengthGrid]:
    """Parser of wavelengths, nm; `check` raises `ValueError` where they are not allowed."""

    def parse(text: str) -> WavelengthGrid:
        found = WavelengthGrid("".join(text.split()))
        values = found.values  # or the error that it is no grid
        if check is not None:
            check(values)
        return found

    return parse


def number_parser(low: float = -math.inf, high: float = math.inf) -> Callable[[str], float]:
    """Parser of numbers, in [low, high] if either is given."""
    return range_parser(Range(low, high))


def range_parser(allowed: Range) -> Callable[[str], float]:
    """Parser of numbers in a range."""
    bounded = allowed.low > -math.inf or allowed.high < math.inf

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise ValueError(f"{text!r} is not a number") from None
        if bounded and not allowed.holds(value):
            raise ValueError(f"{text} is outside {allowed}")
        return value

    return parse


def whole_parser(low: int, high: int) -> Callable[[str], int]:
    """Parser of whole numbers in [low, high]; 1e6 is one."""
    allowed = Range(low, high)

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            real = number_parser()(text)
            if not real.is_integer():
                raise ValueError(f"{text} is not a whole number") from None
            value = int(real)
        if not allowed.holds(value):
            raise ValueError(f"{text} is outside {allowed}")
        return value

    return parse


def name_parser(*names: str) -> Callable[[str], str]:
    """Parser of names."""

    def parse(text: str) -> str:
        if text not in names:
            raise ValueError(f"unknown {text!r}; known: {', '.join(names)}")
        return text

    return parse


def number_or(word: str, low: float, high: float) -> Callable[[str], float | str]:
    """Parser of numbers in [low, high], and of a word in place of one."""
    parse_number = number_parser(low, high)

    def parse(text: str) -> float | str:
        if text == word:
            return word
        try:
            return parse_number(text)
        except ValueError as error:
            raise ValueError(f"{error}; or write {word}") from None

    return parse


cosine = number_or(ij.DIFFUSE, 0, 1)
"""Parses a cosine of incidence, or the word for light from everywhere."""
exit_angle = number_or(ij.HEMISPHERE, 0, 90)
"""Parses an angle from the normal in degrees, or the word for all directions."""

SEED_HELP = "0 to 4294967295; equal seeds give equal "


def read_seed(text: str) -> int:
    """Parse a seed, 32 bits: larger ones would start other streams in a float32 Python session."""
    return whole_parser(0, 2**32 - 1)(text)
