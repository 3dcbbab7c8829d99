"""Creates staging folders, locks folders, and exchanges two folders in one system call."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from thorvaldc.diagnostics.atomic_file import STAGE_PREFIX
from thorvaldc.diagnostics.interrupts import uninterrupted


@contextlib.contextmanager
def staging_folder(target: Path) -> Iterator[Path]:
    """Creates a staging folder for new files, and deletes the staging folder at the end of the
    ``with`` block.

    The staging folder is on the same file system as ``target``.  The staging folder is beside the
    target folder if possible, and otherwise inside the target folder.

    Each process locks the staging folder that the process uses.  An unlocked staging folder was
    left by a killed process and is deleted.
    """
    parents = [target.parent]
    if target.exists():
        parents = [target] if _is_fixed(target) else [target.parent, target]
    handle = None
    try:
        for i, parent in enumerate(parents):
            stage = parent / f"{STAGE_PREFIX}{os.getpid()}-{os.urandom(4).hex()}"
            try:
                with locked(parent):
                    _delete_abandoned(parent)
                    stage.mkdir()
                    handle = _lock(stage, wait=False)
                break
            except OSError:
                if i + 1 == len(parents):
                    raise
        yield stage
    finally:
        with uninterrupted():
            shutil.rmtree(stage, ignore_errors=True)
            if handle is not None:
                os.close(handle)


def _is_fixed(target: Path) -> bool:
    """Returns whether a folder must keep the inode and therefore cannot be exchanged with another
    folder.

    Mount points, the current folder and the parents of the current folder must keep the inode.  If
    the current folder were exchanged, the user's shell would be in a deleted folder.
    """
    try:
        current = Path.cwd()
    except OSError:
        return os.path.ismount(target)
    return os.path.ismount(target) or current == target or target in current.parents


def _delete_abandoned(parent: Path) -> None:
    """Deletes the staging folders of killed processes in a folder."""
    with contextlib.suppress(OSError):
        for stage in sorted(parent.glob(f"{STAGE_PREFIX}*")):
            handle = _lock(stage, wait=False)
            if handle is not None:
                shutil.rmtree(stage, ignore_errors=True)
                os.close(handle)


# -- locks --------------------------------------------------------------------------------


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Locks a folder, and waits if another build has locked the folder.

    On an operating system without the function ``flock``, folders are not locked.
    """
    handle = _lock(folder, wait=True)
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


def _lock(folder: Path, *, wait: bool) -> int | None:
    """Locks a folder until the caller closes the returned file descriptor.

    Returns ``None`` if the folder cannot be locked.
    """
    try:
        import fcntl  # The module `fcntl` does not exist on Windows.

        handle = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(handle)
        return None
    return handle


# -- exchange -----------------------------------------------------------------------------


def is_exchangeable(target: Path, stage: Path) -> bool:
    """Returns whether the target and the staging folder can be exchanged.

    The target and the staging folder must be in the same folder, and the target must not be a mount
    point or the current folder.
    """
    return stage.parent == target.parent and not _is_fixed(target)


def exchange(first: Path, second: Path) -> bool:
    """Exchanges two folders in one system call.

    Returns ``False`` if the operating system does not support the exchange.
    """
    import ctypes  # The module `ctypes` is needed only to replace an old build.

    try:
        library = ctypes.CDLL(None, use_errno=True)
        paths = os.fsencode(first), os.fsencode(second)
        if sys.platform == "darwin":
            return bool(library.renamex_np(*paths, 2) == 0)  # RENAME_SWAP
        at_cwd, rename_exchange = -100, 2  # AT_FDCWD, RENAME_EXCHANGE
        return bool(library.renameat2(at_cwd, paths[0], at_cwd, paths[1], rename_exchange) == 0)
    except (OSError, AttributeError, TypeError):
        return False
