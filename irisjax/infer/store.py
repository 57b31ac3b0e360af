"""A chain while it grows: in memory, and saved to a file that survives a killed process."""

import os
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from jaxtyping import Float

from irisjax._interrupt import unfinished


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
    """One chain in memory and, given a path, in an HDF5 file that is replaced whole by `save`.

    Attributes:
        start: Start of the chain, or `None` for an empty store.
        planned: Number of steps at which the chain is judged next; 0 before that is planned.
    """

    def __init__(self, path: str | Path | None = None):
        """Use the file at this path, if any; `ValueError` if it has no whole chain."""
        self.path: Path | None = None if path is None else Path(path)
        self.start: ChainStart | None = None
        self.planned: int = 0
        self._places: list[np.ndarray] = []
        self._log_density: list[np.ndarray] = []
        if self.path is not None and self.path.exists():
            try:
                self._read(self.path)
            except (OSError, KeyError) as error:
                message = f"damaged ({error}); remove it and start again"
                raise ValueError(f"{self.path}: {message}") from None

    @property
    def steps(self) -> int:
        """Number of steps."""
        return len(self._places)

    def begin(self, start: ChainStart) -> ChainStart:
        """Replace the chain by one without steps, from this start, which is returned."""
        self.start, self.planned, self._places, self._log_density = start, 0, [], []
        self.save()
        return start

    def append(
        self, places: Float[np.ndarray, "walkers free"], log_density: Float[np.ndarray, " walkers"]
    ) -> None:
        """Add a step; the arrays are copied."""
        self._places.append(np.array(places))
        self._log_density.append(np.array(log_density))

    def rows(self, first: int, last: int, every: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Places (steps, walkers, free) and log densities (steps, walkers) of a range of steps."""
        selection = slice(first, last, every)
        return np.array(self._places[selection]), np.array(self._log_density[selection])

    def last(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the walkers' last places, and the log densities there."""
        if self.steps:
            return self._places[-1], self._log_density[-1]
        assert self.start is not None
        return self.start.places, self.start.log_density

    def save(self) -> None:
        """Write the file, if there is one."""
        if self.path is None or self.start is None:
            return
        start = self.start
        arrays: dict[str, Any] = {"chain": self._places, "log_density": self._log_density}
        arrays |= {"places": start.places, "places_log_density": start.log_density}
        if start.adapted_to is not None:
            arrays["adapted_to"] = start.adapted_to
        with unfinished(self.path.with_name(f".{self.path.name}.{os.getpid()}.tmp")) as temporary:
            try:
                with h5py.File(temporary, "w") as file:
                    attributes = {"owner": start.owner, "number": start.number}
                    attributes |= {"steps_before": start.steps_before, "planned": self.planned}
                    file.attrs.update(attributes)
                    for name, array in arrays.items():
                        file[name] = np.asarray(array)
                os.replace(temporary, self.path)
            finally:
                temporary.unlink(missing_ok=True)

    def _read(self, path: Path) -> None:
        with h5py.File(path) as file:
            attributes: dict[str, Any] = dict(file.attrs)
            arrays = {name: np.asarray(values) for name, values in file.items()}
        places = arrays["places"], arrays["places_log_density"], arrays.get("adapted_to")
        counts = int(attributes["number"]), int(attributes["steps_before"])
        self.start = ChainStart(str(attributes["owner"]), *counts, *places)
        self.planned = int(attributes["planned"])
        self._places, self._log_density = list(arrays["chain"]), list(arrays["log_density"])
