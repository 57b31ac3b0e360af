"""What is made once a machine and not once a run: compiled programs, illumination tables."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import jax

from irisjax.numerics.programs import keep_programs

if TYPE_CHECKING:
    from irisjax.render.illumination import Illumination
    from irisjax.render.scene import Scene


def folder() -> Path | None:
    """Where it is kept: JAX_COMPILATION_CACHE_DIR names another folder, or, when empty, none."""
    if (given := os.environ.get("JAX_COMPILATION_CACHE_DIR")) is not None:
        return Path(given) if given else None
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "irisjax"


def cores() -> int:
    """Threads that a command shares pixels among: a power of two, so that no share is padded."""
    return 1 << (min(os.cpu_count() or 1, 8).bit_length() - 1)


def keep_compiled() -> None:
    """Trace and compile once a machine. A folder from the environment JAX finds by itself."""
    place = folder()
    keep_programs(None if place is None else place / "programs")
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        jax.config.update("jax_compilation_cache_dir", str(place))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def kept_tables(scene: "Scene") -> "Illumination | None":
    """`scene.tables()`, made once a machine."""
    from irisjax.io.illumination import tables_of

    place = folder()
    return tables_of(scene, None if place is None else place / "illumination")
