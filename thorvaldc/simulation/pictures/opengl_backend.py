"""Drawing without a screen: by EGL, or by OSMesa where there is no EGL."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys

from thorvaldc.simulation.pictures import PictureError

VARIABLE = "MUJOCO_GL"
_PROBE = "import mujoco; mujoco.GLContext(8, 8).make_current()"
_MISSING = (
    "nothing here draws without a screen: neither EGL nor OSMesa works"
    " (on Debian and Ubuntu: apt install libegl1 libgl1-mesa-dri, or libosmesa6)"
)


def choose_opengl_backend() -> None:
    """Choose what MuJoCo draws by; best before anything imports MuJoCo, which looks once.

    What the user says in ``MUJOCO_GL`` stands.  On Linux EGL and then OSMesa are tried, in
    a process of their own: one that fails leaves its libraries behind.  Raises
    ``PictureError`` where neither works.
    """
    if sys.platform != "linux":
        return
    said = os.environ.get(VARIABLE, "")
    late = "mujoco" in sys.modules
    if late and said:
        return
    for name in [said] if said else ["egl", "osmesa"]:
        if _works(name):
            os.environ[VARIABLE] = name
            if late:
                _look_again()
            return
    if said:
        raise PictureError(f"MuJoCo cannot draw with {VARIABLE}={said}; leave it out, or mend it")
    raise PictureError(_MISSING)


def _look_again() -> None:
    """Let MuJoCo, which is imported already, see the variable."""
    for name in ("mujoco.rendering.classic.gl_context", "mujoco.gl_context"):
        module = sys.modules.get(name)
        if module is not None:
            importlib.reload(module)


def _works(name: str) -> bool:
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env={**os.environ, VARIABLE: name},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=60.0,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def check_pillow() -> None:
    """Raises ``PictureError`` where Pillow is missing."""
    try:
        import PIL.Image  # noqa: F401
    except ImportError:
        raise PictureError(
            "a picture needs Pillow, which is not installed: pip install 'thorvaldc[video]'"
        ) from None
