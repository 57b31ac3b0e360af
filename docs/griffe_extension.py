"""Completes what mkdocstrings reads from the source of irisjax, for the API pages.

- Classes of Equinox take their fields as arguments: they get the signature that Python gives them.
- A name in backticks that has an entry on an API page becomes a link to it.
"""

import re
from pathlib import Path

import griffe

HERE = Path(__file__).parent

_MODULES = {"Module", "eqx.Module", "equinox.Module", "NamedTuple"}
# Names that are not linked, because they are common words too.
_WORDS = {"fit", "sample", "spectrum", "problem", "colour", "check", "export", "picture"}


class Irisjax(griffe.Extension):
    """Adds signatures to Equinox modules, and links to docstrings."""

    def on_package(self, *, pkg: griffe.Module, **_):
        """Change what was read of irisjax, given as `pkg`."""
        self.names = documented()
        classes = [c for m in _modules(pkg) for c in m.classes.values() if not c.is_alias]
        for found in [c for c in classes if _is_module(c)]:
            _give_signature(found)
        for module in _modules(pkg):
            self._link(module)

    def _link(self, parent):
        for member in parent.members.values():
            if member.is_alias:
                continue
            if member.docstring is not None:
                member.docstring.value = self._linked(member.docstring.value, member)
            if member.is_class:
                self._link(member)

    def _linked(self, text: str, member) -> str:
        own = {member.name, member.parent.name}
        if member.is_function:
            own |= {p.name for p in member.parameters}
        elif member.is_class:
            own |= member.members.keys()

        def link(match):
            name = match[1]
            if name in own or name in _WORDS or name not in self.names:
                return match[0]
            return f"[{match[0]}][{self.names[name]}]"

        # Matches `Iris`, `Iris.replace` and `MonteCarlo(1000)`, unless they are links already.
        return re.sub(r"(?<!\[)`([A-Za-z_]\w*)(?:\.\w+)?(?:\([^`()]*\))?`(?!\])", link, text)


def documented() -> dict[str, str]:
    """Return the path of every object that has an entry on an API page, by its name."""
    pages = (page.read_text(encoding="utf-8") for page in sorted((HERE / "api").glob("*.md")))
    paths = re.findall(r"^::: (\S+)", "\n".join(pages), flags=re.M)
    return {path.rsplit(".", 1)[1]: path for path in paths}


def _modules(package):
    yield package
    for module in package.modules.values():
        if not module.is_alias:
            yield from _modules(module)


def _fields(found) -> dict[str, griffe.Attribute]:
    """Return the fields of a class in order, with those of the irisjax classes that it extends."""
    out = {}
    for base in reversed(found.mro()):
        out |= _own_fields(base)
    return out | _own_fields(found)


def _own_fields(found):
    return {
        name: member
        for name, member in found.members.items()
        if member.is_attribute
        and member.annotation is not None
        and "property" not in member.labels
        and not any(kind in str(member.annotation) for kind in ("ClassVar", "AbstractVar"))
        and "init=False" not in str(member.value).replace(" ", "")
    }


def _is_module(found) -> bool:
    try:
        line = (found, *found.mro())
    except ValueError:  # bases of other packages
        return False
    return bool({str(base) for c in line for base in c.bases} & _MODULES) and not any(
        "__init__" in c.members for c in line
    )


def _give_signature(found: griffe.Class) -> None:
    parameters = [
        griffe.Parameter(
            name,
            annotation=field.annotation,
            kind=griffe.ParameterKind.positional_or_keyword,
            default=_default(field.value),
        )
        for name, field in _fields(found).items()
    ]
    own = griffe.Parameter("self", kind=griffe.ParameterKind.positional_or_keyword)
    init = griffe.Function("__init__", parameters=griffe.Parameters(own, *parameters), returns=None)
    found.set_member("__init__", init)


def _default(value):
    """Return the default of a field: the argument of the declaring call that states it."""
    if isinstance(value, griffe.ExprCall):
        keywords = {a.name: a.value for a in value.arguments if isinstance(a, griffe.ExprKeyword)}
        plain = [a for a in value.arguments if not isinstance(a, griffe.ExprKeyword)]
        name = str(value.function)
        if name.startswith("_"):  # a helper of the module that declares fields
            value = plain[-1] if plain else "None"
        elif name.endswith("field"):
            value = keywords.get("default", _made(keywords.get("default_factory")))
    # A private name means nothing to a reader.
    return "…" if re.match(r"_[A-Za-z]", str(value)) else value


def _made(factory):
    if factory is None:
        return None
    return factory.body if isinstance(factory, griffe.ExprLambda) else f"{factory}()"
