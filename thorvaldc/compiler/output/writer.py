"""Writes all files of a build to a folder, or leaves the folder unchanged.

All files are first written to a staging folder beside the build folder.  One system call then
exchanges the staging folder and the build folder (``renameat2`` on Linux, ``renamex_np`` on
macOS)::

    build/            <- old build          build/            <- new build
    .thorvaldc-7f3a/  <- new build    ==>   .thorvaldc-7f3a/  <- old build, then deleted

If the process is interrupted (error, Ctrl-C, ``kill -9``), the build folder therefore contains
either the complete old build or the complete new build.

``manifest.json`` lists the files of a build.  Files in the build folder that are not in
``manifest.json`` belong to the user and are kept: the staging folder gets a hard link to each.

If the build folder cannot be exchanged, the files of the build are moved one by one.  A mount
point, the current folder, and a folder on a file system without the system call or without hard
links cannot be exchanged.  If an error occurs while the files are moved, all files are moved
back.  Until the last file is moved, the manifest contains ``"complete": false``.

The writer does not call ``fsync``.  A power failure while a build is written can therefore damage
the build.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import stat
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from thorvaldc.diagnostics import OutsideError, Report
from thorvaldc.diagnostics import files as file_access

MANIFEST = "manifest.json"
_MAX_MANIFEST_BYTES = 16_000_000
FORMAT = "thorvaldc-manifest"


class WriteError(OutsideError):
    """The files of a build cannot be written."""


def manifest(
    files: Mapping[str, bytes],
    *,
    name: str,
    source_sha256: str,
    version: str,
) -> bytes:
    """Returns the content of the manifest file of a build.

    The manifest contains the SHA-256 of each file, the SHA-256 of the input files and the
    version of the compiler.
    """
    content = {
        "format": FORMAT,
        "version": 1,
        "compiler": f"thorvaldc {version}",
        "name": name,
        "source_sha256": source_sha256,
        "complete": True,
        "files": {path: hashlib.sha256(files[path]).hexdigest() for path in sorted(files)},
    }
    return (json.dumps(content, ensure_ascii=False, indent=1) + "\n").encode()


def write_build(
    files: Mapping[str, bytes], folder: Path, *, name: str, source_sha256: str, version: str
) -> None:
    """Replaces the files of the last build in a folder, and keeps the files of the user.

    Raises ``WriteError`` if the build folder cannot be written, and leaves the build folder
    unchanged.

    Parameters
    ----------
    files : content of each file, by the path relative to the folder, with ``/``.
    folder : the build folder.  A manifest is written to the folder, too.
    name : name of the robot, fleet or scenario.
    source_sha256 : SHA-256 of the input files (hexadecimal).
    version : version of the compiler.
    """
    for path in files:
        if not _is_inside(path) or path == MANIFEST:
            raise WriteError(
                f"a backend produced a file named {path!r}, which a build cannot contain"
            )
    build_files = dict(files)
    build_files[MANIFEST] = manifest(files, name=name, source_sha256=source_sha256, version=version)
    shown = _shown(folder)
    target = Path(os.path.realpath(folder))
    try:
        _write(build_files, target, shown)
    except OSError as error:
        raise WriteError(f"cannot write {shown}: {_reason(error, target)}") from error


def write_locks(locks: Mapping[Path, str], report: Report) -> list[Path]:
    """Writes lock files and returns the paths of the files that were written.

    The old lock file is replaced in one step, so that no other program reads half a lock file.  A
    lock file that cannot be written causes a warning and not an error, because the build is
    complete without the lock file.
    """
    written = []
    for path, text in locks.items():
        target = Path(os.path.realpath(path))
        try:
            _check_writable(target if target.exists() else target.parent, str(path))
            file_access.write_file(target, text)
            written.append(path)
        except (OSError, WriteError) as error:
            message = str(error)
            if isinstance(error, OSError):
                message = f"cannot write {path}: {_reason(error, target)}"
            report.add(
                "can-lock-unwritable",
                message,
                hint="ids that were chosen automatically may change when a module is added",
            )
    return written


def _check_writable(target: Path, shown: str) -> None:
    """Raises ``WriteError`` if a folder is read-only.

    The exchange of two folders does not check the permissions of the folders, and would replace a
    read-only folder.  A folder without any write permission is treated as read-only even if the
    user is the superuser.
    """
    folder = next(path for path in (target, *target.parents) if path.exists())
    if not os.access(folder, os.W_OK) or not folder.stat().st_mode & 0o222:
        read_only = "it" if folder == target else f"the folder {folder}"
        raise WriteError(f"cannot write {shown}: {read_only} is read-only")


def _is_inside(path: str) -> bool:
    """Returns whether a path is relative and does not lead out of the folder."""
    pure = PurePosixPath(path)
    return (
        str(pure) == path
        and pure.parts != ()
        and not pure.is_absolute()
        and ".." not in pure.parts
        and "\\" not in path
        and "\0" not in path
        and not pure.parts[0].startswith(file_access.STAGE_PREFIX)
    )


def _shown(folder: Path) -> str:
    """Returns the name of a folder for messages."""
    return str(folder) if str(folder) != "." else "the current folder"


def _reason(error: OSError, target: Path) -> str:
    """Returns the text of an operating system error for the user.

    The error text contains the file name, unless the file is the build folder or is in a staging
    folder.
    """
    text = error.strerror or str(error)
    file_name = error.filename
    if (
        file_name is None
        or str(file_name) == str(target)
        or file_access.STAGE_PREFIX in str(file_name)
    ):
        return text
    return f"{text} ({file_name})"


def _write(files: Mapping[str, bytes], target: Path, shown: str) -> None:
    """Writes the files of a build to a staging folder, and replaces the build folder by the staging
    folder.
    """
    existing = next(path for path in (target, *target.parents) if path.exists())
    if not existing.is_dir():
        subject = "it" if existing == target else existing
        raise WriteError(f"cannot write {shown}: {subject} is a file, not a folder")
    _check_writable(target, shown)
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.exists():
        with locked(target.parent):
            # Files of the user that the build would replace cause an error before any file is
            # written.
            _check_content(_list_content(target), files, shown)
    with staging_folder(target) as stage:
        _fill(stage, files)
        with locked(target.parent), file_access.uninterrupted():
            if not target.exists():
                os.rename(stage, target)
                return
            content = _list_content(target)
            _check_content(content, files, shown)
            os.chmod(stage, stat.S_IMODE(target.stat().st_mode))
            for path in (stage, *stage.rglob("*")):
                file_access.keep_owner(path, target)
            can_exchange = is_exchangeable(target, stage) and _link(
                content.user_files, stage, target
            )
            if can_exchange and exchange(stage, target):
                _return_user_files(stage, target, content)
            else:
                _move_in(stage, target, files, content)


def _fill(stage: Path, files: Mapping[str, bytes]) -> None:
    """Writes all files of a build into the staging folder."""
    created_folders = set()
    for path, data in files.items():
        parent = os.path.dirname(path)
        if parent not in created_folders:
            (stage / parent).mkdir(parents=True, exist_ok=True)
            created_folders.add(parent)
        with open(stage / path, "xb") as out:
            out.write(data)


# -- content of the build folder ----------------------------------------------------------


class _FolderContent(NamedTuple):
    """Relative paths of the build's files and of the user's files in a build folder.

    Attributes
    ----------
    built : files of the last build, including the manifest, as the keys of a dictionary in
        the order of the manifest.  ``None`` if the folder contains no manifest.
    user_files : all other files.  The path of an empty folder ends with ``/``.
    """

    built: dict[str, None] | None
    user_files: list[str]


def listed_files(target: Path) -> dict[str, None] | None:
    """Returns the files of the last build in a folder, including the manifest.

    The files are the keys of the dictionary, in the order of the manifest.  Returns ``None`` if the
    folder contains no manifest.
    """
    with contextlib.suppress(OSError, ValueError, AttributeError, TypeError, LookupError):
        manifest_content = file_access.read_json(
            file_access.read_bounded(target / MANIFEST, _MAX_MANIFEST_BYTES)
        )
        if manifest_content.get("format") == FORMAT:
            paths = [path for path in manifest_content["files"] if _is_inside(path)]
            return dict.fromkeys([*paths, MANIFEST])
    return None


def _list_content(target: Path) -> _FolderContent:
    """Lists the files of the last build and the files of the user in the build folder."""
    built = listed_files(target)
    user_files = []
    for root, folders, names in os.walk(target, onerror=_raise):
        here = Path(root)
        folders[:] = sorted(f for f in folders if not f.startswith(file_access.STAGE_PREFIX))
        # A symbolic link to a folder is treated as a file.  Files inside a symbolically linked
        # folder are not listed.
        links = [f for f in folders if (here / f).is_symlink()]
        relative = here.relative_to(target)
        paths = [(relative / name).as_posix() for name in sorted([*names, *links])]
        user_files += [path for path in paths if built is None or path not in built]
        if not folders and not names and here != target:
            user_files.append(f"{relative.as_posix()}/")
        if built is None and user_files:
            # The search stops at the first files, because a folder that is no build folder may
            # contain very many files.
            break
    return _FolderContent(built, user_files)


def _raise(error: OSError) -> None:
    raise error


def _check_content(content: _FolderContent, files: Mapping[str, bytes], shown: str) -> None:
    """Raises ``WriteError`` if the new build would replace files of the user."""
    if content.built is None and content.user_files:
        raise WriteError(
            f"will not write into {shown}: it contains files that are not of a build"
            f" ({_shorten(content.user_files)}); choose another folder with -o"
        )
    replaced = [path for path in content.user_files if path in files]
    if replaced:
        raise WriteError(
            f"will not write {shown}: it contains {_shorten(replaced)}, which is not of the last"
            " build; move it away first"
        )


def _shorten(paths: list[str]) -> str:
    """Returns the first three paths of a list as text for an error message."""
    return ", ".join(paths[:3]) + (", ..." if len(paths) > 3 else "")


def _link(user_files: list[str], stage: Path, target: Path) -> bool:
    """Adds the files of the user to the staging folder, as hard links, with their folders.

    Returns ``False`` if that is not possible, for instance because of a mount point in the folder.
    """
    try:
        for text in user_files:
            path, is_folder = PurePosixPath(text), text.endswith("/")
            for folder in [*reversed(path.parents), *([path] if is_folder else [])]:
                if not (stage / folder).exists():
                    (stage / folder).mkdir()
                    shutil.copystat(target / folder, stage / folder)
                    file_access.keep_owner(stage / folder, target / folder)
            if not is_folder:
                os.link(target / path, stage / path, follow_symlinks=False)
    except (OSError, NotImplementedError):
        return False
    return True


def _return_user_files(old: Path, target: Path, content: _FolderContent) -> None:
    """Moves files of the user from the old build folder to the new build folder.

    The user may create or replace a file in the old build folder shortly before the folders are
    exchanged.
    """
    for root, folders, names in os.walk(old):
        folders.sort()
        for name in sorted(names):
            path = (Path(root) / name).relative_to(old)
            is_built = content.built is not None and path.as_posix() in content.built
            if not is_built and not _is_same_file(old / path, target / path):
                (target / path).parent.mkdir(parents=True, exist_ok=True)
                os.replace(old / path, target / path)


def _is_same_file(first: Path, second: Path) -> bool:
    """Returns whether two paths are hard links to one file."""
    return os.path.lexists(second) and os.path.samestat(os.lstat(first), os.lstat(second))


# -- moving file by file ------------------------------------------------------------------


def _move_in(
    stage: Path, target: Path, files: Mapping[str, bytes], content: _FolderContent
) -> None:
    """Replaces the files of the old build one by one.

    If a file cannot be replaced, all files of the old build are moved back.
    """
    old_files = [p for p in content.built or {} if p != MANIFEST and _is_file(target / p)]
    backup = stage / f"{file_access.STAGE_PREFIX}old"
    # While the files of a build are moved, the manifest lists the files of the old and the new
    # build.  If the process is killed, the next build may therefore replace the files of both
    # builds.
    interim_manifest = json.loads(files[MANIFEST])
    interim_manifest["complete"] = False
    interim_manifest["files"] = dict.fromkeys([*old_files, *interim_manifest["files"]], "")
    interim_path = stage / f"{file_access.STAGE_PREFIX}manifest"
    interim_path.write_text(json.dumps(interim_manifest), encoding="utf-8")
    moved_away: list[str] = []
    moved_in: list[str] = []
    backup.mkdir()
    try:
        if content.built is not None:
            os.rename(target / MANIFEST, backup / MANIFEST)
            moved_away.append(MANIFEST)
        os.rename(interim_path, target / MANIFEST)
        for path in old_files:
            (backup / path).parent.mkdir(parents=True, exist_ok=True)
            os.rename(target / path, backup / path)
            moved_away.append(path)
        for path in files:
            if path != MANIFEST:
                (target / path).parent.mkdir(parents=True, exist_ok=True)
                os.rename(stage / path, target / path)
                moved_in.append(path)
        os.replace(stage / MANIFEST, target / MANIFEST)
    except BaseException:
        with contextlib.suppress(OSError):
            for path in reversed(moved_in):
                os.rename(target / path, stage / path)
            if content.built is None:
                os.unlink(target / MANIFEST)
            for path in reversed(moved_away):
                os.replace(backup / path, target / path)
        raise
    finally:
        _remove_empty_folders(target, [*old_files, *files])


def _is_file(path: Path) -> bool:
    """Returns whether a path exists and is a file or a symbolic link."""
    return os.path.lexists(path) and (path.is_symlink() or not path.is_dir())


def _remove_empty_folders(target: Path, paths: list[str]) -> None:
    """Removes the parent folders of removed files if the parent folders are empty."""
    parents = {parent for path in paths for parent in PurePosixPath(path).parents}
    for parent in sorted(parents, key=lambda p: (-len(p.parts), str(p))):
        if parent.parts:
            with contextlib.suppress(OSError):
                os.rmdir(target / parent)


# -- staging folders ---------------------------------------------------------------------


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
            stage = parent / f"{file_access.STAGE_PREFIX}{os.getpid()}-{os.urandom(4).hex()}"
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
        with file_access.uninterrupted():
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
        for stage in sorted(parent.glob(f"{file_access.STAGE_PREFIX}*")):
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
