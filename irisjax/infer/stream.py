"""Chains on disk: emcee's HDF5 backend with the file held open, so that a step costs 0.3 ms and not
5.
"""

import contextlib
import os
import shutil
from pathlib import Path
from typing import Any

import emcee
import h5py
import numpy as np

from irisjax._interrupt import unfinished


class Stream(emcee.backends.HDFBackend):
    """One group of an HDF5 file; every step is handed to the operating system before the next
    begins.

    A step is there when its log probabilities are: unwritten rows hold NaN, and the number of steps
    is read off them. Random states are not stored: step i draws from the key and i.
    """

    _file: Any = None

    def open(self, mode="r") -> Any:
        """The file, held or opened for now."""
        return contextlib.nullcontext(self._file) if self._file is not None else super().open(mode)

    def reset(self, nwalkers, ndim):
        """A new, empty chain."""
        super().reset(nwalkers, ndim)
        with self.open("a") as file:
            group = file[self.name]
            for name, shape in (("chain", (nwalkers, ndim)), ("log_prob", (nwalkers,))):
                del group[name]
                # A chunk is what a step rewrites.
                kind = {"fillvalue": np.nan, "chunks": (16, *shape), "maxshape": (None, *shape)}
                group.create_dataset(name, (0, *shape), np.float64, **kind)
            for i, value in enumerate(np.random.RandomState(0).get_state()):
                group.attrs[f"random_state_{i}"] = value

    @contextlib.contextmanager
    def held(self):
        """Keep the file open meanwhile."""
        with super().open("a") as file:
            group: Any = file[self.name]
            done = self._count(group)
            self._file, self._done = file, done
            self._chain, self._log_prob = group["chain"], group["log_prob"]
            moved = np.zeros(self._log_prob.shape[1])
            self._accepted = moved
            try:
                yield
            finally:
                group["accepted"][...] += moved
                self._file = None

    def save_step(self, state, accepted):
        """Append a step."""
        assert self._file is not None
        self._chain[self._done] = state.coords
        self._log_prob[self._done] = state.log_prob
        self._accepted += accepted
        self._done += 1
        self._file.flush()

    def grow(self, ngrow, blobs):
        """Room for so many steps more."""
        with self.open("a") as file:
            group = file[self.name]
            for name in ("chain", "log_prob"):
                group[name].resize(self._count(group) + ngrow, axis=0)

    def get_value(self, name, flat=False, thin=1, discard=0):
        """Rows of whole steps; there are no blobs."""
        if name == "blobs":
            return None
        with self.open() as file:
            rows = file[self.name][name][discard + thin - 1 : self._count(file[self.name]) : thin]
        return rows.reshape(-1, *rows.shape[2:]) if flat else rows

    @property
    def iteration(self):
        """Number of whole steps."""
        if self._file is not None:
            return self._done
        with self.open() as file:
            return self._count(file[self.name])

    def begin(self, places, mark: str | None = None, taught=None, lesson: int = 0) -> None:
        """Keep where the walkers begin, a mark of what the file belongs to, samples (n, free)
        that teach jumps, if there are any yet, and how many chains before it taught them.
        """
        with self.open("a") as file:
            file[self.name]["start"] = places
            if taught is not None:
                file[self.name]["taught"] = taught
            if mark is not None:
                file.attrs["problem"], file.attrs["lesson"] = mark, lesson

    def first(self) -> np.ndarray:
        """Where the walkers began."""
        with self.open() as file:
            return np.asarray(file[self.name]["start"])

    def taught(self) -> np.ndarray | None:
        """Samples that teach jumps, if it began with some."""
        with self.open() as file:
            group = file[self.name]
            return np.asarray(group["taught"]) if "taught" in group else None

    def mark(self) -> str | None:
        """What the file belongs to."""
        with self.open() as file:
            return file.attrs.get("problem")

    def lesson(self) -> int:
        """How many chains taught the file's jumps."""
        with self.open() as file:
            return int(file.attrs.get("lesson", 0))

    def plan(self, steps: int) -> None:
        """Keep at how many steps to look next, for a run that is resumed."""
        with self.open("a") as file:
            file[self.name].attrs["next_look"] = steps

    def next_look(self) -> int:
        """That number, 0 before the first look."""
        with self.open() as file:
            return int(file[self.name].attrs.get("next_look", 0))

    def rows(self, first: int, last: int) -> np.ndarray:
        """Steps first to last, (steps, walkers, free)."""
        with self.open() as file:
            return np.asarray(file[self.name]["chain"][first:last])

    def drop_last(self) -> None:
        """Forget the last step."""
        with self.open("a") as file:
            group = file[self.name]
            group["log_prob"][self._count(group) - 1] = np.nan

    @staticmethod
    def _count(group) -> int:
        written = np.isnan(group["log_prob"][:, 0])
        return int(np.argmax(written)) if written.any() else written.size


def checkpoint(path: Path) -> None:
    """A whole copy to fall back on should the process die in the midst of writing to the file
    itself.
    """
    with unfinished(path.with_name(f".{path.name}.{os.getpid()}.tmp")) as temporary:
        shutil.copyfile(path, temporary)
        os.replace(temporary, backup(path))


def backup(path: Path) -> Path:
    """Where that copy is."""
    return path.with_name(f"{path.name}.bak")


def repair(path: Path) -> None:
    """Take the last whole copy if the file cannot be read."""
    try:
        with h5py.File(path, "r") as file:
            group: Any
            for group in file.values():
                if not len(group["chain"]):
                    continue
                # Not all at once: chains are longer than memory.
                for rows in group["log_prob"].iter_chunks():
                    _ = group["log_prob"][rows]
                _ = group["chain"][-1]
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        if not backup(path).exists():
            raise ValueError(
                f"{path}: damaged ({error}) and without a copy; remove it and start again"
            ) from None
        shutil.copyfile(backup(path), path)
