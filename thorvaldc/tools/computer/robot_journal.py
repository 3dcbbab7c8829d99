"""What the service of a robot has written into the journal of systemd."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence
from pathlib import Path

from thorvaldc.diagnostics import OutsideError

LINES = 200
"""Number of the last lines that are shown."""
FOLDERS = ("/var/log/journal", "/run/log/journal")


def show_journal(units: Sequence[str], root: Path, *, follow: bool) -> None:
    """Prints the last lines of units, and with ``follow`` the following ones until Ctrl-C.

    - ``root``: folder of the file system of the computer.

    Raises ``OutsideError`` if there is no journal that this user may read.
    """
    # Without them, journalctl prints "No entries", or waits for ever.
    journals = [
        path
        for folder in FOLDERS
        for path in root.joinpath(folder.lstrip("/")).glob("*/system*.journal")
    ]
    if not journals:
        start = ": start systemd-journald" if root == Path("/") else f" below {root}"
        raise OutsideError(f"there is no journal in {' or '.join(FOLDERS)}{start}")
    if not any(os.access(path, os.R_OK) for path in journals):
        raise OutsideError(
            "this user may not read the journal of the computer: use sudo, or `sudo usermod"
            " --append --groups systemd-journal USER` and log in again"
        )
    command = ["journalctl", "--no-pager", f"--lines={LINES}"]
    command += [f"--unit={unit}" for unit in units]
    command += [f"--root={root}"] if root != Path("/") else []
    command += ["--follow"] if follow else []
    try:
        status = subprocess.run(command, stdin=subprocess.DEVNULL, check=False).returncode
    except FileNotFoundError:
        raise OutsideError("there is no journalctl: this computer does not run systemd") from None
    if status:
        raise OutsideError(f"journalctl ended with status {status}")
