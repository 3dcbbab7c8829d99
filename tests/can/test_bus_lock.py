"""The lock of a CAN bus on systems without abstract sockets: a file in the user's folder."""

from __future__ import annotations

import stat
import sys
from pathlib import Path

import pytest

from thorvaldc.can.bus_lock import BusLock
from thorvaldc.diagnostics.error import DiagnosticError


def test_a_lock_file_is_held_until_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "darwin")
    for _ in range(2):
        with BusLock("slcan:/dev/ttyACM0"):
            with (
                pytest.raises(DiagnosticError, match="uses the bus"),
                BusLock("slcan:/dev/ttyACM0"),
            ):
                pass
            with BusLock("slcan:/dev/ttyACM1"):
                pass
    for file in tmp_path.rglob("*.lock"):
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
