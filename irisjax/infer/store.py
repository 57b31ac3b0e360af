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

_CHUNK = 16  # steps of a chunk of the file, which is what writing one step rewrites


class ChainStart(NamedTuple):
    """What a chain starts from.

    Attributes:
        owner: What the chain belongs to, in words that two different runs do not share.
        number: How many chains it replaces in this run, of `steps_before` steps together.
        places: Where the walkers start, and the log density there.
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
    number of steps is counted from these. A new chain replaces the whole file at once. Without a
    path the file is in memory.
    """

    def __init__(self, path: str | Path | None = None):
        """Use the file at this path, if any; one that is damaged is repaired from its copy."""
        self.path: Path | None = None if path is None else Path(path)
        self._memory = None
        if self.path is not None and self.path.exists():
            self._repair(self.path)

    @property
    def start(self) -> ChainStart | None:
        """Start of the chain, or `None` for an empty store."""
        if self._memory is None and (self.path is None or not self.path.exists()):
            return None
        with self._open() as file:
            about = file.attrs
            return ChainStart(
                str(about["owner"]),
                int(about["number"]),
                int(about["steps_before"]),
                np.asarray(file["places"]),
                np.asarray(file["places_log_density"]),
                np.asarray(file["adapted_to"]) if "adapted_to" in file else None,
            )

    @property
    def planned(self) -> int:
        """Number of steps at which the chain is judged next; 0 before that is planned."""
        with self._open() as file:
            return int(file.attrs["planned"])

    @planned.setter
    def planned(self, steps: int) -> None:
        with self._open("a") as file:
            file.attrs["planned"] = steps

    @property
    def steps(self) -> int:
        """Number of complete steps."""
        with self._open() as file:
            return _complete(file)

    def begin(self, start: ChainStart) -> None:
        """Replace the chain by one without steps."""
        if self.path is None:
            name = secrets.token_hex(8)  # HDF5 knows open files by their names, in memory too
            self._memory = h5py.File(name, "w", driver="core", backing_store=False)
            _fill(self._memory, start)
            return
        with _replacing(self.path) as temporary, h5py.File(temporary, "w") as file:
            _fill(file, start)

    @contextlib.contextmanager
    def writing(self, most: int) -> Iterator[Callable[[np.ndarray, np.ndarray], None]]:
        """Open the store for at most so many steps, added as places and their log densities."""
        # The file stays open meanwhile: a step costs 0.3 ms and not 5.
        with self._open("a") as file:
            done = _complete(file)
            chain, log_densities = file["chain"], file["log_density"]
            for dataset in (chain, log_densities):
                dataset.resize(done + most, axis=0)

            def append(places: np.ndarray, log_density: np.ndarray) -> None:
                nonlocal done
                chain[done], log_densities[done] = places, log_density
                done += 1
                file.flush()

            yield append

    def rows(self, first: int, last: int, every: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Places (steps, walkers, free) and log densities (steps, walkers) of a range of steps."""
        with self._open() as file:
            part = slice(first, min(last, _complete(file)), every)
            return np.asarray(file["chain"][part]), np.asarray(file["log_density"][part])

    def last(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the walkers' last places, and the log densities there."""
        steps, start = self.steps, self.start
        if not steps:
            assert start is not None
            return start.places, start.log_density
        places, log_density = self.rows(steps - 1, steps)
        return places[0], log_density[0]

    def drop_last(self) -> None:
        """Remove the last step."""
        with self._open("a") as file:
            file["log_density"][_complete(file) - 1] = np.nan

    def save_copy(self) -> None:
        """Guard against a process that dies while it writes; memory dies with its process."""
        if self.path is not None:
            with _replacing(copy_of(self.path)) as temporary:
                shutil.copyfile(self.path, temporary)

    def _open(self, mode: str = "r") -> Any:
        if self.path is None:
            return contextlib.nullcontext(self._memory)
        return h5py.File(self.path, mode)

    def _repair(self, path: Path) -> None:
        """Put the copy in the file's place if the file cannot be read."""
        try:
            with self._open() as file:
                if len(file["chain"]):
                    # Not all at once: chains are longer than memory.
                    for rows in file["log_density"].iter_chunks():
                        _ = file["log_density"][rows]
                    _ = file["chain"][-1]
        except (OSError, KeyError, ValueError, RuntimeError) as error:
            if not copy_of(path).exists():
                said = f"damaged ({error}) and without a copy; remove it and start again"
                raise ValueError(f"{path}: {said}") from None
            shutil.copyfile(copy_of(path), path)


def copy_of(path: Path) -> Path:
    """Return where the copy of a chain's file is."""
    return path.with_name(f"{path.name}.bak")


@contextlib.contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A new file to fill, which then takes the name."""
    with unfinished(path.with_name(f".{path.name}.{os.getpid()}.tmp")) as temporary:
        try:
            yield temporary
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


def _fill(file: h5py.File, start: ChainStart) -> None:
    """Write a chain without steps."""
    about = {"owner": start.owner, "number": start.number, "steps_before": start.steps_before}
    file.attrs.update(about | {"planned": 0})
    file["places"], file["places_log_density"] = start.places, start.log_density
    if start.adapted_to is not None:
        file["adapted_to"] = start.adapted_to
    for name, shape in (("chain", start.places.shape), ("log_density", start.places.shape[:1])):
        file.create_dataset(
            name, (0, *shape), np.float64, fillvalue=np.nan, chunks=(_CHUNK, *shape),
            maxshape=(None, *shape),
        )  # fmt: skip


def _complete(file: Any) -> int:
    """Number of complete steps."""
    unwritten = np.isnan(file["log_density"][:, 0])
    return int(np.argmax(unwritten)) if unwritten.any() else unwritten.size
