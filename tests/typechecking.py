"""The checker jaxtyping's import hook puts on every function of the package (see conftest).

It checks the first calls of a function in each process. All calls would take 8 to 13 % of the time of
the tests (transport, photographs), most of it in a few small functions.
"""

import sys
from typing import Any

from beartype import BeartypeConf, beartype

_CALLS = 100  # of a function, after which it is believed: some are called ten thousand times
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
    made, calls = None, 0

    def check(*args, **kwargs):
        nonlocal made, calls
        if made is None:
            made = _beartype(function)
        calls += 1
        if calls == _CALLS and (checked := sys._getframe(1).f_locals.get("fn")):
            checked.__no_type_check__ = True  # jaxtyping's caller looks for this
        return made(*args, **kwargs)

    return check
