"""The web page of ``thorvaldc view --html``: one file with all data of the model.

``templates/view`` contains the page and its scripts.
"""

from __future__ import annotations

import json

from thorvaldc.model import Fleet, Robot
from thorvaldc.model.data_folder import data_folder
from thorvaldc.simulation.web_viewer.viewer_data import page_data

PLACEHOLDER = "/*DATA*/"
"""Placeholder in the template that the data of the model replaces."""
VIEWER = "/*VIEWER*/"
"""Placeholder in the templates that ``viewer_script()`` replaces."""
PANEL = "<!--PANEL-->"
"""Placeholder in the template for more sections beside the picture."""


def view_page(model: Robot | Fleet, before: Robot | Fleet | None = None, panel: str = "") -> str:
    """Returns an HTML document that shows the model of a robot or a fleet in 3D.

    The document also shows the model ``before``, as a translucent shape at the same place.
    ``panel`` is HTML beside the picture.  The model must contain the data of the meshes.
    """
    data = page_data(model)
    if before is not None:
        data["ghost"] = page_data(before)
    # The text `</script` inside the JSON data would end the script element.
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    template = (data_folder("templates") / "view" / "page.html").read_text(encoding="utf-8")
    page = template.replace(PANEL, panel, 1).replace(PLACEHOLDER, text)
    return page.replace(VIEWER, viewer_script(), 1)


def viewer_script() -> str:
    """Returns the JavaScript of the 3D scene and of the tables beside it, for the pages."""
    folder = data_folder("templates") / "view"
    scripts = (folder / name for name in ("viewer.js", "panel.js"))
    return "\n".join(script.read_text(encoding="utf-8") for script in scripts)
