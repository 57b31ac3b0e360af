"""Whether the viewer's page can be served."""

import importlib.util
import socket


def check(host: str, port: int) -> None:
    """Raise `ValueError` without viser, and for an address that cannot be had."""
    if importlib.util.find_spec("viser") is None:
        raise ValueError("the viewer needs viser: pip install 'irisjax[view]'")
    # viser would move on to the next free port without a word.
    try:
        with socket.create_server((host, port)):
            pass
    except OSError as error:
        raise ValueError(
            f"cannot listen on port {port} of {host}: {error.strerror or error}"
        ) from None
