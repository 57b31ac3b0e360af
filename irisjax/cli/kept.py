"""Results of a long job on disk, so that a stopped run can be continued."""

import hashlib
import io
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irisjax.io.tables import new_folder, write_atomically


class KeptPieces(NamedTuple):
    """Results of the pieces of a job, in a file each, until all are done.

    Attributes:
        folder: Folder of the files.
        settings: All options on which the results depend.
        sample: Some of the data, by which a run on the same data is recognised.
    """

    folder: Path
    settings: str
    sample: np.ndarray

    @property
    def _owner(self) -> str:
        identity = self.settings.encode() + self.sample.tobytes()
        return hashlib.sha256(identity).hexdigest()[:16]

    def _file(self, number: int) -> Path:
        return self.folder / f"{self._owner}-{number:08d}.npz"

    def begin(self, resume: bool) -> None:
        """Remove the parts of a stopped run, or check that they can be continued."""
        if not resume:
            self.remove()
        elif any(not path.name.startswith(self._owner) for path in self.folder.glob("*.npz")):
            message = "made from other data or settings; it cannot be resumed with these"
            raise ValueError(f"{self.folder}: {message}")

    def add(self, number: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep the arrays of a piece."""
        data = io.BytesIO()
        np.savez(data, **arrays)  # pyright: ignore[reportArgumentType]
        with new_folder(self.folder.parent), new_folder(self.folder):
            write_atomically(self._file(number), data.getvalue())

    def done(self) -> list[int]:
        """Return the numbers of the pieces that are done, in their order."""
        return sorted(int(path.stem.split("-")[1]) for path in self.folder.glob("*.npz"))

    def read(self, number: int) -> dict[str, np.ndarray]:
        """Return the arrays of a piece."""
        with np.load(self._file(number)) as file:
            return dict(file)

    def remove(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
