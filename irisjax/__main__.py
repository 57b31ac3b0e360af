"""`python -m irisjax` is the command `irisjax`."""

from irisjax.cli import main

main()
