"""Options of a painted eye, for the commands that paint one."""

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from irisjax.anatomy.eye import EYE_LIMITS
from irisjax.cli import options as opt
from irisjax.io.recipes import MIXING, Recipe, read_recipe
from irisjax.io.tables import naming
from irisjax.ocularist.recipes import EYE_COLOURS, EYE_TYPES, coats


class PaintOptions(opt.Group, panel="What"):
    type: str | None = opt.choice("in place of a recipe", EYE_TYPES)
    colour: str | None = opt.choice("with --type", EYE_COLOURS)
    mixing: str | None = opt.choice("of the paints", MIXING)
    pupil_radius: float | None = opt.number("{}", EYE_LIMITS["pupil_radius"])
    recipe: Path | None = opt.argument("coats of paint (TOML)", "RECIPE")

    def painted(self, matched: bool = False) -> bool:
        """Return whether a painted eye is requested: by recipe, by type or, if `matched`, by
        neither.
        """
        if self.recipe is not None and self.type is not None:
            raise ValueError("give a recipe or --type, one of them")
        if (self.type is None) != (self.colour is None):
            raise ValueError("--type and --colour go together")
        is_painted = self.recipe is not None or self.type is not None or matched
        for name in ("mixing", "pupil_radius"):
            if getattr(self, name) is not None and not is_painted:
                raise ValueError(f"{opt.dashed(name)} is of a painted eye: give a recipe or --type")
        return is_painted

    def read(self, seed: int) -> Recipe:
        """Read the recipe of a file, or make one of the type by `seed`; apply the changes."""
        if self.recipe is not None:
            return self.changed(read_recipe(self.recipe))
        assert self.type is not None
        assert self.colour is not None
        return self.changed(Recipe(coats(self.type, self.colour, seed=seed)))

    def changed(self, recipe: Recipe) -> Recipe:
        if self.mixing is not None:
            paints = recipe.paints if self.mixing == "kubelka-munk" else None
            recipe = recipe._replace(mixing=self.mixing, paints=paints)
        if self.pupil_radius is not None:
            recipe = recipe._replace(pupil_radius=self.pupil_radius)
        return recipe

    def in_file(self) -> AbstractContextManager[None]:
        """Put the name of the recipe's file in front of the message of a `ValueError`."""
        return nullcontext() if self.recipe is None else naming(self.recipe)


def check_no_seed(typed: frozenset[str]) -> None:
    """Raise `ValueError` for a seed that was typed beside a recipe."""
    if "seed" in typed:
        raise ValueError("--seed is for --type: a recipe has a seed for each of its coats")
