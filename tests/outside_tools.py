"""The programs and libraries outside of Python that the tests use, with their Debian packages.

``python3 tests/outside_tools.py`` prints the Debian packages that are missing here.
``tests/conftest.py`` ends a test that starts a program that is not listed.
"""

from __future__ import annotations

import ctypes.util
import importlib.util
import os
import shutil
import sysconfig
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple


class Tool(NamedTuple):
    """An outside program or library, the Debian packages with it, and whether it is here."""

    name: str
    packages: str
    is_here: Callable[[], bool]


def _program(name: str, packages: str, *other_names: str) -> Tool:
    return Tool(name, packages, lambda: any(map(shutil.which, (name, *other_names))))


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
    _program("shellcheck", "shellcheck"),  # reads the generated shell script
    _program("chromium", "chromium", "google-chrome"),  # opens the generated web page
    _program("npm", "npm nodejs"),  # builds the viewer; installs axe-core
    _program("node", "nodejs"),  # runs the extension for VS Code
    Tool(  # draws pictures
        "EGL",
        "libegl1 libegl-mesa0 libgl1-mesa-dri",
        lambda: all(map(ctypes.util.find_library, ("EGL", "EGL_mesa"))),
    ),
)
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
ALWAYS_HERE = frozenset(["sh", "bash"])  # programs of every system


def path_of(name: str) -> str:
    """Returns the path of a program of the list; the test is skipped without it.

    Where ``CI`` is set, a missing program is an error.
    """
    (tool,) = (tool for tool in TOOLS if tool.name == name)
    if not tool.is_here():
        without(f"{name} is not installed (Debian: {tool.packages})")
    path = shutil.which(name) or shutil.which("google-chrome")
    assert path is not None
    return path


def path_of_dcfgen() -> str:
    """Returns the path of ``dcfgen``; the test is skipped without it, as in ``path_of``."""
    path = str(DCFGEN) if DCFGEN.exists() else shutil.which("dcfgen")
    if path is None:
        without("dcfgen is not installed (.ci/run shows how)")
    assert path is not None
    return path


def path_of_drake_python() -> str:
    """Returns the path of a Python with Drake, as ``path_of``."""
    if not DRAKE_PYTHON.exists():
        without("Drake is not installed (.ci/run shows how)")
    return str(DRAKE_PYTHON)


def path_of_dart_python() -> str:
    """Returns the path of a Python with DART, as ``path_of``."""
    if not DART_PYTHON.exists():
        without("DART is not installed (.ci/run shows how)")
    return str(DART_PYTHON)


def path_of_usd_python(*, converter: bool) -> str:
    """Returns the path of a Python with OpenUSD, with or without its converter, as ``path_of``."""
    python = USD_PYTHON if converter else USD_CORE_PYTHON
    if not python.exists():
        without("OpenUSD is not installed (.ci/run shows how)")
    return str(python)


def path_of_warp_python() -> str:
    """Returns the path of a Python with MuJoCo Warp and Newton, as ``path_of``."""
    if not WARP_PYTHON.exists():
        without("MuJoCo Warp is not installed (.ci/run shows how)")
    return str(WARP_PYTHON)


def without(reason: str) -> None:
    """Skips the test for a missing tool; where ``CI`` is set, the test fails."""
    import pytest

    if os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip(reason)


def is_listed(program: str) -> bool:
    """Whether tests may start a program: listed here, or of no folder of the system."""
    folder, name = os.path.split(program)
    outside = not folder or folder in ("/bin", "/sbin", "/usr/bin", "/usr/sbin")
    names = {tool.name for tool in TOOLS} | {"google-chrome"} | ALWAYS_HERE
    return not outside or name in names or name.startswith("python")


if __name__ == "__main__":
    print(*(tool.packages for tool in TOOLS if not tool.is_here()))
