"""Git repositories for tests."""

from __future__ import annotations

import subprocess
from pathlib import Path

IDENTITY = ("-c", "user.name=Test", "-c", "user.email=test@example.org")


def commit_all(folder: Path, message: str = "all") -> None:
    """Commits every file of a folder, which becomes a repository if it is none."""
    if not (folder / ".git").exists():
        git(folder, "init", "--quiet", "--initial-branch=main")
    git(folder, "add", "--all")
    options = ("--quiet", "--allow-empty", "--no-gpg-sign", "--no-verify")
    git(folder, "commit", *options, "-m", message)


def lose_files(folder: Path) -> None:
    """Removes the files and folders of all commits from a repository, but not the commits."""
    commits = git(folder, "rev-list", "--all").split()
    for path in (folder / ".git" / "objects").glob("??/*"):
        if path.parent.name + path.name not in commits:
            path.unlink()


def git(folder: Path, *arguments: str, text: str = "") -> str:
    """Calls git in a folder with an input, and returns its output."""
    return subprocess.run(
        ["git", *IDENTITY, *arguments],
        cwd=folder,
        check=True,
        input=text,
        capture_output=True,
        timeout=300,
        text=True,
    ).stdout
