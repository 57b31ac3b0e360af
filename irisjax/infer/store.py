"""Where a chain is kept while it grows: in memory, or in a file that survives a killed process."""

import contextlib
import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from jaxtyping import Float

from irisjax._interrupt import unfinished

Append = Callable[[np.ndarray, np.ndarray], None]
"""Adds one step: places (walkers, free) and their log densities (walkers,)."""
_CHUNK = 16  # steps of a chunk of the file, which is what writing one step rewrites


class ChainStart(NamedTuple):
    """What a chain starts from.

    Attributes:
        owner: What the chain belongs to, in words that two different runs do not share.
        number: How many chains came before it in this run; each was replaced by the next.
        steps_before: Steps of these chains together.
        places: Where the walkers start.
        log_density: The log density there.
        adapted_to: Samples to which the proposals are adapted; `None` before there are any.
    """

    owner: str
    number: int
    steps_before: int
    places: Float[np.ndarray, "walkers free"]
    log_density: Float[np.ndarray, " walkers"]
    adapted_to: Float[np.ndarray, "samples free"] | None


class Store:
    """One chain in an HDF5 file, to which every step is handed before the next one begins.

    A step is complete when its log densities are written: rows without them hold NaN, and the
    number of steps is counted from these. A new stage replaces the whole file at once. Without a
    path the file is in memory.
    """

    def __init__(self, path: str | Path | None = None):
        """Use the file at this path, if any; a damaged one is repaired from its copy.

        Raises:
            ValueError: If the file cannot be read and has no copy.
        """
        self.path, self._memory = None if path is None else Path(path), None
        if self.path is not None and self.path.exists():
            self._repair(self.path)

    @property
    def stage(self) -> ChainStart | None:
        """Return the description of the chain's start, or `None` for an empty store."""
        if self._memory is None and (self.path is None or not self.path.exists()):
            return None
        with self._open() as file:
            about: Any = file.attrs
            return ChainStart(
                str(about["owner"]),
                int(about["stage"]),
                int(about["steps_before"]),
                np.asarray(file["places"]),
                np.asarray(file["places_log_density"]),
                np.asarray(file["adapted_to"]) if "adapted_to" in file else None,
            )

    @property
    def planned(self) -> int:
        """Number of steps at which the chain is judged next; 0 before that is planned."""
        with self._open() as file:
            planned: Any = file.attrs["planned"]
            return int(planned)

    def plan(self, steps: int) -> None:
        """Set `planned`."""
        with self._open("a") as file:
            file.attrs["planned"] = steps

    @property
    def steps(self) -> int:
        """Number of complete steps."""
        with self._open() as file:
            return _complete(file)

    def begin(self, stage: ChainStart) -> None:
        """Replace the chain by one without steps."""
        if self.path is None:
            name = secrets.token_hex(8)  # HDF5 knows open files by their names, in memory too
            self._memory = h5py.File(name, "w", driver="core", backing_store=False)
            _fill(self._memory, stage)
            return
        with unfinished(_temporary(self.path)) as temporary:
            try:
                with h5py.File(temporary, "w") as file:
                    _fill(file, stage)
                os.replace(temporary, self.path)
            finally:
                temporary.unlink(missing_ok=True)

    @contextlib.contextmanager
    def writing(self, most: int) -> Iterator[Append]:
        """Open the store for at most so many further steps."""
        # The file stays open meanwhile: a step costs 0.3 ms and not 5.
        with self._open("a") as file:
            done = _complete(file)
            chain, log_densities = _datasets(file)
            for dataset in (chain, log_densities):
                dataset.resize(done + most, axis=0)

            def append(places: np.ndarray, log_density: np.ndarray) -> None:
                nonlocal done
                chain[done] = places
                log_densities[done] = log_density
                done += 1
                file.flush()

            yield append

    def rows(self, first: int, last: int, every: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Places (steps, walkers, free) and log densities (steps, walkers) of a range of steps."""
        with self._open() as file:
            last = min(last, _complete(file))
            chain, log_densities = (np.asarray(d[first:last:every]) for d in _datasets(file))
            return chain, log_densities

    def drop_last(self) -> None:
        """Remove the last step."""
        with self._open("a") as file:
            _, log_densities = _datasets(file)
            log_densities[_complete(file) - 1] = np.nan

    def save_copy(self) -> None:
        """Guard against a process that dies while it writes; memory dies with its process."""
        if self.path is not None:
            with unfinished(_temporary(self.path)) as temporary:
                shutil.copyfile(self.path, temporary)
                os.replace(temporary, copy_of(self.path))

    def _open(self, mode: str = "r") -> Any:
        if self.path is None:
            return contextlib.nullcontext(self._memory)
        return h5py.File(self.path, mode)

    def _repair(self, path: Path) -> None:
        """Put the copy in the file's place if the file cannot be read."""
        try:
            with self._open() as file:
                chain, log_densities = _datasets(file)
                if len(chain):
                    # Not all at once: chains are longer than memory.
                    for rows in log_densities.iter_chunks():
                        _ = log_densities[rows]
                    _ = chain[-1]
        except (OSError, KeyError, ValueError, RuntimeError) as error:
            if not copy_of(path).exists():
                raise ValueError(
                    f"{path}: damaged ({error}) and without a copy; remove it and start again"
                ) from None
            shutil.copyfile(copy_of(path), path)


def copy_of(path: Path) -> Path:
    """Return where the copy of a chain's file is."""
    return path.with_name(f"{path.name}.bak")


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}.tmp")


def _fill(file: h5py.File, stage: ChainStart) -> None:
    """Write a chain without steps."""
    file.attrs["owner"], file.attrs["stage"] = stage.owner, stage.number
    file.attrs["steps_before"], file.attrs["planned"] = stage.steps_before, 0
    file["places"], file["places_log_density"] = stage.places, stage.log_density
    if stage.adapted_to is not None:
        file["adapted_to"] = stage.adapted_to
    for name, shape in (("chain", stage.places.shape), ("log_density", stage.places.shape[:1])):
        file.create_dataset(
            name, (0, *shape), np.float64, fillvalue=np.nan, chunks=(_CHUNK, *shape),
            maxshape=(None, *shape),
        )  # fmt: skip


def _datasets(file: h5py.File) -> tuple[Any, Any]:
    """Places and log densities of all rows."""
    return file["chain"], file["log_density"]


def _complete(file: h5py.File) -> int:
    """Number of complete steps."""
    unwritten = np.isnan(_datasets(file)[1][:, 0])
    return int(np.argmax(unwritten)) if unwritten.any() else unwritten.size
