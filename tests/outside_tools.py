"""The programs and libraries outside of Python that the tests use, with their Debian packages.

``python3 tests/outside_tools.py`` prints the Debian packages that are missing here.
``tests/outside_use.py`` ends a test that starts a program that is not listed, and skips a test that
starts a program that is missing.

With ``OUTSIDE=none``, tests and the processes that they start find none of the tools: a test that
needs one is skipped, also where ``CI`` is set.
"""

from __future__ import annotations

import atexit
import ctypes.util
import importlib.util
import os
import shutil
import sysconfig
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

HIDDEN = os.environ.get("OUTSIDE") == "none"


class Tool(NamedTuple):
    """An outside program or library, the Debian packages with it, and a search for it."""

    name: str
    packages: str
    search: Callable[[], bool]

    def is_here(self) -> bool:
        return not HIDDEN and self.search()


def _program(name: str, packages: str, *other_names: str) -> Tool:
    return Tool(name, packages, lambda: any(map(shutil.which, (name, *other_names))))


JOURNAL_REMOTE = Path("/lib/systemd/systemd-journal-remote")
SSHD = Path("/usr/sbin/sshd")
IGNITION = Path("/usr/lib/ruby/ignition")
TOOLS = (
    _program("make", "make"),
    _program("git", "git"),  # `diff` reads revisions
    Tool(
        "venv",
        "python3-venv",
        lambda: all(map(importlib.util.find_spec, ("venv", "ensurepip"))),
    ),
    _program("cc", "gcc libc6-dev"),  # compiles the generated header
    Tool(  # build the message packages that the wheels of ROS 2 do not contain
        "cmake",
        "cmake ninja-build g++ python3-dev",
        lambda: (
            all(map(shutil.which, ("cmake", "ninja", "g++")))
            and (Path(sysconfig.get_paths()["include"]) / "Python.h").exists()
        ),
    ),
    _program("check_urdf", "liburdfdom-tools"),  # reads URDF
    Tool(  # reads URDF and SDF
        "ign",
        "ignition-tools libsdformat-dev",
        lambda: bool(shutil.which("ign")) and any(IGNITION.glob("cmdsdformat*.rb")),
    ),
    _program("bash", "bash"),  # completes commands
    _program("systemd-analyze", "systemd"),  # reads the generated units
    _program("systemd-nspawn", "systemd-container"),  # starts the installed service
    Tool(  # writes a journal, and reads it
        "journalctl",
        "systemd systemd-journal-remote",
        lambda: bool(shutil.which("journalctl")) and JOURNAL_REMOTE.exists(),
    ),
    Tool(  # reaches the computer of a robot
        "ssh-keygen",
        "openssh-client openssh-server",
        lambda: all(map(shutil.which, ("ssh", "ssh-keygen"))) and SSHD.exists(),
    ),
    _program("shellcheck", "shellcheck"),  # reads the generated shell script
    _program("chromium", "chromium", "google-chrome"),  # opens the generated web page
    _program("npm", "npm nodejs"),  # builds the viewer; installs axe-core
    _program("node", "nodejs"),  # runs the extension for VS Code
    Tool(  # draws pictures
        "OpenGL",
        "libosmesa6",
        lambda: (
            bool(ctypes.util.find_library("OSMesa"))
            or all(map(ctypes.util.find_library, ("EGL", "EGL_mesa", "GL")))
        ),
    ),
)
OPENGL_LIBRARIES = ("EGL", "GL", "GLX", "OSMesa", "OpenGL")
ENVIRONMENTS = Path(__file__).parents[1] / ".venv"
DCFGEN = ENVIRONMENTS / "dcfgen/bin/dcfgen"
"""Reads the configuration of ros2_canopen; a Python program with old dependencies.  ``.ci/run``
installs it in an environment of its own."""
DRAKE_PYTHON = ENVIRONMENTS / "drake/bin/python"
"""The Python of an environment with Drake, which reads URDF; made by ``.ci/run``."""
DART_PYTHON = ENVIRONMENTS / "dart/bin/python"
"""The Python of an environment with DART, the physics engine of Gazebo; made by ``.ci/run``."""
USD_PYTHON = ENVIRONMENTS / "usd/bin/python"
"""The Python of an environment with the converter to OpenUSD; made by ``.ci/run``."""
USD_CORE_PYTHON = ENVIRONMENTS / "usdcore/bin/python"
"""The Python of an environment with OpenUSD alone; made by ``.ci/run``."""
WARP_PYTHON = ENVIRONMENTS / "warp/bin/python"
"""The Python of an environment with MuJoCo Warp and Newton; made by ``.ci/run``."""
# Programs of every system; tests do without `chrt` where it is missing or not permitted.
ALWAYS_HERE = frozenset(["sh", "bash", "chrt"])
PLAIN_PROGRAMS = ("sh", "env", "cat", "false", "kill", "ls", "sleep", "stty", "true")
"""What the tests find in ``PATH`` with ``OUTSIDE=none``."""
SYSTEM_FOLDERS = ("", "/bin", "/sbin", "/usr/bin", "/usr/sbin")

used: set[str] = set()
"""The tools that the test has used or looked for, for ``tests/outside_use.py``."""


def require(name: str) -> None:
    """Skips the test without a program or library of the list.

    Where ``CI`` is set, a missing one is an error.
    """
    (tool,) = (tool for tool in TOOLS if tool.name == name)
    used.add(name)
    if not tool.is_here():
        without(f"{name} is not installed (Debian: {tool.packages})")


def path_of(name: str) -> str:
    """Returns the path of a program of the list; the test is skipped without it, as ``require``."""
    require(name)
    path = shutil.which(name) or shutil.which("google-chrome")
    assert path is not None
    return path


def path_of_dcfgen() -> str:
    """Returns the path of ``dcfgen``; the test is skipped without it, as ``require``."""
    if not DCFGEN.exists() and (path := shutil.which("dcfgen")):
        return path
    return path_in_environment(DCFGEN, "dcfgen is not installed (.ci/run shows how)")


def path_of_drake_python() -> str:
    """Returns the path of a Python with Drake, as ``path_in_environment``."""
    return path_in_environment(DRAKE_PYTHON, "Drake is not installed (.ci/run shows how)")


def path_of_dart_python() -> str:
    """Returns the path of a Python with DART, as ``path_in_environment``."""
    return path_in_environment(DART_PYTHON, "DART is not installed (.ci/run shows how)")


def path_of_usd_python(*, converter: bool) -> str:
    """Returns the path of a Python with OpenUSD, with or without its converter, as
    ``path_in_environment``."""
    python = USD_PYTHON if converter else USD_CORE_PYTHON
    return path_in_environment(python, "OpenUSD is not installed (.ci/run shows how)")


def path_of_warp_python() -> str:
    """Returns the path of a Python with MuJoCo Warp and Newton, as ``path_in_environment``."""
    return path_in_environment(WARP_PYTHON, "MuJoCo Warp is not installed (.ci/run shows how)")


def path_in_environment(program: Path, reason: str) -> str:
    """Returns the path of a program of an environment of its own.

    Without it, the test is skipped with the reason; where ``CI`` is set, that is an error.
    """
    used.add(str(program))
    if HIDDEN or not program.exists():
        without(reason)
    return str(program)


def without(reason: str) -> None:
    """Skips the test for a missing tool; where ``CI`` is set, the test fails."""
    import pytest

    used.add(reason)
    if os.environ.get("CI") and not HIDDEN:
        pytest.fail(reason)
    pytest.skip(reason)


def listed_name(program: str) -> str:
    """Returns the name in the list of a program that a test starts, or an empty text.

    Raises ``AssertionError`` for a program of the system that is not listed.
    """
    folder, name = os.path.split(program)
    if folder not in SYSTEM_FOLDERS:
        return ""
    name = "chromium" if name == "google-chrome" else name
    if name in {tool.name for tool in TOOLS}:
        return name
    known = name in ALWAYS_HERE or name.startswith("python")
    assert known, f"{program} is not listed in tests/outside_tools.py"
    return ""


def hide() -> None:
    """Hides the tools from this process and from those that it starts.

    ``PATH`` has the plain programs alone.  The first file with each name of an OpenGL library that
    the loader finds is empty, as if there was none.
    """
    folder = Path(tempfile.mkdtemp(prefix="thorvaldc-outside-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for name in PLAIN_PROGRAMS:
        if path := shutil.which(name):
            (folder / name).symlink_to(path)
    for library in OPENGL_LIBRARIES:
        for version in ("", *(f".{number}" for number in range(10))):
            (folder / f"lib{library}.so{version}").touch()
    os.environ["PATH"] = str(folder)
    libraries = filter(None, (str(folder), os.environ.get("LD_LIBRARY_PATH")))
    os.environ["LD_LIBRARY_PATH"] = os.pathsep.join(libraries)
    os.environ.pop("MUJOCO_GL", None)


if __name__ == "__main__":
    print(*(tool.packages for tool in TOOLS if not tool.is_here()))
