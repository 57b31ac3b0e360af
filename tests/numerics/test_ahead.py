"""What a command read last time is read before it asks."""

import threading

import pytest

from irisjax.numerics.ahead import Ahead


class Files:
    """Files whose reading is counted and can be held up."""

    def __init__(self, folder, names):
        self.paths = [folder / name for name in names]
        self.notes = folder / "used" / "command"
        self.read, self.free, self.both = [], threading.Event(), threading.Event()
        for path in self.paths:
            path.write_text(path.name)

    def __call__(self, path):
        self.free.wait(30)
        text = path.read_text()
        self.read.append(text)
        if len(self.read) == 2:
            self.both.set()
        return text


@pytest.fixture
def files(tmp_path):
    return Files(tmp_path, "abc")


def used(files, names, notes=None):
    """What a process finds that asks for these."""
    ahead = Ahead(files)
    with ahead.reading(files.notes if notes is None else notes):
        files.free.set()
        return [ahead(path) for path in files.paths if path.name in names]


def test_what_was_used_is_read_next_time_before_it_is_asked_for(files):
    assert used(files, "ab") == ["a", "b"]
    files.read.clear()
    files.both.clear()
    ahead = Ahead(files)
    with ahead.reading(files.notes):
        assert files.both.wait(30)
        assert [ahead(path) for path in files.paths] == ["a", "b", "c"]
    assert files.read == ["a", "b", "c"]  # each once
    assert files.notes.read_text().split() == ["a", "b", "c"]


def test_nobody_waits_for_those_before(files):
    files.notes.parent.mkdir()
    files.notes.write_text("a\nb\nc")
    held = threading.Event()

    def slow(path):
        if path.name == "a":
            held.wait(30)
        return path.name

    ahead = Ahead(slow)
    with ahead.reading(files.notes):
        assert ahead(files.paths[2]) == "c"  # while a is being read
        held.set()


def test_a_file_that_is_gone_or_broken_is_said_where_it_is_asked_for(files):
    used(files, "abc")
    files.paths[1].unlink()
    with pytest.raises(FileNotFoundError):
        used(files, "abc")
    files.notes.write_bytes(b"\x00../..\n")
    assert used(files, "a") == ["a"]


def test_a_later_command_of_the_process_keeps_the_notes(files):
    used(files, "ab")
    ahead = Ahead(files)
    ahead(files.paths[2])
    with ahead.reading(files.notes):
        ahead(files.paths[0])
    assert files.notes.read_text().split() == ["a", "b"]


def test_an_interrupt_leaves_no_thread_and_the_notes_as_they_were(files):
    used(files, "ab")
    before, ahead = threading.active_count(), Ahead(files)

    def interrupted():
        with ahead.reading(files.notes):
            ahead(files.paths[0])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert threading.active_count() == before
    assert files.notes.read_text().split() == ["a", "b"]


def test_a_folder_that_cannot_be_written_costs_only_time(files, tmp_path):
    (tmp_path / "file").write_text("")
    assert used(files, "a", notes=tmp_path / "file" / "used" / "command") == ["a"]
