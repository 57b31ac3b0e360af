"""The checker jaxtyping's import hook puts on every function of the package (see conftest)."""

from typing import Any

from beartype import BeartypeConf, beartype

# PEP 484: an int is welcome where a float is asked for, as pyright has it.
_beartype = beartype(conf=BeartypeConf(is_pep484_tower=True))


def checked(function):
    """Check what a function takes or returns, by a check made when the function is first called.

    Of each function jaxtyping hands in two, without bodies: one has the types of its parameters,
    one these and the returned type. It calls the second after the first, with the same arguments in
    one scope of sizes, so that the second checks only what is returned.
    """
    hints = function.__annotations__
    if hints.get("return", Any) is not Any:
        function.__annotations__ = {"return": hints["return"]}
    made = None

    def check(*args, **kwargs):
        nonlocal made
        if made is None:
            made = _beartype(function)
        return made(*args, **kwargs)

    return check
