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


def lose_files(folder: Path) -> None:
    """Removes the files and folders of all commits from a repository, but not the commits."""
    commits = _git(folder, "rev-list", "--all").split()
    for path in (folder / ".git" / "objects").glob("??/*"):
        if path.parent.name + path.name not in commits:
            path.unlink()


def _git(folder: Path, *arguments: str) -> str:
    return subprocess.run(
        ["git", *arguments], cwd=folder, check=True, capture_output=True, timeout=300, text=True
    ).stdout
