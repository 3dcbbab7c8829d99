"""Creates the web page of ``thorvaldc view --html`` from the template of the library."""

from __future__ import annotations

from thorvaldc.compiler.library import data_folder
from thorvaldc.model import Fleet, Robot
from thorvaldc.simulation.pictures.web_page import robot_page


def view_page(model: Robot | Fleet) -> str:
    """Returns an HTML document that shows the model of a robot or a fleet in 3D."""
    template = data_folder("templates") / "view" / "page.html"
    return robot_page(model, template.read_text(encoding="utf-8"))
