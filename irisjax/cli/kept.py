"""Results of a long job are kept on disk, so that a run which was stopped can be continued."""

import hashlib
import io
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irisjax.io.tables import new_folder, write_atomically


class KeptPieces(NamedTuple):
    """Results of pieces of a job, a file of a folder each, until all are there.

    Attributes:
        folder: Their folder.
        settings: All options on which the results depend.
        sample: Some of the data, by which they are known again.
    """

    folder: Path
    settings: str
    sample: np.ndarray

    @property
    def _owner(self) -> str:
        said = self.settings.encode() + self.sample.tobytes()
        return hashlib.sha256(said).hexdigest()[:16]

    def _file(self, number: int) -> Path:
        return self.folder / f"{self._owner}-{number:08d}.npz"

    def begin(self, resume: bool) -> None:
        """Remove the parts of a stopped run, or check that they can be continued."""
        if not resume:
            self.remove()
        elif any(not path.name.startswith(self._owner) for path in self.folder.glob("*.npz")):
            said = "made from other data or settings; it cannot be resumed with these"
            raise ValueError(f"{self.folder}: {said}")

    def add(self, number: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep the arrays of a piece."""
        data = io.BytesIO()
        np.savez(data, **arrays)  # pyright: ignore[reportArgumentType]
        with new_folder(self.folder.parent), new_folder(self.folder):
            write_atomically(self._file(number), data.getvalue())

    def done(self) -> list[int]:
        """Return the numbers of the pieces that are there, in their order."""
        return sorted(int(path.stem.split("-")[1]) for path in self.folder.glob("*.npz"))

    def read(self, number: int) -> dict[str, np.ndarray]:
        """Return what was added."""
        with np.load(self._file(number)) as file:
            return dict(file)

    def remove(self) -> None:
        """Remove all parts."""
        shutil.rmtree(self.folder, ignore_errors=True)
