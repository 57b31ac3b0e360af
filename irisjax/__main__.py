"""The door of the command, `irisjax` and `python -m irisjax`."""

import sys

from irisjax import _interrupt

_WITH_CHAINS = ("fit", "clone")
"""Commands that judge a chain by ArviZ's functions of arrays, and use no xarray."""


def main() -> None:
    """Run the command; Ctrl-C while JAX is still being imported ends it in one line too."""
    _interrupt.guarded(_command)


def _command() -> int:
    from irisjax.cli import run

    if sys.argv[1:] and sys.argv[1] in _WITH_CHAINS:
        # ArviZ loads xarray and pandas where they are installed, and needs neither for arrays.
        sys.modules.setdefault("xarray", None)  # pyright: ignore[reportArgumentType]
    status = run()
    _interrupt.done(status)
    return status


if __name__ == "__main__":
    main()
