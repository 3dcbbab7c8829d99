"""Puts the files of a robot into their places on its computer, in one step that can be undone.

    /etc/thorvaldc/NAME/versions/1/robot/robot.yaml       the robot file, and what it names
    /etc/thorvaldc/NAME/versions/1/computer/systemd/...   files of the target `computer`
    /etc/thorvaldc/NAME/current -> versions/1             the installed version
    /etc/systemd/system/thorvaldc-NAME.service -> /etc/thorvaldc/NAME/current/computer/systemd/...

A new version is written beside the others.  Then the link ``current`` is replaced, which is the
only step that changes the computer: a process that is killed before or after it leaves one of the
two versions.  The other links lead through ``current``; a link that one of the two versions does
not have leads nowhere, which systemd and udev ignore.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from thorvaldc.backends.can.canmap import canmap_text
from thorvaldc.backends.computer import FOLDER, PLACES, STATE, name_on_computer
from thorvaldc.compiler.modules.fetched_library import cache_folder
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.compiler.source.readable_folders import is_below
from thorvaldc.diagnostics import OutsideError, Report
from thorvaldc.diagnostics.files import read_json, write_file
from thorvaldc.model import Robot

MOST_FILES, MOST_BYTES = 5_000, 500_000_000
"""Limits of the files beside a robot file that belong to it."""
WANTED_BY = "/etc/systemd/system/multi-user.target.wants"
CACHE = "cache/thorvaldc/libraries"
"""Folder of a version with the libraries of repositories, as ``XDG_CACHE_HOME`` leads to them."""
_SUMS = "installed.json"
_ROBOT = "robot"


def files_of(
    path: Path, sources: Mapping[str, Path], left_out: Path
) -> tuple[Path, dict[str, Path]]:
    """Returns the folder that contains a robot file with all that it names, and its files.

    The folder is that of the robot file, or the nearest one above it with the libraries and
    designs that the robot file names.  Hidden files, builds, and links that lead out of the folder
    are left out: root can read what the owner of the files cannot, and everybody can read the copy.

    - ``sources``: source files by the names in diagnostics; those of the built-in library begin
      with `<`.
    - ``left_out``: a folder that is no part of the robot.

    Raises ``OutsideError`` if the folder is too large.
    """
    own = [path, *(p for name, p in sources.items() if name[:1] not in ("<", "/"))]
    root = Path(os.path.commonpath([os.path.realpath(p.parent) for p in own]))
    files: dict[str, Path] = {}
    size = 0
    for folder, folders, names in os.walk(root):
        is_build = "manifest.json" in names and "model.json" in names
        if is_build or os.path.realpath(folder) == os.path.realpath(left_out):
            folders.clear()
            continue
        folders[:] = sorted(name for name in folders if name[0] != "." and name != "__pycache__")
        for name in sorted(names):
            file = Path(folder) / name
            if name[0] == "." or not file.is_file() or not is_below(file, [str(root)]):
                continue
            size += file.stat().st_size
            files[file.relative_to(root).as_posix()] = file
            if len(files) > MOST_FILES or size > MOST_BYTES:
                raise OutsideError(
                    f"the folder {root} has more than {MOST_FILES} files or "
                    f"{MOST_BYTES // 1_000_000} MB: put the robot file into a folder with its"
                    " modules and meshes alone"
                )
    return root, files


@dataclass(frozen=True)
class Version:
    """A version of a robot, as it is to be installed.

    - ``name``: name of the robot on its computer.
    - ``files``: content of each file by its path in the folder of the version.
    - ``robot_folder``: folder of the robot file below the folder of the files.
    """

    name: str
    files: dict[str, bytes]
    robot_folder: str

    @property
    def links(self) -> dict[str, str]:
        """The links of the computer into this version: targets by their paths."""
        links = {}
        for path in self.files:
            top, _, rest = path.partition("/")
            folder, _, name = rest.partition("/")
            if top == "computer" and folder in PLACES:
                links[f"{PLACES[folder]}/{name}"] = f"{FOLDER.format(name=self.name)}/{path}"
                if folder == "systemd":
                    links[f"{WANTED_BY}/{name}"] = links[f"{PLACES[folder]}/{name}"]
        return links


def version_of(robot: Robot, path: Path, sources: Mapping[str, Path], left_out: Path) -> Version:
    """Returns the version of a robot that a robot file describes.

    - ``sources``, ``left_out``: as for ``files_of``.

    Raises ``OutsideError`` if the robot has no files for a computer, or if the robot file does not
    describe the same robot without the files of other folders.
    """
    root, files = files_of(path, sources, left_out)
    content = {f"files/{name}": file.read_bytes() for name, file in files.items()}
    # The service reads the libraries of repositories from a cache of its own.
    cache = cache_folder()
    for source in sources.values():
        if cache in source.parents:
            library = cache / source.relative_to(cache).parts[0]
            for name, file in _walk(library):
                content[f"{CACHE}/{library.name}/{name}"] = file.read_bytes()
    targets = emit(robot, ["computer"], Report())
    content |= {name: data for name, data in targets.items() if name.startswith("computer/")}
    if not robot.buses:
        raise OutsideError(f"{robot.name} has no motor controllers: no service can drive it")
    folder = Path(os.path.realpath(path.parent)).relative_to(root).as_posix()
    version = Version(name_on_computer(robot), content, folder)
    with tempfile.TemporaryDirectory(prefix="thorvaldc-install-") as temporary:
        _write(version, Path(temporary))
        copy = compile_file(Path(temporary, "files", folder, path.name))
    if not isinstance(copy.model, Robot) or canmap_text(copy.model) != canmap_text(robot):
        reason = next((f" ({error.message})" for error in copy.report.errors), "")
        raise OutsideError(
            f"{path} does not compile to the same robot without files of other folders{reason}: put"
            f" what it names below {root}"
        )
    return version


@dataclass
class Computer:
    """The file system of a computer.

    - ``root``: folder of the file system, such as that of a mounted image.
    """

    root: Path

    def path(self, path: str) -> Path:
        """Returns where an absolute path of the computer is here."""
        return self.root / path.lstrip("/")

    def folder(self, name: str) -> Path:
        """Returns the folder of a robot."""
        return self.path(FOLDER.format(name=name)).parent

    def current(self, name: str) -> Path | None:
        """Returns the folder of the installed version of a robot, or ``None`` if there is none."""
        link = self.folder(name) / "current"
        return link.parent / os.readlink(link) if link.is_symlink() else None

    def units(self, name: str) -> dict[str, str]:
        """Returns the texts of the units of the installed version by their names."""
        current = self.current(name)
        paths = sorted(current.glob("computer/systemd/*.service")) if current is not None else ()
        return {path.name: path.read_text(encoding="utf-8") for path in paths}

    def edited(self, version: Path) -> list[str]:
        """Returns the files of an installed version that were changed or added on the computer."""
        try:
            sums = read_json((version / _SUMS).read_bytes())
        except (OSError, ValueError):
            return []
        return [
            name
            for name, file in _walk(version)
            if name != _SUMS and sums.get(name) != hashlib.sha256(file.read_bytes()).hexdigest()
        ]

    def links_of(self, name: str) -> list[str]:
        """Returns the paths of the links that lead into the versions of a robot."""
        start = FOLDER.format(name=name) + "/"
        return [
            f"{folder}/{path.name}"
            for folder in (*PLACES.values(), WANTED_BY)
            if self.path(folder).is_dir()
            for path in sorted(self.path(folder).iterdir())
            if path.is_symlink() and os.readlink(path).startswith(start)
        ]

    def plan(self, version: Version) -> list[str]:
        """Returns what an installation changes, a line for each change; nothing if it is installed.

        Raises ``OutsideError`` if a path is taken by another file.
        """
        for path, target in version.links.items():
            place = self.path(path)
            is_other = place.is_symlink() and os.readlink(place) != target
            if is_other or (place.exists() and not place.is_symlink()):
                raise OutsideError(f"{path} is there and was not made by thorvaldc install")
        before = self.links_of(version.name)
        lines, switch = [], []
        if not self._is_current(version):
            shown, new = FOLDER.format(name=version.name), self._new_version(version.name)
            count = len(version.files)
            lines = [f"write {count} files below {_parent(shown)}/versions/{new.name}"]
            switch = [f"link {shown} to versions/{new.name}"]
        lines += [f"link {path}" for path in version.links if path not in before]
        lines += switch
        return lines + [f"remove {path}" for path in before if path not in version.links]

    def install(self, version: Version) -> None:
        """Installs a version, for which ``plan`` has lines."""
        folder, new = self.folder(version.name), self._new_version(version.name)
        is_current = self._is_current(version)
        if not is_current:
            new.parent.mkdir(parents=True, exist_ok=True)
            temporary = Path(tempfile.mkdtemp(prefix=".new-", dir=new.parent))
            try:
                _write(version, temporary)
                write_file(temporary / _SUMS, json.dumps(_sums(version.files)))
                temporary.chmod(0o755)
                temporary.rename(new)
            except BaseException:
                shutil.rmtree(temporary, ignore_errors=True)
                raise
        before = self.links_of(version.name)
        for path, target in version.links.items():
            _link(self.path(path), target)
        if not is_current:
            _link(folder / "current", f"versions/{new.name}")
        for path in before:
            if path not in version.links:  # or the rest of a process that was killed
                self.path(path).unlink(missing_ok=True)

    def _is_current(self, version: Version) -> bool:
        current = self.current(version.name)
        return current is not None and _content(current) == version.files

    def uninstall(self, name: str) -> None:
        """Removes all that the installations of a robot have made."""
        # Without its link, the version is not installed any more, whatever is left of it.
        (self.folder(name) / "current").unlink(missing_ok=True)
        for path in self.links_of(name):
            self.path(path).unlink()
        for folder in (self.folder(name), self.path(STATE.format(name=name))):
            if folder.is_dir():
                shutil.rmtree(folder)
        for empty in (self.folder(name).parent, self.path(STATE.format(name=name)).parent):
            if empty.is_dir() and not any(empty.iterdir()):
                empty.rmdir()

    def _new_version(self, name: str) -> Path:
        versions = self.folder(name) / "versions"
        numbers = [int(p.name) for p in versions.glob("*") if p.name.isdecimal()]
        return versions / str(max(numbers, default=0) + 1)


def _parent(path: str) -> str:
    return str(PurePosixPath(path).parent)


def _write(version: Version, folder: Path) -> None:
    for name, data in version.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, data)
    (folder / _ROBOT).symlink_to(PurePosixPath("files", version.robot_folder))


def _link(path: Path, target: str) -> None:
    """Makes or replaces a link in one step."""
    if path.is_symlink() and os.readlink(path) == target:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.new")
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(target)
    temporary.replace(path)


def _walk(version: Path) -> Iterator[tuple[str, Path]]:
    for folder, _, names in os.walk(version):
        for name in names:
            path = Path(folder, name)
            if not path.is_symlink():
                yield path.relative_to(version).as_posix(), path


def _content(version: Path) -> dict[str, bytes]:
    return {name: path.read_bytes() for name, path in _walk(version) if name != _SUMS}


def _sums(files: Mapping[str, bytes]) -> dict[str, str]:
    return {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}


def installed_names(root: Path) -> Sequence[str]:
    """Returns the names of the robots that are installed on a computer."""
    folder = Computer(root).path(_parent(_parent(FOLDER.format(name="x"))))
    return sorted(p.name for p in folder.iterdir()) if folder.is_dir() else ()
