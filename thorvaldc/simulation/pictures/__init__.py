"""Plots, pictures and videos of robots and runs.

* ``plot`` draws paths and velocities with matplotlib.
* ``render`` draws the scene with MuJoCo and Pillow, without a display, also as a video.
* ``triangles`` computes the triangles of shapes, also for ``web_viewer``.
* ``surfaces`` has the triangles as arrays, and outlines of shapes.

Optional packages are imported on first use.  The message of a ``PictureError`` names the missing
package.
"""

from __future__ import annotations

from thorvaldc.diagnostics import OutsideError
from thorvaldc.diagnostics.installation import install_command


class PictureError(OutsideError):
    """A package or a graphics driver that pictures require is missing."""


def check_pillow() -> None:
    """Raises ``PictureError`` if Pillow is not installed."""
    try:
        import PIL.Image  # noqa: F401
    except ImportError:
        raise PictureError(
            f"a picture needs Pillow, which is not installed: {install_command('video')}"
        ) from None
