"""Illumination tables kept in files, so that those of an eye are computed once per machine.

A file is named by a hash of all that its tables depend on, including the code that computes them.
Files are written whole or not at all, so that runs may share a folder.
"""

import contextlib
import hashlib
import os
import sys
import time
import zipfile
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from irisjax.anatomy.eye import Eye
from irisjax.io.tables import write_atomically
from irisjax.render.illumination import Illumination, deciding
from irisjax.render.scene import Scene

MOST = 8
"""Files a folder keeps (up to 39 MB each); those not used for longest go first."""

_FORMAT = 1
_FIELDS = "flux", "extent", "largest"
_BROKEN = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zipfile.LargeZipFile)


def tables_of(scene: Scene, folder: str | Path | None = None) -> Illumination | None:
    """Return `scene.tables()`, read from a file in `folder` where there is one, and else written
    there; nothing is kept where `folder` is `None`. What is wrong with a file is reported on
    standard error, and the tables are computed.
    """
    if folder is None or scene.eye.cornea is None:
        return scene.tables()
    caustics = scene.grazing()
    name = key(scene.eye, caustics)
    path = Path(folder, f"{name}.npz")
    if path.exists():
        try:
            found = _read(path, name)
            with contextlib.suppress(OSError):  # a folder may be for reading only
                os.utime(path)  # when it was last of use
            return found
        except _BROKEN as error:
            said = (str(error).strip() or type(error).__name__).split("\n")[0]
            _say(f"{path}: not usable ({said}); made again")
    made = Illumination.build(scene.eye, caustics=caustics)
    contents: dict[str, Any] = {field: np.asarray(getattr(made, field)) for field in _FIELDS}
    np.savez(buffer := BytesIO(), key=np.asarray(name), **contents)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, buffer.getvalue())
        _drop_oldest(path.parent)
    except OSError as error:
        _say(f"{path}: the tables could not be kept ({error.strerror})")
    return made


def key(eye: Eye, caustics: bool) -> str:
    """Name of an eye's tables: SHA-256 of what decides them, precision and code included."""
    digest = hashlib.sha256(f"{_FORMAT} {caustics} {jnp.result_type(float)} {_code()}".encode())
    leaves, structure = jax.tree.flatten(deciding(eye))
    digest.update(str(structure).encode())
    for leaf in leaves:
        values = np.asarray(leaf)
        digest.update(f"{values.dtype} {values.shape}".encode() + values.tobytes())
    return digest.hexdigest()


@lru_cache(maxsize=1)
def _code() -> str:
    """Hash of the code that tables are computed with: a change of it needs no new number."""
    digest = hashlib.sha256()
    for place in ("numerics", "optics", "tissue", "anatomy", "render"):
        for path in sorted(Path(__file__).parent.parent.joinpath(place).glob("*.py")):
            digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def _read(path: Path, name: str) -> Illumination:
    # Opened here: of a broken zip numpy would leave the file open.
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        if str(file["key"]) != name:
            raise ValueError("tables of another eye")
        flux, extent, largest = (file[field] for field in _FIELDS)
    kinds = flux.dtype, flux.ndim, extent.shape, largest.shape
    if kinds != (jnp.result_type(float), 4, (), ()):
        raise ValueError("tables of another kind")
    return Illumination(jnp.asarray(flux), jnp.asarray(extent), float(largest))


def _drop_oldest(folder: Path) -> None:
    def age(path: Path) -> float:
        with contextlib.suppress(FileNotFoundError):  # another run may have dropped it
            return -path.stat().st_mtime
        return 0.0

    for path in sorted(folder.glob("*.npz"), key=age)[MOST:]:
        path.unlink(missing_ok=True)
    for path in folder.glob(".*.npz.*.tmp"):  # of runs that were killed
        if -age(path) < time.time() - 3600:
            path.unlink(missing_ok=True)


def _say(message: str) -> None:
    print(f"irisjax: {message}", file=sys.stderr)
