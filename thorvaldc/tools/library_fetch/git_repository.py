"""Reads the files of a library from a tag of a git repository.

git runs without hooks, submodules, filters and questions, and with limits for time and size.  It
fetches one commit into a new repository in a temporary folder; the files are the objects of git, as
they are: attributes of the repository change none of them.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from thorvaldc.compiler.modules.fetched_library import MAX_BYTES
from thorvaldc.diagnostics import DiagnosticError, did_you_mean
from thorvaldc.tools.library_fetch.library_stage import LibraryStage, refused

TIMEOUT = 300.0  # s, for all calls of git
_MAX_SIZE = 2 * MAX_BYTES  # of what git fetches, and of its output
_STEP = 0.05  # s, between two looks at the time and the size
# Environment variables with which git would use another repository, or ask in a window.
_VARIABLES = {
    *("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_PREFIX", "GIT_COMMON_DIR"),
    *("GIT_OBJECT_DIRECTORY", "GIT_ALTERNATE_OBJECT_DIRECTORIES", "GIT_NAMESPACE"),
}
_OPTIONS = (
    *("-c", f"core.hooksPath={os.devnull}", "-c", "core.fsmonitor=false"),
    *("-c", "gc.auto=0", "-c", "maintenance.auto=false", "-c", "fetch.unpackLimit=1"),
)
_FILES = ("100644", "100755", "100664")


def fetch_tag(url: str, tag: str, stage: LibraryStage) -> str:
    """Writes the files of a tag into the stage, and returns its commit.

    Raises ``DiagnosticError`` if git is not installed or fails, if there is no such tag, or if the
    tag has something else than files and folders.
    """
    git = _Git(stage.work)
    git.call("init", "--quiet", "--bare", "--template=", ".")
    name = f"refs/tags/{tag}"
    options = ("--quiet", "--depth=1", "--no-tags", "--no-recurse-submodules", "--no-auto-gc")
    try:
        git.call("fetch", *options, "--", url, f"+{name}:{name}")
        commit = git.call("rev-parse", "--verify", "--quiet", f"{name}^{{commit}}").decode().strip()
    except DiagnosticError as error:
        raise _without_tag(git, url, tag) or error from None
    files = [*_files(git, commit, stage)]
    ids = "".join(f"{blob}\n" for _, blob, _ in files)
    with git.output("cat-file", "--batch", text=ids.encode()) as objects:
        for path, _, size in files:
            objects.readline()  # <id> blob <size>
            stage.add(path, [objects.read(size)])
            objects.read(1)
    return commit


def _files(git: _Git, commit: str, stage: LibraryStage) -> Iterator[tuple[str, str, int]]:
    """Yields the path in the library, the blob and the size (bytes) of each file of a commit."""
    files = total = 0
    with git.output("ls-tree", "-r", "-l", "-z", "--full-tree", commit) as listing:
        for number, entry in enumerate(_records(listing)):
            stage.check_size(number // 4, 0)
            head, _, name = entry.partition("\t")
            mode, _, blob, size = head.split()
            path = stage.path_of(name)
            if path is None:
                continue
            if mode not in _FILES:
                kind = "a submodule" if mode == "160000" else "a link"
                raise refused(f"{name!r} is {kind}, which is not allowed")
            files, total = files + 1, total + int(size)
            stage.check_size(files, total)
            yield path, blob, int(size)


def _records(file: IO[bytes]) -> Iterator[str]:
    rest = b""
    while part := file.read(1 << 16):
        *records, rest = (rest + part).split(b"\0")
        for record in records:
            yield record.decode("utf-8", "surrogateescape")


def _without_tag(git: _Git, url: str, tag: str) -> DiagnosticError | None:
    """Returns the error that a repository has no such tag, or ``None`` if it has it."""
    try:
        lines = git.call("ls-remote", "--tags", "--refs", "--", url).decode("utf-8", "replace")
    except DiagnosticError:
        return None
    tags = [line.rpartition("refs/tags/")[2] for line in lines.splitlines()]
    if tag in tags:
        return None
    return refused(f"it has no tag `{tag}`", did_you_mean(tag, tags, "push the tag"))


class _Git:
    """Calls git in a folder, which may grow to a limit, until a time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._end = time.monotonic() + TIMEOUT

    def call(self, *arguments: str) -> bytes:
        """Returns the output of a call."""
        with self.output(*arguments) as file:
            return file.read()

    @contextlib.contextmanager
    def output(self, *arguments: str, text: bytes = b"") -> Iterator[IO[bytes]]:
        """Calls git with an input, and opens the file with its output."""
        files = [self._folder / f"thorvaldc-{name}" for name in ("input", "output", "errors")]
        files[0].write_bytes(text)
        with files[0].open("rb") as stdin, files[1].open("w+b") as stdout:
            with files[2].open("w+b") as stderr:
                status = self._run(arguments, stdin, stdout, stderr)
                if status:
                    stderr.seek(0)
                    raise _failure(arguments[0], status, stderr.read(10_000))
            stdout.seek(0)
            yield stdout

    def _run(self, arguments: tuple[str, ...], *streams: IO[bytes]) -> int:
        environment = {k: v for k, v in os.environ.items() if k not in _VARIABLES}
        environment |= {"GIT_TERMINAL_PROMPT": "0", "GIT_ASKPASS": "", "LC_ALL": "C"}
        environment |= {"GIT_ALLOW_PROTOCOL": "file:https:ssh", "GIT_DIR": str(self._folder)}
        # Without a terminal, which a new session lacks, ssh would ask in a window.
        environment["SSH_ASKPASS_REQUIRE"] = "never"
        stdin, stdout, stderr = streams
        try:
            process = subprocess.Popen(
                ["git", *_OPTIONS, *arguments],
                cwd=self._folder,
                env=environment,
                stdin=stdin,
                stdout=stdout,
                stderr=stderr,
                start_new_session=True,
            )
        except FileNotFoundError:
            message = "the program git is not installed"
            raise DiagnosticError("git-unavailable", message, hint="install git") from None
        try:
            status = None
            while status is None:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    status = process.wait(_STEP)
                if time.monotonic() > self._end:
                    raise refused(f"git takes more than {TIMEOUT:.0f} s")
                if _size(self._folder) > _MAX_SIZE:
                    raise refused(f"git needs more than {_MAX_SIZE / 1e6:.0f} MB for it")
            return status
        finally:
            # git has processes of its own, also for ssh and https.
            if process.poll() is None:
                if hasattr(os, "killpg"):
                    os.killpg(process.pid, signal.SIGKILL)
                else:
                    process.kill()
                process.wait()


def _size(folder: Path) -> int:
    """Returns the size of the files in a folder in bytes."""
    size = 0
    for root, _, files in os.walk(folder):
        for name in files:
            with contextlib.suppress(OSError):  # git has renamed or removed it
                size += os.lstat(os.path.join(root, name)).st_size
    return size


def _failure(command: str, status: int, errors: bytes) -> DiagnosticError:
    lines = errors.decode("utf-8", "replace").strip().splitlines()
    causes = [line for line in lines if line.startswith(("ssh:", "fatal:", "error:"))] or lines
    reason = causes[0].removeprefix("fatal: ") if causes else f"exit status {status}"
    printable = "".join(c if c.isprintable() else " " for c in reason)[:300]
    return refused(f"git {command} failed: {printable}")
