"""Pictures of robots and of their runs.

``plot`` draws paths and velocities (matplotlib), ``render`` and ``video`` draw the scene
(MuJoCo without a display, Pillow), ``web_page`` writes a web page with the robot in 3D.  Optional
packages are imported on use; ``PictureError`` names the one that is missing.
"""

from __future__ import annotations


class PictureError(Exception):
    """A package or a driver for pictures is missing; the message is one line for the user."""


def check_pillow() -> None:
    """Raises ``PictureError`` if Pillow is not installed."""
    try:
        import PIL.Image  # noqa: F401
    except ImportError:
        raise PictureError(
            "a picture needs Pillow, which is not installed: pip install 'thorvaldc[video]'"
        ) from None
