"""MJCF files: a robot for MuJoCo, and a scene in which the robot stands at rest.

The file ``robot.xml`` contains only the robot and can be included in other models. The file
``scene.xml`` adds the ground, the light and the key frame ``home``.

The MuJoCo settings of contacts and servos are chosen for wheeled robots of 100 to 400 kg and time
steps of 1 to 5 ms. Reasons why a simulated robot slides, rolls and stands on slopes like a real
robot:

- The friction cones are elliptic.
- The first value of ``solimp`` is near zero.
- The drives hold their position at zero speed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from thorvaldc import model
from thorvaldc.backends import Backend, description_parts
from thorvaldc.backends.mjcf_robot import ModelSections, RobotWriter, set_shape
from thorvaldc.backends.xml_writer import Element, to_bytes
from thorvaldc.diagnostics import Diagnostic
from thorvaldc.model.spatial import clean
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.standing_pose import solve_statics

TERRAIN = "terrain.bin"
_DEPTH = 0.5  # m, thickness of a height field below its lowest point
_FILM = 0.001  # m, half the thickness of the visible plate of a level zone
_LAYER = 0.0005  # m, added for each further zone: where zones overlap, the last one is visible
_SLIPPERY = 0.3  # coefficient of friction below which a zone has the colour of ice


class Mjcf(Backend):
    """Backend of the target `mjcf`: writes ``robot.xml`` and ``scene.xml``.

    For a fleet, the backend also writes one MuJoCo scene with all robots.
    """

    name = "mjcf"
    summary = "MuJoCo model (mjcf/robot.xml) and scene (mjcf/scene.xml) with its meshes"

    def unsupported(self, robot: model.Robot) -> Iterable[Diagnostic]:
        return description_parts.urdf_only_elements(robot, "MJCF")

    def emit(self, robot: model.Robot) -> dict[str, bytes]:
        return {**_robot_and_scene(robot), **description_parts.mesh_files(robot)}

    def emit_fleet(self, fleet: model.Fleet) -> dict[str, bytes]:
        return super().emit_fleet(fleet) | _fleet_scene(fleet)


def simulation_files(fleet: model.Fleet) -> dict[str, bytes]:
    """Return the scene of a fleet without visual shapes, and the meshes of its collision shapes,
    by path.

    The physics is that of the target `mjcf`. A study or a batch of scenarios simulates thousands of
    fleets that nobody looks at, and MuJoCo would read all meshes before it discards them.
    """
    files = _fleet_scene(fleet, visuals=False)
    for placement in fleet.placements:
        robot = placement.robot
        shapes = [collision.shape for link in robot.links for collision in link.collisions]
        used = {f"meshes/{shape.mesh}" for shape in shapes if isinstance(shape, model.MeshShape)}
        for path, data in description_parts.mesh_files(robot).items():
            if path in used:
                files[f"{placement.name}/{path}"] = data
    return files


def _fleet_scene(fleet: model.Fleet, *, visuals: bool = True) -> dict[str, bytes]:
    robots = [placement.robot for placement in fleet.placements]
    poses = [placement.pose for placement in fleet.placements]
    folders = [f"../{placement.name}/meshes" for placement in fleet.placements]
    sections = ModelSections(fleet.name, robots, folders)
    for i, robot in enumerate(robots):
        RobotWriter(sections, robot, i, visuals=visuals).write(poses[i])
    scene = sections.root()
    _add_surroundings(scene, robots, poses, fleet.world)
    files = {} if fleet.world is None else _add_world(scene, fleet.world, poses)
    _add_home(scene, robots, poses)
    return files | {"mjcf/scene.xml": to_bytes(scene)}


def ros2_control_files(robot: model.Robot) -> dict[str, bytes]:
    """Return robot and scene for mujoco_ros2_control, by path; their meshes are in ``meshes/``.

    In these files, the drives are ``velocity`` servos. Older versions of this program take
    ``intvelocity`` for a position servo, and none limits its integrated set point, so that a
    blocked robot would push on after it was told to stop.
    """
    return _robot_and_scene(robot, velocity_servos=True)


def _robot_and_scene(robot: model.Robot, *, velocity_servos: bool = False) -> dict[str, bytes]:
    sections = ModelSections(robot.name, [robot], ["../meshes"])
    RobotWriter(sections, robot, 0, velocity_servos=velocity_servos).write(None)
    scene = Element("mujoco", model=f"{robot.name} scene")
    scene.add("include", file="robot.xml")
    _add_surroundings(scene, [robot], [model.Pose()])
    _add_home(scene, [robot], [model.Pose()], velocity_servos=velocity_servos)
    return {"mjcf/robot.xml": to_bytes(sections.root()), "mjcf/scene.xml": to_bytes(scene)}


# -- ground, sky, light and key frame --------------------------------------------------


def _reach(robots: Iterable[model.Robot], poses: Iterable[model.Pose]) -> tuple[model.Vec3, float]:
    """Return the centre of the robots, and the radius of a sphere around all their wheels, in m."""
    points = []
    for robot, pose in zip(robots, poses, strict=True):
        points.append(pose.apply(robot.inertial.com))
        points += [pose.apply((wheel.x, wheel.y, 0.0)) for wheel in robot.wheels]
    low = [min(p[i] for p in points) for i in range(3)]
    high = [max(p[i] for p in points) for i in range(3)]
    x, y, z = (clean((a + b) / 2) for a, b in zip(low, high, strict=True))
    return (x, y, z), max(1.0, round(math.dist(low, high) / 2, 3))


def _add_surroundings(
    scene: Element,
    robots: list[model.Robot],
    poses: list[model.Pose],
    world: model.World | None = None,
) -> None:
    """Add the ground, the sky, the light and the camera settings to a MuJoCo scene."""
    middle, reach = _reach(robots, poses)
    # In MuJoCo's viewer, the camera starts at a distance of 1.5 times ``extent`` from the centre of
    # the scene. The shadows in MuJoCo's viewer have a range of one ``extent``.
    scene.add("statistic", center=middle, extent=clean(2.0 * reach))
    visual = scene.add("visual")
    visual.add(
        "headlight",
        ambient=(0.35, 0.35, 0.36),
        diffuse=(0.25, 0.25, 0.25),
        specular=(0.1, 0.1, 0.1),
    )
    visual.add("global", azimuth=140, elevation=-20, offwidth=1920, offheight=1080)
    visual.add("quality", shadowsize=4096)
    visual.add("map", shadowclip=1.5, shadowscale=0.9)
    visual.add("rgba", haze=(0.9, 0.92, 0.94, 1))
    asset = scene.add("asset")
    asset.add(
        "texture",
        name="sky",
        type="skybox",
        builtin="gradient",
        rgb1=(0.72, 0.82, 0.92),
        rgb2=(0.9, 0.92, 0.94),
        width=256,
        height=1536,
    )
    asset.add(
        "texture",
        name="ground",
        type="2d",
        builtin="checker",
        mark="edge",
        rgb1=(0.78, 0.79, 0.75),
        rgb2=(0.74, 0.75, 0.71),
        markrgb=(0.66, 0.67, 0.63),
        width=512,
        height=512,
    )
    asset.add("material", name="ground", texture="ground", texuniform=True, texrepeat=(1, 1))
    body = scene.add("worldbody")
    direction = (-0.35, 0.3, -1.0)
    back = -2.5 * reach
    body.add(
        "light",
        name="sun",
        type="directional",
        pos=tuple(clean(m + back * d) for m, d in zip(middle, direction, strict=True)),
        dir=direction,
        diffuse=(0.6, 0.59, 0.56),
        specular=(0.2, 0.2, 0.2),
    )
    # The ground is level, because the standing pose of the robots is computed for level ground.
    # The ground is a MuJoCo plane and not a box, because wheels roll most smoothly on a plane.
    # Rough ground is above the plane.
    below = -world.ground.amplitude if world is not None else 0.0
    body.add(
        "geom",
        name="ground",
        type="plane",
        pos=(0, 0, below) if below else None,
        size=(0, 0, 1),
        material="ground",
    )


def _add_home(
    scene: Element,
    robots: Sequence[model.Robot],
    poses: Sequence[model.Pose],
    *,
    velocity_servos: bool = False,
) -> None:
    """Add the MuJoCo key frame ``home``, in which every robot stands still.

    In the key frame ``home``, every servo holds its joint at the position of the standing pose.
    ``velocity_servos`` is that of ``RobotWriter``: such servos have no state.
    """
    qpos: list[float] = []
    ctrl: list[float] = []
    act: list[float] = []
    for robot, pose in zip(robots, poses, strict=True):
        standing = solve_statics(robot)
        base = (pose * standing.base).clean()
        qpos += [*base.xyz, *base.quat]
        qpos += [standing.positions[joint.name] for joint in tree_of(robot).moving]
        for actuator in robot.actuators:
            position = standing.positions[actuator.joint]
            if actuator.role == "steering":
                ctrl.append(position)
            else:
                ctrl.append(0.0)
                act.append(position)
        for servo in robot.joint_servos:
            position = standing.positions[servo.joint]
            ctrl.append(position if servo.interface == "position" else 0.0)
            act += [position] if servo.interface == "velocity" else []
    key = scene.add("keyframe").add("key", name="home", qpos=tuple(qpos))
    has_state = act and not velocity_servos
    key.set(ctrl=tuple(ctrl) if ctrl else None, act=tuple(act) if has_state else None)


# -- the world of a scenario -----------------------------------------------------------
#
# The world frame of the MuJoCo scene is fixed to the ground. For a slope, the scene has level
# ground and an inclined gravity vector. The standing pose, the poses of the scenario and all
# distances are therefore measured in the plane of the slope.


def _add_world(
    scene: Element, world: model.World, starts: Sequence[model.Pose]
) -> dict[str, bytes]:
    """Add the world of a scenario to a MuJoCo scene, and return the height-field files by path.

    The MuJoCo scene must already contain the ground plane. ``starts`` lists the start poses of the
    robots. Rough ground is level around the start poses of the robots.
    """
    ground = world.ground
    if ground.angle:
        scene.add("option", gravity=description_parts.gravity_on(ground))
    body = scene.add("worldbody")
    for block in world.blocks:
        geom = body.add("geom", name=f"{block.kind}/{block.name}")
        set_shape(geom, block.shape)
        geom.set(
            pos=block.pose.xyz,
            quat=block.pose.quat,
            rgba=description_parts.BLOCK_COLORS[block.kind],
        )
    files = _add_zones(scene, body, world.zones)
    if ground.even:
        return files
    from thorvaldc.backends.mjcf_terrain import height_file, relief_of  # few builds need it

    relief = relief_of(ground, starts)
    (x, y), (edge_x, edge_y) = relief.center, relief.size
    size = (edge_x / 2, edge_y / 2, clean(relief.height), _DEPTH)
    scene.add("asset").add("hfield", name="terrain", file=TERRAIN, size=size)
    terrain = body.add("geom", name="ground/terrain", type="hfield", hfield="terrain")
    terrain.set(pos=(x, y, relief.low), material="ground")
    return {**files, f"mjcf/{TERRAIN}": height_file(relief.rows)}


def _add_zones(scene: Element, body: Element, zones: Sequence[model.Zone]) -> dict[str, bytes]:
    """Add a plate for each level zone and a height field for each other zone.

    Returns the contents of the height-field files by path. The MJCF files do not contain the
    friction of zones. During a simulation, the program changes the friction of the wheels in a zone
    instead.
    """
    files = {}
    for number, zone in enumerate(zones, 1):
        x, y = zone.size
        geom = body.add("geom", pos=zone.pose.xyz, quat=zone.pose.quat, rgba=zone_color(zone))
        if zone.level:
            # The plate of a level zone is only visible and has no contacts, because the ground
            # plane carries the robots.
            geom.set(
                name=f"zone/{number}", type="box", size=(x / 2, y / 2, _FILM + number * _LAYER)
            )
            geom.set(contype=0, conaffinity=0, group=2)
            continue
        from thorvaldc.backends.mjcf_terrain import height_file, relief

        rows, top = relief(zone)
        name = f"zone_{number}"
        files[f"mjcf/{name}.bin"] = height_file(rows)
        scene.add("asset").add(
            "hfield", name=name, file=f"{name}.bin", size=(x / 2, y / 2, clean(top), _DEPTH)
        )
        geom.set(name=f"ground/{name}", type="hfield", hfield=name)
    return files


def zone_color(zone: model.Zone) -> tuple[float, float, float, float]:
    """Return the colour of a zone: red, green, blue and opacity, each 0 to 1."""
    if zone.friction is not None and zone.friction < _SLIPPERY:
        return (0.75, 0.87, 0.95, 1.0)
    return (0.62, 0.58, 0.48, 1.0) if zone.level else (0.72, 0.7, 0.62, 1.0)
