"""Options of a painted eye, for the commands that paint one."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from irisjax.anatomy.eye import LIMITS
from irisjax.cli.options import Group, option, within
from irisjax.io.recipes import MIXING, Recipe, read_recipe
from irisjax.ocularist.recipes import COLOURS, TYPES, coats

_PUPIL = LIMITS["pupil_radius"]


@dataclass(frozen=True, kw_only=True)
class Paints(Group):
    """A type of eye in place of a recipe, and what changes either."""

    PANEL = "What"

    type: Annotated[
        str | None, option(metavar="name", help=f"{', '.join(TYPES)}: in place of a recipe")
    ] = None
    colour: Annotated[
        str | None, option(metavar="name", help=f"{', '.join(COLOURS)}; with --type")
    ] = None
    mixing: Annotated[
        str | None, option(metavar="name", help=f"{', '.join(MIXING)}: of the paints")
    ] = None
    pupil_radius: Annotated[
        float | None,
        option(parse=within(_PUPIL), metavar="MM", help=f"{_PUPIL.low:g} to {_PUPIL.high:g}"),
    ] = None

    def __post_init__(self):
        super().__post_init__()
        if self.mixing is not None and self.mixing not in MIXING:
            raise ValueError(f"--mixing: unknown {self.mixing!r}; known: {', '.join(MIXING)}")

    def painted(self, recipe: Path | None, matched: bool = False) -> bool:
        """Whether a painted eye is asked for, by the file of a recipe, by type or, where there is
        something to be `matched`, by nothing else.

        **Raises:** `ValueError` for both, and for options that mean nothing by themselves.
        """
        if recipe is not None and self.type is not None:
            raise ValueError("give a recipe or --type, one of them")
        if (self.type is None) != (self.colour is None):
            raise ValueError("--type and --colour go together")
        found = recipe is not None or self.type is not None or matched
        for name, value in (("mixing", self.mixing), ("pupil-radius", self.pupil_radius)):
            if value is not None and not found:
                raise ValueError(f"--{name} is of a painted eye: give a recipe or --type")
        return found

    def read(self, recipe: Path | None, seed: int) -> Recipe:
        """The recipe of a file, or of the type by `seed`, with what the options change."""
        if recipe is not None:
            found = read_recipe(recipe)
        else:
            assert self.type is not None
            assert self.colour is not None
            found = Recipe(coats(self.type, self.colour, seed=seed))
        return self.changed(found)

    def changed(self, found: Recipe) -> Recipe:
        """A recipe with what the options change."""
        if self.mixing is not None:
            kept = found.paints if self.mixing == "kubelka-munk" else None
            found = found._replace(mixing=self.mixing, paints=kept)
        if self.pupil_radius is not None:
            found = found._replace(pupil_radius=self.pupil_radius)
        return found


def check_no_seed(typed: frozenset[str]) -> None:
    """**Raises:** `ValueError` for a seed that was typed beside a recipe."""
    if "seed" in typed:
        raise ValueError("--seed is for --type: a recipe has a seed for each of its coats")


@contextlib.contextmanager
def of_file(recipe: Path | None) -> Iterator[None]:
    """Name the file of a recipe in what is said against it."""
    try:
        yield
    except ValueError as error:
        where = "" if recipe is None else f"{recipe}: "
        raise ValueError(f"{where}{error}") from None
