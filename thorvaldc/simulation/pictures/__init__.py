"""Pictures of robots and of their runs.

``plot`` draws paths and velocities (matplotlib), ``render`` and ``video`` show the scene
(MuJoCo off the screen, Pillow), ``page`` makes a web page to look at a robot.  What these need
is imported when it is used; ``PictureError`` says what is missing.
"""

from __future__ import annotations


class PictureError(Exception):
    """The machine lacks what a picture needs; the message is one line for the user."""
