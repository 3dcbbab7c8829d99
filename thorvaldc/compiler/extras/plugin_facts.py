"""What plug-ins of Gazebo, ``<ros2_control>`` and transmissions state about joints and wheels."""

from __future__ import annotations

from thorvaldc.compiler.descriptions.facts import Fact
from thorvaldc.compiler.extras.xacro_expand import Element

# Lengths of drive plug-ins, by their names without capitals and `_`: kind and factor to m.
_GEOMETRY = {
    "wheelradius": ("wheel radius", 1.0),
    "wheeldiameter": ("wheel radius", 0.5),
    "wheelseparation": ("wheel separation", 1.0),
    "wheelbase": ("wheelbase", 1.0),
}


def plugin_facts(element: Element) -> list[Fact]:
    """Returns the statements of all plug-ins in a ``<gazebo>`` or ``<model>`` element."""
    facts: list[Fact] = []
    reference = element.attributes.get("reference")
    if element.tag == "gazebo" and reference:
        facts.append(Fact("gazebo reference", "<gazebo>", reference, element.span))
    for plugin in walk(element):
        if plugin.tag == "plugin":
            facts += _facts_of(plugin)
    return facts


def _facts_of(plugin: Element) -> list[Fact]:
    name = plugin.attributes.get("name") or plugin.attributes.get("filename", "")
    subject = f"plug-in `{name}`"
    facts: list[Fact] = []
    values = [(child.tag.replace("_", "").lower(), child) for child in plugin.children]
    joints = [
        (key, child)
        for key, child in values
        if (key.endswith("joint") and ("left" in key or "right" in key)) or key == "jointname"
    ]
    wheels = [(key, child.text) for key, child in joints if "steering" not in key]
    left, right, front, back, rear = (
        tuple(joint for key, joint in wheels if side in key)
        for side in ("left", "right", "front", "back", "rear")
    )
    sides = {
        "wheel radius": (*left, *right),
        "wheel separation": (*left, "", *right),
        "wheelbase": (*front, "", *back, *rear),
    }
    facts += [Fact("joint", subject, child.text, child.span) for _, child in joints]
    for key, child in values:
        kind, factor = _GEOMETRY.get(key, ("", 0.0))
        length = numbers(child.text, 1)
        if key == "publishodomtf" and child.text in ("true", "1"):
            frames = [frame.text.strip("/") for name, frame in values if name == "odometryframe"]
            shown, names = f"{subject} ({child.tag})", tuple(frames or ["odom"])
            facts.append(Fact("plug-in transform", shown, True, child.span, "", names))
        elif kind and length is not None:
            facts.append(Fact(kind, subject, factor * length[0], child.span, "m", sides[kind]))
    return facts


def ros2_control_facts(element: Element) -> list[Fact]:
    """Returns the joints of a ``<ros2_control>`` element."""
    facts: list[Fact] = []
    subject = f'<ros2_control name="{element.attributes.get("name", "")}">'
    for child in element.children:
        if child.tag == "hardware":
            facts += [
                Fact("joint", subject, parameter.text, parameter.span)
                for parameter in child.children
                if parameter.attributes.get("name", "").endswith("wheel_name")
            ]
        elif child.tag == "joint":
            facts.append(Fact("joint", subject, child.attributes.get("name", ""), child.span))
    return facts


def numbers(text: str | None, count: int) -> tuple[float, ...] | None:
    """Returns the ``count`` numbers of a text, or ``None`` if it does not contain them."""
    if text is None:
        return None
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        return None
    return values if len(values) == count and all(abs(v) < 1e300 for v in values) else None


def walk(element: Element) -> list[Element]:
    """Returns an element and all elements in it, in the order of the file."""
    elements = [element]
    for child in element.children:
        elements += walk(child)
    return elements
