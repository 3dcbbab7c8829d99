"""Follows the page of the tutorial about a robot's computer, in a container with systemd."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

from tests.container import record_session
from tests.docs.tutorial import FOLDER, Reader

PAGE = FOLDER / "tutorial/computer.md"


def session(record: dict[str, Any]) -> None:
    folder = Path.home() / "scout"
    folder.mkdir()
    # A group of udev, which a container does not have.
    subprocess.run(["groupadd", "--system", "--force", "input"], check=True)
    path = f"/opt/thorvaldc-env/bin{os.pathsep}{os.environ['PATH']}"
    environment = {"HOME": str(Path.home()), "LANG": "C.UTF-8", "PATH": path}
    reader = Reader(folder, environment, is_in_container=True)
    record["differences"] = reader.follow(PAGE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    record_session(session, "thorvaldc-mower.service")
