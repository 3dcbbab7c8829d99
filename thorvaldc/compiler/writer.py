"""Writing a build: the whole of it or nothing.

All files are first written to a staging folder beside the build folder; one
system call then exchanges the two (``renameat2`` on Linux, ``renamex_np`` on
macOS).  Whenever the process ends, by a fault, Ctrl-C or ``kill -9``, the build
folder holds a whole build, the last or the new one.

``manifest.json`` lists what a build wrote, and thereby what belongs to us.
Files of others in the folder stay where they are: then, and where the folder
itself cannot be exchanged (a mount point, the current folder, a file system
without the call), the files are moved in one by one, which a fault rolls back;
``"complete": false`` in the manifest marks the moments in between.

Nothing is flushed to the disk with ``fsync``: a power cut is not guarded against.
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

from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.interrupts import uninterrupted

MANIFEST = "manifest.json"
FORMAT = "thorvaldc-manifest"
_STAGE = ".thorvaldc-"


class WriteError(Exception):
    """The build could not be written; the message is one line for the user."""


def manifest(
    files: Mapping[str, bytes],
    *,
    name: str,
    source_sha256: str,
    version: str,
    complete: bool = True,
) -> bytes:
    """The manifest of a build: each file's SHA-256, the source's, the compiler's version."""
    head = {
        "format": FORMAT,
        "version": 1,
        "compiler": f"thorvaldc {version}",
        "name": name,
        "source_sha256": source_sha256,
        "complete": complete,
        "files": {path: hashlib.sha256(files[path]).hexdigest() for path in sorted(files)},
    }
    return (json.dumps(head, ensure_ascii=False, indent=1) + "\n").encode()


def write_build(
    files: Mapping[str, bytes], folder: Path, *, name: str, source_sha256: str, version: str
) -> None:
    """Make ``folder`` hold exactly these files (and what is not ours), and a manifest.

    ``files`` maps paths relative to the folder, with ``/``, to content.  Raises
    ``WriteError`` and leaves the folder as it was where that cannot be done.
    """
    for path in files:
        if not _is_inside(path) or path == MANIFEST:
            raise WriteError(f"a backend made a file named {path!r}, which cannot be in a build")
    made = dict(files)
    made[MANIFEST] = manifest(files, name=name, source_sha256=source_sha256, version=version)
    shown = _shown(folder)
    target = Path(os.path.realpath(folder))
    try:
        _write(made, target, shown)
    except OSError as fault:
        raise WriteError(f"cannot write {shown}: {_reason(fault, target)}") from fault


def write_locks(locks: Mapping[Path, str], report: Report) -> list[Path]:
    """Put lock files in place, each in one step; returns those that were written.

    One that cannot be written is a warning in ``report``: the build is whole without it.
    """
    written = []
    for path, text in locks.items():
        target = Path(os.path.realpath(path))
        stage = target.with_name(f"{_STAGE}{os.getpid()}-{os.urandom(4).hex()}")
        try:
            _check_writable(target if target.exists() else target.parent, str(path))
            try:
                stage.write_bytes(text.encode())
                os.replace(stage, target)
                written.append(path)
            finally:
                with contextlib.suppress(OSError):
                    stage.unlink(missing_ok=True)
        except (OSError, WriteError) as fault:
            message = str(fault)
            if isinstance(fault, OSError):
                message = f"cannot write {path}: {_reason(fault, target)}"
            report.add(
                "can-lock-unwritable",
                message,
                hint="ids that were chosen automatically may change when a module is added",
            )
    return written


def _check_writable(target: Path, shown: str) -> None:
    """The exchange would replace a folder that must not be written; so ask first.

    A folder that nobody may write is meant so, even if the superuser could.
    """
    folder = next(path for path in (target, *target.parents) if path.exists())
    if not os.access(folder, os.W_OK) or not folder.stat().st_mode & 0o222:
        place = "it" if folder == target else f"the folder {folder}"
        raise WriteError(f"cannot write {shown}: {place} is read-only")


def _is_inside(path: str) -> bool:
    """A plain relative path, which stays inside the folder."""
    pure = PurePosixPath(path)
    return (
        str(pure) == path
        and pure.parts != ()
        and not pure.is_absolute()
        and ".." not in pure.parts
        and "\\" not in path
        and "\0" not in path
        and not pure.parts[0].startswith(_STAGE)
    )


def _shown(folder: Path) -> str:
    return str(folder) if str(folder) != "." else "the current folder"


def _reason(fault: OSError, target: Path) -> str:
    text = fault.strerror or str(fault)
    culprit = fault.filename
    # The name of our own staging folder would tell the user nothing.
    if culprit is None or str(culprit) == str(target) or _STAGE in str(culprit):
        return text
    return f"{text} ({culprit})"


def _write(files: Mapping[str, bytes], target: Path, shown: str) -> None:
    if target.exists() and not target.is_dir():
        raise WriteError(f"cannot write {shown}: it is a file, not a folder")
    _check_writable(target, shown)
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.exists():
        with _locked(target.parent):
            _check_ours(_survey(target), files, shown)  # fail early, before the work
    with _staging(target) as stage:
        _fill(stage, files)
        with _locked(target.parent), uninterrupted():
            if not target.exists():
                os.rename(stage, target)
                return
            ours, others = _survey(target)
            _check_ours((ours, others), files, shown)
            os.chmod(stage, stat.S_IMODE(target.stat().st_mode))
            if not others and _exchangeable(target, stage) and _exchange(stage, target):
                _return_others(stage, target, ours)
            else:
                _move_in(stage, target, files, ours)


# -- what is in the folder ------------------------------------------------------------


def _survey(target: Path) -> tuple[dict[str, None] | None, list[str]]:
    """Our files by the last manifest (``None``: there is no manifest), and everything else."""
    ours: dict[str, None] | None = None
    with contextlib.suppress(OSError, ValueError, AttributeError, TypeError):
        head = json.loads((target / MANIFEST).read_bytes())
        if head.get("format") == FORMAT:
            ours = {path: None for path in head["files"] if _is_inside(path)}
            ours[MANIFEST] = None
    others = []
    for root, folders, names in os.walk(target, onerror=_raise):
        here = Path(root)
        folders[:] = sorted(f for f in folders if not f.startswith(_STAGE))
        # A link to a folder is not walked into; it counts as a file.
        links = [f for f in folders if (here / f).is_symlink()]
        inside = here.relative_to(target)
        paths = [(inside / name).as_posix() for name in sorted([*names, *links])]
        others += [path for path in paths if ours is None or path not in ours]
        if not folders and not names and here != target:
            others.append(f"{inside.as_posix()}/")
        if ours is None and others:  # enough is known; do not walk a whole home folder
            break
    return ours, others


def _raise(fault: OSError) -> None:
    raise fault


def _check_ours(
    survey: tuple[dict[str, None] | None, list[str]], files: Mapping[str, bytes], shown: str
) -> None:
    ours, others = survey
    if ours is None and others:
        raise WriteError(
            f"will not write into {shown}: it holds files that are not of a build"
            f" ({_few(others)}); give a folder of its own with -o"
        )
    clash = [path for path in others if path in files]
    if clash:
        raise WriteError(
            f"will not write {shown}: {_few(clash)} there is not of the last build;"
            " move it away first"
        )


def _few(paths: list[str]) -> str:
    return ", ".join(paths[:3]) + (", ..." if len(paths) > 3 else "")


# -- staging --------------------------------------------------------------------------------


@contextlib.contextmanager
def _staging(target: Path) -> Iterator[Path]:
    """A new folder on the target's file system, gone afterwards whatever happens.

    It lies beside the target, or inside where that cannot be.  While it is in
    use it is locked; one that is not is what a killed build left, and removed.
    """
    homes = [target.parent]
    if target.exists():
        homes = [target] if _fixed_in_place(target) else [target.parent, target]
    handle = None
    try:
        for i, home in enumerate(homes):
            stage = home / f"{_STAGE}{os.getpid()}-{os.urandom(4).hex()}"
            try:
                with _locked(home):
                    _sweep(home)
                    stage.mkdir()
                    handle = _lock_folder(stage, wait=False)
                break
            except OSError:
                if i + 1 == len(homes):
                    raise
        yield stage
    finally:
        with uninterrupted():
            shutil.rmtree(stage, ignore_errors=True)
            if handle is not None:
                os.close(handle)


def _fixed_in_place(target: Path) -> bool:
    """A mount point, or where somebody stands: a shell must not find itself nowhere."""
    try:
        here = Path.cwd()
    except OSError:
        return os.path.ismount(target)
    return os.path.ismount(target) or here == target or target in here.parents


def _exchangeable(target: Path, stage: Path) -> bool:
    return stage.parent == target.parent and not _fixed_in_place(target)


def _fill(stage: Path, files: Mapping[str, bytes]) -> None:
    made = set()
    for path, data in files.items():
        parent = os.path.dirname(path)
        if parent not in made:
            (stage / parent).mkdir(parents=True, exist_ok=True)
            made.add(parent)
        with open(stage / path, "xb") as out:
            out.write(data)


def _sweep(home: Path) -> None:
    with contextlib.suppress(OSError):
        for entry in sorted(home.glob(f"{_STAGE}*")):
            handle = _lock_folder(entry, wait=False)
            if handle is not None:
                shutil.rmtree(entry, ignore_errors=True)
                os.close(handle)


# -- locks and signals ------------------------------------------------------------------------


def _lock_folder(folder: Path, *, wait: bool) -> int | None:
    """An advisory lock on a folder, held until the handle is closed; ``None``: not to be had."""
    try:
        import fcntl

        handle = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(handle)
        return None
    return handle


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """One build at a time; without a lock where the system has none."""
    handle = _lock_folder(folder, wait=True)
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


# -- the exchange ---------------------------------------------------------------------------------


def _exchange(a: Path, b: Path) -> bool:
    """Exchange two folders in one step; ``False`` where the system cannot."""
    import ctypes

    try:
        library = ctypes.CDLL(None, use_errno=True)
        first, second = os.fsencode(a), os.fsencode(b)
        if sys.platform == "darwin":
            return bool(library.renamex_np(first, second, 2) == 0)  # RENAME_SWAP
        at_cwd, exchange = -100, 2  # AT_FDCWD, RENAME_EXCHANGE
        return bool(library.renameat2(at_cwd, first, at_cwd, second, exchange) == 0)
    except (OSError, AttributeError, TypeError):
        return False


def _return_others(old: Path, target: Path, ours: dict[str, None] | None) -> None:
    """Bring back what somebody put into the old folder in the instant before the exchange."""
    for root, folders, names in os.walk(old):
        folders.sort()
        for name in sorted(names):
            path = (Path(root) / name).relative_to(old)
            if (ours is None or path.as_posix() not in ours) and not (target / path).exists():
                (target / path).parent.mkdir(parents=True, exist_ok=True)
                os.rename(old / path, target / path)


def _is_file(path: Path) -> bool:
    return os.path.lexists(path) and (path.is_symlink() or not path.is_dir())


def _move_in(
    stage: Path, target: Path, files: Mapping[str, bytes], ours: dict[str, None] | None
) -> None:
    """Move file by file; on a fault put everything back."""
    old = [path for path in ours or {} if path != MANIFEST and _is_file(target / path)]
    kept = stage / f"{_STAGE}old"
    head = json.loads(files[MANIFEST])
    head["complete"] = False
    # Until the end both builds' files count as ours, so that a build that is killed
    # here can be built over.
    head["files"] = dict.fromkeys([*old, *head["files"]], "")
    (stage / f"{_STAGE}manifest").write_text(json.dumps(head), encoding="utf-8")
    aside: list[str] = []
    moved: list[str] = []
    kept.mkdir()
    try:
        if ours is not None:
            os.rename(target / MANIFEST, kept / MANIFEST)
            aside.append(MANIFEST)
        os.rename(stage / f"{_STAGE}manifest", target / MANIFEST)
        for path in old:
            (kept / path).parent.mkdir(parents=True, exist_ok=True)
            os.rename(target / path, kept / path)
            aside.append(path)
        for path in files:
            if path != MANIFEST:
                (target / path).parent.mkdir(parents=True, exist_ok=True)
                os.rename(stage / path, target / path)
                moved.append(path)
        os.replace(stage / MANIFEST, target / MANIFEST)
    except BaseException:
        with contextlib.suppress(OSError):
            for path in reversed(moved):
                os.rename(target / path, stage / path)
            if ours is None:
                os.unlink(target / MANIFEST)
            for path in reversed(aside):
                os.replace(kept / path, target / path)
        raise
    finally:
        _remove_empty(target, [*old, *files])


def _remove_empty(target: Path, paths: list[str]) -> None:
    """Folders of ours in which nothing is left."""
    parents = {parent for path in paths for parent in PurePosixPath(path).parents}
    for parent in sorted(parents, key=lambda p: (-len(p.parts), str(p))):
        if parent.parts:
            with contextlib.suppress(OSError):
                os.rmdir(target / parent)
