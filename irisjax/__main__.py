"""The door of the command, `irisjax` and `python -m irisjax`."""

import sys


def main() -> None:
    """Run the command; Ctrl-C while JAX is still being imported ends it in one line too."""
    try:
        from irisjax.cli import main as command
    except KeyboardInterrupt:
        print("irisjax: interrupted", file=sys.stderr)
        sys.exit(130)
    command()


if __name__ == "__main__":
    main()
