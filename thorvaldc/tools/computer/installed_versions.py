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

from thorvaldc.backends.computer import (
    FOLDER,
    MODEL,
    PLACES,
    STATE,
    computer_files,
    name_on_computer,
)
from thorvaldc.diagnostics import OutsideError
from thorvaldc.diagnostics.files import read_json, write_file
from thorvaldc.model import Robot

WANTED_BY = "/etc/systemd/system/multi-user.target.wants"
CACHE = "cache/thorvaldc/libraries"
"""Folder of a version with the libraries of repositories, as ``XDG_CACHE_HOME`` leads to them."""
_SUMS = "installed.json"
_ROBOT = "robot"


@dataclass(frozen=True)
class Version:
    """A version of a robot, as it is to be installed.

    - ``name``: name of the robot on its computer.
    - ``files``: content of each file by its path in the folder of the version.
    - ``robot_folder``: folder of the robot file below the folder of the files.
    - ``robot_file``: name of the robot file or model in this folder.
    """

    name: str
    files: dict[str, bytes]
    robot_folder: str
    robot_file: str

    @property
    def units(self) -> list[str]:
        """Names of the units of systemd."""
        folder = PurePosixPath("computer/systemd")
        paths = map(PurePosixPath, sorted(self.files))
        return [path.name for path in paths if path.parent == folder]

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


def version_of_model(robot: Robot, path: Path) -> Version:
    """Returns the version of a robot whose service drives the model in a file, without a compiler.

    Raises ``OutsideError`` if the robot has no files for a computer.
    """
    return version_with(robot, {f"files/{MODEL}": path.read_bytes()}, ".", MODEL)


def version_with(robot: Robot, files: dict[str, bytes], folder: str, name: str) -> Version:
    """Returns the version of a robot with files and the files of the target `computer`.

    - ``folder``, ``name``: folder below that of the files, and name of the robot file.

    Raises ``OutsideError`` if the robot has no files for a computer.
    """
    if not robot.buses:
        raise OutsideError(f"{robot.name} has no motor controllers: no service can drive it")
    if robot.computer is None:
        raise OutsideError("this model has no `computer`: build its robot file again")
    return Version(name_on_computer(robot), {**files, **computer_files(robot, name)}, folder, name)


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
            for name, file in files_below(version)
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
                write_version(version, temporary)
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


def write_version(version: Version, folder: Path) -> None:
    """Writes the files of a version to an empty folder."""
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


def files_below(root: Path) -> Iterator[tuple[str, Path]]:
    """Yields the files in a folder with their paths below it, without links."""
    for folder, _, names in os.walk(root):
        for name in names:
            path = Path(folder, name)
            if not path.is_symlink():
                yield path.relative_to(root).as_posix(), path


def _content(version: Path) -> dict[str, bytes]:
    return {name: path.read_bytes() for name, path in files_below(version) if name != _SUMS}


def _sums(files: Mapping[str, bytes]) -> dict[str, str]:
    return {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}


def installed_names(root: Path) -> Sequence[str]:
    """Returns the names of the robots that are installed on a computer."""
    folder = Computer(root).path(_parent(_parent(FOLDER.format(name="x"))))
    return sorted(p.name for p in folder.iterdir()) if folder.is_dir() else ()
