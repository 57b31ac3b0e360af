"""Tables as CSV below a header of lines `# key: value [remark]`, read without the remark, and files
that are written whole or not at all.
"""

import contextlib
import csv
import errno
import io
import itertools
import os
import shutil
import tempfile
import threading
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from irisjax._interrupt import unfinished
from irisjax.io.text import HEADER, read_text


def format_table(header: Mapping[str, str], columns: Mapping[str, np.ndarray]) -> str:
    """Text of a CSV file: the header as comments, then columns with the solvers' 12 digits."""
    for key, value in header.items():
        if "\n" in f"{key}{value}" or ":" in key:
            rule = "keys take no colon, and neither keys nor values a new line"
            raise ValueError(f"header entry {key!r}: {rule}")
    comments = "".join(f"# {key}: {value}\n" for key, value in header.items())
    rows = ([f"{float(x):.12g}" for x in row] for row in zip(*columns.values(), strict=True))
    return comments + csv_of(itertools.chain([columns], rows))


def csv_of(rows: Iterable[Iterable[object]]) -> str:
    """Return rows of cells as CSV."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


def read_header(path: str | Path) -> dict[str, str]:
    """Read the header of a CSV file, without remarks; a `ValueError` names file and line."""
    header: dict[str, str] = {}
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if match := HEADER.match(line):
            key, value = match.groups()
            if key in header:
                raise ValueError(f"{path}, line {number}: {key} appears twice in the header")
            header[key] = value
    return header


def first_line(error: object) -> str:
    """The first line of a library's error, or of its text, for a message of one line."""
    return str(error).strip().split("\n")[0][:160] or "no reason given"


@contextlib.contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Begin the text of a `ValueError` with the name of the file that it is about. A file that ends
    too early raises one too: the command would take an `EOFError` for the end of its input.
    """
    try:
        yield
    except (ValueError, EOFError) as error:
        message = str(error)
        if not message.startswith(str(path)):
            message = f"{path}{', ' if message.startswith('line ') else ': '}{message}"
        raise ValueError(message) from None


def check_writable(path: str | Path) -> None:
    """Raise `OSError` now if a file could not be written later, after a long computation."""
    target = Path(path)
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a folder, not a file", str(path))
    if is_device(target):
        return
    folder, named = Path(os.path.realpath(target)).parent, str(target.parent)
    if not folder.is_dir():
        raise FileNotFoundError(errno.ENOENT, "no such folder", named)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, "no permission to write in this folder", named)


def write_atomically(path: str | Path, data: bytes) -> None:
    """Write a file whole or not at all; see `write_together`."""
    write_together({Path(path): data})


def write_together(files: Mapping[Path, bytes]) -> None:
    """Write several files, all or none: new files of the same folders take the names once all are
    written. An `OSError` names a file; those of these names are then unchanged.
    """
    for path in files:
        check_writable(path)
    with contextlib.ExitStack() as stack:
        for path, data in files.items():
            stack.enter_context(replacing(path)).write_bytes(data)


@contextlib.contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give the name of a new file, which replaces `path` (or is copied to a pipe) in the end."""
    path = Path(path)
    check_writable(path)
    if is_device(path):
        with tempfile.TemporaryDirectory() as folder:
            temporary = Path(folder, path.name)
            yield temporary
            with temporary.open("rb") as source, path.open("wb") as device:
                shutil.copyfileobj(source, device)
        return
    target = Path(os.path.realpath(path))
    own = f"{os.getpid()}-{threading.get_ident()}"
    temporary = target.with_name(f".{target.name}.{own}.tmp")
    try:
        with unfinished(temporary):
            # os.open, not tempfile: the file gets the permissions of the user's umask.
            os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
            yield temporary
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            os.replace(temporary, target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename in (None, str(temporary)):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


@contextlib.contextmanager
def new_folder(folder: Path) -> Iterator[None]:
    """Make a folder if it is not there, and remove it again where the work fails."""
    if folder.exists():
        yield
        return
    with unfinished(folder):
        folder.mkdir(parents=True)
        try:
            yield
        except BaseException:
            with contextlib.suppress(OSError):
                folder.rmdir()
            raise


def is_device(path: Path) -> bool:
    """Whether a path is a pipe or a device."""
    return path.exists() and not path.is_file() and not path.is_dir()
