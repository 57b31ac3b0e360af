"""Files: what is written can be read again, and nothing is half written."""

import os

import numpy as np
import pytest

from common import read_csv
from irisjax import io


def test_table_round_trip(tmp_path):
    path = tmp_path / "spectrum.csv"
    columns = {"wavelength_nm": np.array([400.0, 410.5]), "reflectance": np.array([1 / 3, 2e-13])}
    header = {"eumelanin": "0.1201 [mg/ml]", "illuminant": "ISO 7589 Photoflood"}
    text = io.format_table(header, columns)
    io.write_atomically(path, text.encode())
    table = read_csv(path)
    assert table.header == {"eumelanin": "0.1201", "illuminant": "ISO 7589 Photoflood"}
    assert list(table.columns) == list(columns)
    for name, column in columns.items():
        np.testing.assert_allclose(table.columns[name], column, rtol=1e-11)
    with pytest.raises(ValueError, match="new line"):
        io.format_table({"note": "one\ntwo"}, {})


@pytest.mark.parametrize(
    ("text", "message"),
    [("# a: 1\n# a: 2\nx\n", "line 2: a appears twice"), (b"\xff\xfe\x00", "not a text file")],
)
def test_unreadable_headers_are_named(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=message) as error:
        io.read_header(path)
    assert str(path) in str(error.value)


def test_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "kept.csv"
    path.write_text("old")

    def no(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", no)
    with pytest.raises(OSError, match="No space"):
        io.write_atomically(path, b"new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["kept.csv"]


def test_files_written_together_are_all_or_none(tmp_path, monkeypatch):
    first, second = tmp_path / "a.csv", tmp_path / "b.png"
    first.write_text("old")
    opened = os.open

    def full(path, *rest):
        if "b.png" in str(path):
            raise OSError(28, "No space left on device", str(path))
        return opened(path, *rest)

    monkeypatch.setattr(os, "open", full)
    with pytest.raises(OSError, match=r"b\.png"):
        io.write_together({first: b"new", second: b"picture"})
    assert first.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.csv"]


def test_links_stay_links_and_permissions_are_the_umasks(tmp_path):
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "file.csv", tmp_path / "link.csv"
    target.write_text("old")
    link.symlink_to(target)
    before = os.umask(0o027)
    try:
        io.write_atomically(link, b"new")
    finally:
        os.umask(before)
    assert link.is_symlink() and target.read_text() == "new"
    assert target.stat().st_mode & 0o777 == 0o640


def test_where_nothing_can_be_written(tmp_path):
    io.write_atomically("/dev/null", b"gone")
    assert not os.path.isfile("/dev/null")
    (tmp_path / "file").write_text("")
    for folder in ("missing", "file"):
        with pytest.raises(FileNotFoundError):
            io.check_writable(tmp_path / folder / "below.csv")
    with pytest.raises(IsADirectoryError):
        io.check_writable(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folder_without_permission(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(PermissionError):
        io.check_writable(tmp_path / "file.csv")
