"""URDF files: the description of a robot for ROS.

MuJoCo's importer also reads the URDF files without loss.
"""

from __future__ import annotations

from thorvaldc.backends import Backend, xml_writer
from thorvaldc.backends.description_parts import NEGLIGIBLE, Palette, mesh_files
from thorvaldc.backends.ros2_control import kept_extensions, ros2_control_elements
from thorvaldc.model import Box, Cylinder, Inertial, Joint, Link, MeshShape, Pose, Robot, Shape
from thorvaldc.model.number_origins import derived
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.spatial import clean

# URDF requires limits for revolute and prismatic joints. The joint limit 1e9 means "no limit".
UNLIMITED = 1e9
MESHES = "../meshes"
"""Folder of the mesh files in a build, relative to the URDF file."""


class Urdf(Backend):
    name = "urdf"
    summary = "robot description for ROS 2 (urdf/robot.urdf) with its meshes"

    def emit(self, robot: Robot) -> dict[str, bytes]:
        files = {"urdf/robot.urdf": urdf_text(robot).encode()}
        files.update(mesh_files(robot))
        return files


@once_per_model
def urdf_text(
    robot: Robot, meshes: str = MESHES, hardware: str | None = None, share: str = ""
) -> str:
    """Return the URDF file of a robot as text. ROS nodes receive the text of the URDF file in a
    parameter.

    - ``meshes``: folder of the mesh files, such as ``package://my_robot/meshes``.
    - ``hardware``: kind of hardware of the ``<ros2_control>`` elements, a key of
      ``ros2_control.PLUGINS``, or ``None`` for a URDF without these elements of our own.
    - ``share``: shared folder of the ROS package, see ``ros2_control_elements``.

    """
    prefix = robot.prefix
    rename = _prefixing(robot, prefix) if prefix else None
    added = [xml_writer.parse(text, rename) for text in kept_extensions(robot, hardware)]
    if hardware is not None:
        added += ros2_control_elements(robot, hardware, share)
    # The quotation marks of texts are escaped, so that only the attributes of meshes match.
    text = _own_text(robot).replace(
        f'filename="{MESHES}/', f'filename="{xml_writer.escape(meshes)}/'
    )
    return xml_writer.add_to_root(text, "robot", added) if added else text


@once_per_model
def _own_text(robot: Robot) -> str:
    """Return the URDF file of a robot without the elements that depend on its hardware, with the
    mesh files in ``MESHES``."""
    prefix = robot.prefix
    root = xml_writer.Element("robot", name=robot.name)
    # By default, MuJoCo merges base_link into the world and discards the masses of all links that
    # are fixed to base_link, discards visual shapes, and computes masses from shapes.
    root.add("mujoco").add(
        "compiler",
        meshdir=MESHES,
        strippath=True,
        fusestatic=False,
        discardvisual=False,
        balanceinertia=False,
        inertiafromgeom="false",
    )
    palette = Palette(robot)
    for name, color in palette.entries():
        root.add("material", name=name).add("color", rgba=color)
    for link in robot.links:
        inertial = link.inertial
        # The root has no inertia, because robot_state_publisher (kdl_parser) warns of one there.
        if inertial is None and link is not robot.links[0]:
            inertial = NEGLIGIBLE
        _add_link(root, link, inertial, prefix, palette)
    for joint in robot.joints:
        _add_joint(root, joint, prefix)
    _add_gazebo(root, robot, prefix)
    return xml_writer.to_text(root)


# XML attributes and XML elements of the extra URDF elements that contain the name of a link or a
# joint. The XML tags in ``_NAMING_TEXTS`` are written in lower case and without underscores.
_NAMING_ATTRIBUTES = (("gazebo", "reference"), ("joint", "name"), ("link", "name"))
_NAMING_TEXTS = ("framename", "frameid", "gzframeid", "bodyname", "linkname", "jointname")


def _prefixing(robot: Robot, prefix: str) -> xml_writer.Rename:
    """Return a function that adds the name space of the robot to link and joint names in extra XML
    elements."""
    names = {link.name for link in robot.links} | {joint.name for joint in robot.joints}

    def rename(tag: str, attribute: str, value: str) -> str:
        naming = (
            (tag, attribute) in _NAMING_ATTRIBUTES
            if attribute
            else tag.lower().replace("_", "") in _NAMING_TEXTS
        )
        return prefix + value if naming and value in names else value

    return rename


def _add_origin(parent: xml_writer.Element, pose: Pose) -> None:
    x, y, z = pose.rpy()
    rpy = (clean(x), clean(y), clean(z))
    if pose.xyz != (0.0, 0.0, 0.0) or rpy != (0.0, 0.0, 0.0):
        parent.add("origin", xyz=pose.xyz, rpy=rpy)


def _add_geometry(parent: xml_writer.Element, shape: Shape) -> None:
    geometry = parent.add("geometry")
    match shape:
        case Box(size):
            geometry.add("box", size=size)
        case Cylinder(radius, length):
            geometry.add("cylinder", radius=radius, length=length)
        case MeshShape(mesh, scale):
            geometry.add(
                "mesh",
                filename=f"{MESHES}/{derived(mesh, scale)}",
                scale=None if scale == (1.0, 1.0, 1.0) else scale,
            )
        case _:
            geometry.add("sphere", radius=shape.radius)


def _add_link(
    root: xml_writer.Element, link: Link, inertial: Inertial | None, prefix: str, palette: Palette
) -> None:
    element = root.add("link", name=prefix + link.name)
    if inertial is not None:
        xx, yy, zz, xy, xz, yz = inertial.inertia
        part = element.add("inertial")
        if inertial.com != (0.0, 0.0, 0.0):
            part.add("origin", xyz=inertial.com, rpy=(0.0, 0.0, 0.0))
        part.add("mass", value=inertial.mass)
        part.add("inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)
    for visual in link.visuals:
        part = element.add("visual")
        _add_origin(part, visual.pose)
        _add_geometry(part, visual.shape)
        part.add("material", name=palette.name(visual.color))
    for collision in link.collisions:
        part = element.add("collision")
        _add_origin(part, collision.pose)
        _add_geometry(part, collision.shape)


def _add_joint(root: xml_writer.Element, joint: Joint, prefix: str) -> None:
    element = root.add("joint", name=prefix + joint.name, type=joint.type)
    _add_origin(element, joint.pose)
    element.add("parent", link=prefix + joint.parent)
    element.add("child", link=prefix + joint.child)
    if joint.type == "fixed":
        return
    element.add("axis", xyz=joint.axis)
    effort = UNLIMITED if joint.effort is None else joint.effort
    velocity = UNLIMITED if joint.velocity is None else joint.velocity
    if joint.type != "continuous":
        element.add(
            "limit",
            lower=-UNLIMITED if joint.lower is None else joint.lower,
            upper=UNLIMITED if joint.upper is None else joint.upper,
            effort=effort,
            velocity=velocity,
        )
    elif joint.effort is not None or joint.velocity is not None:
        element.add("limit", effort=effort, velocity=velocity)
    if joint.damping != 0.0 or joint.friction != 0.0:
        element.add("dynamics", damping=joint.damping, friction=joint.friction)
    if joint.mimic is not None:
        element.add(
            "mimic",
            joint=prefix + joint.mimic.joint,
            multiplier=joint.mimic.multiplier,
            offset=joint.mimic.offset,
        )


def _add_gazebo(root: xml_writer.Element, robot: Robot, prefix: str) -> None:
    """Add springs and tyre friction as Gazebo elements, because URDF has no elements for them."""
    for joint in robot.joints:
        if joint.stiffness != 0.0:
            root.add("gazebo", reference=prefix + joint.name).fill(
                springStiffness=joint.stiffness, springReference=joint.spring_reference
            )
    for wheel in robot.wheels:
        friction = wheel.friction
        root.add("gazebo", reference=prefix + wheel.link).fill(mu1=friction, mu2=friction)
