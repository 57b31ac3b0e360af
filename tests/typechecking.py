"""The checker jaxtyping's import hook puts on every function of the package (see conftest)."""

from beartype import BeartypeConf, beartype

# PEP 484: an int is welcome where a float is asked for, as pyright has it.
checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
