"""The OpenGL backend of MuJoCo for drawing without a display: EGL, or OSMesa."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys

from thorvaldc.simulation.pictures import PictureError

VARIABLE = "MUJOCO_GL"
_PROBE = "import mujoco; mujoco.GLContext(8, 8).make_current()"
_MISSING = (
    "cannot draw without a display: neither EGL nor OSMesa works"
    " (on Debian and Ubuntu: apt install libegl1 libgl1-mesa-dri, or libosmesa6)"
)


def choose_opengl_backend() -> None:
    """Sets ``MUJOCO_GL`` to a backend that works, best before MuJoCo is imported.

    A value that the user sets has priority.  On Linux the function tries EGL, then OSMesa, each
    in a process of its own, because a backend that fails leaves its libraries loaded.  Raises
    ``PictureError`` if no backend works.
    """
    if sys.platform != "linux":
        return
    user_choice = os.environ.get(VARIABLE, "")
    is_imported = "mujoco" in sys.modules
    if is_imported and user_choice:
        return
    for name in [user_choice] if user_choice else ["egl", "osmesa"]:
        if _works(name):
            os.environ[VARIABLE] = name
            if is_imported:
                _reload_mujoco_context()
            return
    if user_choice:
        raise PictureError(f"MuJoCo cannot draw with {VARIABLE}={user_choice}; unset or correct it")
    raise PictureError(_MISSING)


def _reload_mujoco_context() -> None:
    """Reloads the modules of MuJoCo that read the variable on import."""
    for name in ("mujoco.rendering.classic.gl_context", "mujoco.gl_context"):
        module = sys.modules.get(name)
        if module is not None:
            importlib.reload(module)


def _works(name: str) -> bool:
    try:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env={**os.environ, VARIABLE: name},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=60.0,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return probe.returncode == 0
