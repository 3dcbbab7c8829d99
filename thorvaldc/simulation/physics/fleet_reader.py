"""Reads the MJCF scene of a large fleet in groups of robots.

The time in which MuJoCo reads bodies grows with the square of their number, and the time in which
it fuses bodies that are fixed to each other grows even faster.  Groups that are read and fused
alone, and then joined, give the same model to the last bit.
"""

from __future__ import annotations

import warnings
from typing import Any

ROBOTS = 20
"""Largest number of robots that are read at once."""


def read_fleet(text: bytes) -> Any:
    """Returns the ``MjModel`` of a scene without visual geoms, and with fused bodies.

    Returns ``None`` if the scene has at most ``ROBOTS`` robots, if its physics needs other files
    (meshes, a height field), or if it declares entities, which MuJoCo does not expand.
    """
    if text.count(b"<freejoint") <= ROBOTS or b"<!" in text.replace(b"<!--", b""):
        return None
    from xml.etree.ElementTree import Element, SubElement, fromstring, tostring

    import mujoco

    scene = fromstring(text)
    robots = []
    for world in scene.findall("worldbody"):
        for body in world.findall("body[freejoint]"):
            world.remove(body)
            robots.append(body)
    for body in [body for robot in robots for body in robot.iter("body")]:
        for geom in body.findall("geom[@class='visual']"):
            body.remove(geom)
    meshes = {geom.get("mesh") for robot in robots for geom in robot.iter("geom")}
    for assets in scene.findall("asset"):
        for mesh in assets.findall("mesh"):
            if mesh.get("name") not in meshes:
                assets.remove(mesh)
    if scene.find(".//*[@file]") is not None or scene.find("worldbody/body") is not None:
        return None
    settings = [part for part in scene if part.tag in ("compiler", "option", "default", "asset")]
    whole = mujoco.MjSpec.from_string(tostring(scene, "unicode"))
    with warnings.catch_warnings():
        # A prefix is not needed: the names of the robots differ.
        warnings.filterwarnings("ignore", "Attaching a spec with an empty prefix")
        for first in range(0, len(robots), ROBOTS):
            root = Element("mujoco")
            root.extend(settings)
            SubElement(root, "worldbody").extend(robots[first : first + ROBOTS])
            group = mujoco.MjSpec.from_string(tostring(root, "unicode"))
            frame = group.worldbody.add_frame()
            for body in group.worldbody.bodies:
                body.set_frame(frame)
            group.compiler.discardvisual = group.compiler.fusestatic = True
            group.compile()
            whole.worldbody.attach_frame(frame, "", "")
        whole.compiler.discardvisual = True
        return whole.compile()
