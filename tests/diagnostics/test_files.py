"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import stat
import threading
from pathlib import Path

import pytest

from tests.full_disk import full_disk
from thorvaldc.diagnostics.files import AtomicFile, append_whole, write_file


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "page.html"
    file.write_text("old")
    return file


def test_a_file_is_replaced_in_one_step(path: Path) -> None:
    file = AtomicFile(path)
    file.write("new ø")
    file.flush()
    assert path.read_text() == "old"
    file.close()
    file.close()
    assert path.read_text("utf-8") == "new ø"
    assert os.listdir(path.parent) == ["page.html"]


@pytest.mark.parametrize("size", [5000, 50_000])
def test_a_full_disk_leaves_the_old_file(path: Path, size: int) -> None:
    """Small content reaches the disk only when the file is closed."""
    with full_disk(1000), pytest.raises(OSError, match=r"File too large.*page\.html"):
        write_file(path, "x" * size)
    assert path.read_text() == "old"
    assert os.listdir(path.parent) == ["page.html"]


def test_what_was_written_is_kept_beside_it_on_demand(path: Path) -> None:
    file = AtomicFile(path, keep_incomplete=True)
    file.write("0123456789\n" * 50)
    file.flush()
    with full_disk(1000), pytest.raises(OSError, match="page"):
        file.write("0123456789\n" * 10000)
    file.close()
    assert path.read_text() == "old"
    assert (path.parent / "page.html.incomplete").read_text().startswith("0123456789\n")
    assert len(os.listdir(path.parent)) == 2


def test_an_error_in_the_block_leaves_the_old_file(path: Path) -> None:
    def write() -> None:
        with AtomicFile(path) as file:
            file.write("new")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write()
    assert path.read_text() == "old"
    assert os.listdir(path.parent) == ["page.html"]


def test_permissions_and_links_stay(path: Path) -> None:
    path.chmod(0o640)
    link = path.with_name("link")
    link.symlink_to("page.html")
    write_file(link, b"new")
    assert link.is_symlink()
    assert path.read_bytes() == b"new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    old = os.umask(0o027)
    try:
        write_file(path.with_name("other"), b"")
    finally:
        os.umask(old)
    assert stat.S_IMODE(path.with_name("other").stat().st_mode) == 0o640


def test_a_new_file_replaces_nothing(path: Path) -> None:
    with pytest.raises(FileExistsError, match="page"):
        write_file(path, "new", new=True)
    created_later = path.with_name("later")
    file = AtomicFile(created_later, new=True)
    file.write("new")
    created_later.write_text("of another program")
    with pytest.raises(FileExistsError, match="later"):
        file.close()
    assert created_later.read_text() == "of another program"
    created_later.unlink()
    write_file(created_later, "new", new=True)
    assert created_later.read_text() == "new"
    assert sorted(os.listdir(path.parent)) == ["later", "page.html"]


def test_a_device_and_a_pipe_are_written_directly(tmp_path: Path) -> None:
    write_file(Path("/dev/null"), "text")
    if Path("/dev/full").exists():
        with pytest.raises(OSError, match=r"No space left.*/dev/full"):
            write_file(Path("/dev/full"), "text")
    os.mkfifo(tmp_path / "pipe")
    received = []
    reader = threading.Thread(target=lambda: received.append((tmp_path / "pipe").read_text()))
    reader.start()
    write_file(tmp_path / "pipe", "text")
    reader.join(10.0)
    assert received == ["text"]
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


@pytest.mark.parametrize("name", ["folder", "none/page.html", "page.html/page.html"])
def test_an_error_names_the_file(path: Path, name: str) -> None:
    (path.parent / "folder").mkdir()
    with pytest.raises(OSError, match=name):
        write_file(path.parent / name, "text")


def test_a_line_is_appended_whole_or_not_at_all(tmp_path: Path) -> None:
    with (tmp_path / "log").open("ab", buffering=0) as log, full_disk(25):
        append_whole(log.fileno(), b"0123456789\n")
        append_whole(log.fileno(), b"0123456789\n")
        with pytest.raises(OSError, match="too large"):
            append_whole(log.fileno(), b"0123456789\n")
    assert (tmp_path / "log").read_bytes() == b"0123456789\n" * 2
