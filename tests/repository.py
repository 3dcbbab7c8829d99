"""Git repositories for tests."""

from __future__ import annotations

import subprocess
from pathlib import Path


def commit_all(folder: Path, message: str = "all") -> None:
    """Commits every file of a folder, which becomes a repository if it is none."""
    if not (folder / ".git").exists():
        _git(folder, "init", "--quiet", "--initial-branch=main")
    _git(folder, "add", "--all")
    identity = ("-c", "user.name=Test", "-c", "user.email=test@example.org")
    options = ("--quiet", "--allow-empty", "--no-gpg-sign", "--no-verify")
    _git(folder, *identity, "commit", *options, "-m", message)


def _git(folder: Path, *arguments: str) -> None:
    subprocess.run(["git", *arguments], cwd=folder, check=True, capture_output=True, timeout=60)
