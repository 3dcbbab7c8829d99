"""Selects the OpenGL backend, EGL or OSMesa, with which MuJoCo draws without a display."""

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
    """Sets the environment variable ``MUJOCO_GL`` to an OpenGL backend that works.

    Call the function before MuJoCo is imported, if possible.  The function does not change a value
    that the user sets.  On Linux the function tries EGL first, then OSMesa.  Each backend is tried
    in a separate process, because the libraries of a backend stay loaded after a failure.  Raises
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
    """Reloads the MuJoCo modules that read ``MUJOCO_GL`` on import."""
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
