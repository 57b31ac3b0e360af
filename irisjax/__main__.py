"""The door of the command, `irisjax` and `python -m irisjax`."""

from irisjax import _interrupt


def main() -> None:
    """Run the command; Ctrl-C while JAX is still being imported ends it in one line too."""
    _interrupt.guarded(_command)


def _command() -> int:
    from irisjax.cli import run

    status = run()
    _interrupt.done(status)
    return status


if __name__ == "__main__":
    main()
