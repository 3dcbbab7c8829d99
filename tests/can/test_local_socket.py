"""Messages over local sockets, and the directory of the sockets."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from thorvaldc.can.local_socket import Unpacker, pack, pack_json, runtime_directory, socket_path


@pytest.mark.parametrize("size", [1, 2, 3, 7, 1000])
def test_messages_from_pieces_of_any_size(size: int) -> None:
    messages = [(b"a", b""), (b"b", b"12345"), (b"c", bytes(300)), (b"d", b"{}")]
    stream = b"".join(pack(kind, body) for kind, body in messages[:3]) + pack_json(b"d", {})
    unpacker = Unpacker()
    pieces = [stream[i : i + size] for i in range(0, len(stream), size)]
    assert [message for piece in pieces for message in unpacker.feed(piece)] == messages


def test_the_runtime_directory_belongs_to_the_user_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert socket_path("robot") == tmp_path / "thorvaldc" / "robot.sock"
    assert stat.S_IMODE(runtime_directory().stat().st_mode) == 0o700
    assert socket_path("/a/b") == Path("/a/b")
    another_user = os.getuid() + 1
    monkeypatch.setattr(os, "getuid", lambda: another_user)
    with pytest.raises(PermissionError, match="belongs to another user"):
        socket_path("robot")


def test_a_link_is_no_runtime_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "thorvaldc").symlink_to(tmp_path / "elsewhere")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(PermissionError, match="is a symbolic link"):
        runtime_directory()
