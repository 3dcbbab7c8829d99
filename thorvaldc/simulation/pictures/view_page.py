"""Creates the web page of ``thorvaldc view --html`` from the template of the library."""

from __future__ import annotations

from thorvaldc.model import Fleet, Robot
from thorvaldc.model.data_folder import data_folder
from thorvaldc.simulation.pictures.web_page import robot_page

VIEWER = "/*VIEWER*/"
"""Placeholder in the templates that ``viewer_script()`` replaces."""
PANEL = "<!--PANEL-->"
"""Placeholder in the template for more sections beside the picture."""


def view_page(model: Robot | Fleet, before: Robot | Fleet | None = None, panel: str = "") -> str:
    """Returns an HTML document that shows the model of a robot or a fleet in 3D.

    The document also shows the model ``before``, as a translucent shape at the same place.
    ``panel`` is HTML beside the picture.
    """
    folder = data_folder("templates") / "view"
    template = (folder / "page.html").read_text(encoding="utf-8").replace(PANEL, panel, 1)
    return robot_page(model, template, before).replace(VIEWER, viewer_script(), 1)


def viewer_script() -> str:
    """Returns the JavaScript of the 3D scene and of the tables beside it, for the pages."""
    folder = data_folder("templates") / "view"
    scripts = (folder / name for name in ("viewer.js", "panel.js"))
    return "\n".join(script.read_text(encoding="utf-8") for script in scripts)
