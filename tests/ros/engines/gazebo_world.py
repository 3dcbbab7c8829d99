"""Robots in a world, as Gazebo simulates them: the systems of the SDF files over a physics engine.

This program stands for Gazebo, which cannot run in the tests.  It reads the generated SDF files
with a plain XML reader, and does what the systems of gz-sim 8 to 10 do; the rules were compared
with their sources (``src/systems`` of gz-sim 8.14, 9 and 10 in July 2026).
It imports nothing of thorvaldc, and refuses plug-ins and elements that it does not know.  DART is
the physics engine of Gazebo, and builds the robot from the SDF; MuJoCo steps the MJCF files of the
same build.

It runs as a child process: one line of JSON in (commands by topic, and the time to simulate), one
line out (time in ns, joint states and true motion of each robot).
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, parse

Command = dict[str, float]
SYSTEM = "gz::sim::systems::"
KNOWN = {
    "JointController": {"joint_name", "topic"},
    "JointPositionController": {
        *("joint_name", "topic", "use_velocity_commands", "cmd_max", "cmd_min"),
        *("initial_position",),
    },
    "JointStatePublisher": {"topic", "update_rate", "joint_name"},
    "OdometryPublisher": {
        *("odom_frame", "robot_base_frame", "odom_topic", "odom_publish_frequency", "dimensions"),
    },
}
"""Elements that each system reads."""


class WorldError(Exception):
    """The files ask for something that Gazebo does not have; the message is one line."""


def text_of(element: Element, name: str, default: str = "") -> str:
    return (element.findtext(name) or default).strip()


class Robot:
    """The systems of one model.

    ``velocity`` and ``position`` map topics to the joints of both kinds of controllers; ``limits``
    has the greatest speed (rad/s) of a joint with a position controller, in both directions.
    """

    def __init__(self, package: Path) -> None:
        model = parse(package / "sdf" / "model.sdf").getroot().find("model")
        if model is None:
            raise WorldError("sdf/model.sdf has no model")
        self.model = model
        joints = [str(joint.get("name")) for joint in model.iter("joint")]
        self.velocity: dict[str, str] = {}
        self.position: dict[str, str] = {}
        self.limits: dict[str, float] = {}
        self.targets: dict[str, float] = {}
        self.speeds: dict[str, float] = {}
        self.state_topic = self.odometry_topic = ""
        self.rate = 0.0
        self.published: list[str] = []
        for plugin in model.findall("plugin"):
            name = str(plugin.get("name")).removeprefix(SYSTEM)
            if name not in KNOWN:
                raise WorldError(f"no system {plugin.get('name')}")
            unknown = {child.tag for child in plugin} - KNOWN[name]
            if unknown:
                raise WorldError(f"{name} reads no {', '.join(sorted(unknown))}")
            named = [str(child.text) for child in plugin.findall("joint_name")]
            missing = sorted(set(named) - set(joints))
            if missing:
                raise WorldError(f"{name}: no joint {', '.join(missing)}")
            getattr(self, f"_add_{name}")(plugin, sorted(named, key=joints.index))

    def _add_JointController(self, plugin: Element, joints: list[str]) -> None:
        self.velocity[text_of(plugin, "topic")] = joints[0]
        self.speeds[joints[0]] = 0.0

    def _add_JointPositionController(self, plugin: Element, joints: list[str]) -> None:
        if text_of(plugin, "use_velocity_commands") != "true":
            raise WorldError("only velocity commands of JointPositionController are simulated")
        (joint,) = joints
        self.position[text_of(plugin, "topic")] = joint
        # With velocity commands, `cmd_min` is not read, and only a stated `cmd_max` limits.
        self.limits[joint] = float(text_of(plugin, "cmd_max", "inf"))
        self.targets[joint] = float(text_of(plugin, "initial_position", "0"))

    def _add_JointStatePublisher(self, plugin: Element, joints: list[str]) -> None:
        self.state_topic = text_of(plugin, "topic")
        self.rate = float(text_of(plugin, "update_rate", "0"))
        self.published = joints

    def _add_OdometryPublisher(self, plugin: Element, joints: list[str]) -> None:
        self.odometry_topic = text_of(plugin, "odom_topic")

    def take(self, topic: str, value: float) -> bool:
        """Takes a command; returns whether the topic is one of this robot."""
        if topic in self.velocity:
            self.speeds[self.velocity[topic]] = value
        elif topic in self.position:
            self.targets[self.position[topic]] = value
        return topic in self.velocity or topic in self.position

    def joint_speeds(self, positions: dict[str, float], step: float) -> dict[str, float]:
        """Returns the commanded speed of each driven joint, in rad/s."""
        speeds = dict(self.speeds)
        for joint, target in self.targets.items():
            top, error = self.limits[joint], positions[joint] - target
            # Within reach of one step the joint stops at the target; else it has its top speed.
            if abs(error) > top * step:
                speeds[joint] = top if error < 0.0 else -top
            else:
                speeds[joint] = -error / step
        return speeds


# -- physics ---------------------------------------------------------------------------------------


class MujocoPhysics:
    """Steps the MJCF scene of the build, whose joints have the names of the SDF."""

    def __init__(self, robots: list[Robot], scene: str, places: list[list[float]]) -> None:
        import mujoco

        self.mujoco = mujoco
        self.steered = {joint: robot for robot in robots for joint in robot.targets}
        self.model = mujoco.MjModel.from_xml_path(scene)
        self.data = mujoco.MjData(self.model)
        if self.model.nkey:
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        mujoco.mj_forward(self.model, self.data)
        self.step_time = self.model.opt.timestep
        self.actuators = {
            self.model.joint(self.model.actuator_trnid[i][0]).name: i for i in range(self.model.nu)
        }
        self.joints = {
            name: self.model.joint(name)
            for robot in robots
            for name in {*robot.published, *robot.speeds, *robot.targets}
        }
        self.roots = [str(robot.model.get("canonical_link")) for robot in robots]

    def positions(self) -> dict[str, float]:
        return {name: float(self.data.qpos[j.qposadr[0]]) for name, j in self.joints.items()}

    def velocities(self) -> dict[str, float]:
        return {name: float(self.data.qvel[j.dofadr[0]]) for name, j in self.joints.items()}

    def step(self, speeds: dict[str, float]) -> None:
        for joint, speed in speeds.items():
            actuator = self.actuators[joint]
            owner = self.steered.get(joint)
            if owner is not None:  # the set point of a position servo moves as the joint may
                most = owner.limits[joint] * self.step_time
                change = owner.targets[joint] - self.data.ctrl[actuator]
                self.data.ctrl[actuator] += min(max(change, -most), most)
            else:
                self.data.ctrl[actuator] = speed
        self.mujoco.mj_step(self.model, self.data)

    def motion(self, robot: int) -> tuple[list[float], list[float]]:
        """Returns the place (x, y, yaw) and the velocity (vx, vy, yaw rate) in the body."""
        body = self.data.body(self.roots[robot])
        matrix = body.xmat.reshape(3, 3)
        yaw = math.atan2(matrix[1, 0], matrix[0, 0])
        joint = self.model.body(self.roots[robot]).dofadr[0]
        velocity, rate = self.data.qvel[joint : joint + 3], float(self.data.qvel[joint + 5])
        c, s = math.cos(yaw), math.sin(yaw)
        vx, vy = float(velocity[0]), float(velocity[1])
        return (
            [float(body.xpos[0]), float(body.xpos[1]), yaw],
            [c * vx + s * vy, c * vy - s * vx, rate],
        )


class DartPhysics:
    """Builds the robots from their SDF files in DART, with the collisions of ODE as in Gazebo."""

    def __init__(self, robots: list[Robot], world_file: str, places: list[list[float]]) -> None:
        import dartpy

        self.dart = dartpy
        self.world = dartpy.simulation.World()
        world = parse(world_file).getroot().find("world")
        if world is None:
            raise WorldError(f"{world_file} has no world")
        self.step_time = float(text_of(world, "physics/max_step_size"))
        self.world.setTimeStep(self.step_time)
        self.world.setGravity([float(x) for x in text_of(world, "gravity").split()])
        detector = dartpy.collision.OdeCollisionDetector()
        self.world.getConstraintSolver().setCollisionDetector(detector)
        self.world.addSkeleton(self._ground())
        self.skeletons = [
            self._skeleton(robot.model, place) for robot, place in zip(robots, places, strict=True)
        ]
        self.joints: dict[str, Any] = {}
        for robot, skeleton in zip(robots, self.skeletons, strict=True):
            self.world.addSkeleton(skeleton)
            for name in {*robot.published, *robot.speeds, *robot.targets}:
                self.joints[name] = skeleton.getJoint(name)
            for name in {*robot.speeds, *robot.targets}:
                # gz-physics gives a joint with velocity commands a servo of limited force.
                self.joints[name].setActuatorType(dartpy.dynamics.ActuatorType.SERVO)
        self.roots = [
            skeleton.getBodyNode(str(robot.model.get("canonical_link")))
            for robot, skeleton in zip(robots, self.skeletons, strict=True)
        ]

    def _ground(self) -> Any:
        dart = self.dart
        skeleton = dart.dynamics.Skeleton("ground")
        _, body = skeleton.createWeldJointAndBodyNodePair()
        shape = body.createShapeNode(dart.dynamics.BoxShape([200.0, 200.0, 1.0]))
        shape.createCollisionAspect()
        shape.createDynamicsAspect().setFrictionCoeff(1.0)
        shape.setRelativeTranslation([0.0, 0.0, -0.5])
        return skeleton

    def _skeleton(self, model: Element, place: list[float]) -> Any:
        dart = self.dart
        skeleton = dart.dynamics.Skeleton(str(model.get("name")))
        joints = {text_of(joint, "child"): joint for joint in model.findall("joint")}
        bodies: dict[str, Any] = {}
        for link in model.findall("link"):  # parents come first
            name = str(link.get("name"))
            joint = joints.get(name)
            if joint is None:
                created, body = skeleton.createFreeJointAndBodyNodePair()
                start = self._transform(f"{place[0]} {place[1]} 0 0 0 {place[2]}")
                created.setTransformFromParentBodyNode(start)
            else:
                created, body = self._joined(skeleton, joint, bodies[text_of(joint, "parent")])
                created.setTransformFromParentBodyNode(self._transform(text_of(link, "pose")))
            created.setName(str(joint.get("name")) if joint is not None else "root")
            body.setName(name)
            bodies[name] = body
            self._fill(body, link)
        skeleton.disableSelfCollisionCheck()
        return skeleton

    def _joined(self, skeleton: Any, joint: Element, parent: Any) -> tuple[Any, Any]:
        axis = joint.find("axis")
        assert axis is not None
        direction = [float(x) for x in text_of(axis, "xyz").split()]
        if joint.get("type") == "prismatic":
            made = skeleton.createPrismaticJointAndBodyNodePair(parent)
        else:
            made = skeleton.createRevoluteJointAndBodyNodePair(parent)
        created = made[0]
        created.setAxis(direction)
        limit, dynamics = axis.find("limit"), axis.find("dynamics")
        if limit is not None:
            low, high = float(text_of(limit, "lower")), float(text_of(limit, "upper"))
            if high < 1e15:
                created.setPositionLowerLimit(0, low)
                created.setPositionUpperLimit(0, high)
                created.setLimitEnforcement(True)
            effort = float(text_of(limit, "effort", "inf"))
            created.setForceLowerLimit(0, -effort)
            created.setForceUpperLimit(0, effort)
        if dynamics is not None:
            created.setDampingCoefficient(0, float(text_of(dynamics, "damping", "0")))
            created.setCoulombFriction(0, float(text_of(dynamics, "friction", "0")))
            created.setSpringStiffness(0, float(text_of(dynamics, "spring_stiffness", "0")))
            created.setRestPosition(0, float(text_of(dynamics, "spring_reference", "0")))
        return made[0], made[1]

    def _fill(self, body: Any, link: Element) -> None:
        dart = self.dart
        inertial = link.find("inertial")
        if inertial is not None:
            moments = {k: float(text_of(inertial, f"inertia/{k}", "0")) for k in MOMENTS}
            xyz = [float(x) for x in text_of(inertial, "pose", "0 0 0").split()[:3]]
            body.setInertia(
                dart.dynamics.Inertia(
                    float(text_of(inertial, "mass")),
                    xyz,
                    [[moments["ixx"], moments["ixy"], moments["ixz"]],
                     [moments["ixy"], moments["iyy"], moments["iyz"]],
                     [moments["ixz"], moments["iyz"], moments["izz"]]],
                )
            )  # fmt: skip
        for collision in link.findall("collision"):
            radius = collision.findtext("geometry/sphere/radius")
            if radius is None:
                continue  # only tyres touch the ground
            shape = body.createShapeNode(dart.dynamics.SphereShape(float(radius)))
            shape.setRelativeTransform(self._transform(text_of(collision, "pose")))
            shape.createCollisionAspect()
            friction = float(text_of(collision, "surface/friction/ode/mu", "1"))
            shape.createDynamicsAspect().setFrictionCoeff(friction)

    def _transform(self, pose: str) -> Any:
        numbers = [float(x) for x in pose.split()] or [0.0] * 6
        transform = self.dart.math.Isometry3()
        transform.set_translation(numbers[:3])
        transform.set_rotation(self.dart.math.eulerZYXToMatrix(numbers[:2:-1]))
        return transform

    def positions(self) -> dict[str, float]:
        return {name: joint.getPosition(0) for name, joint in self.joints.items()}

    def velocities(self) -> dict[str, float]:
        return {name: joint.getVelocity(0) for name, joint in self.joints.items()}

    def step(self, speeds: dict[str, float]) -> None:
        for joint, speed in speeds.items():
            self.joints[joint].setCommand(0, speed)
        self.world.step()

    def motion(self, robot: int) -> tuple[list[float], list[float]]:
        body = self.roots[robot]
        matrix = body.getWorldTransform().matrix()
        yaw = math.atan2(matrix[1, 0], matrix[0, 0])
        velocity, rate = body.getLinearVelocity(), body.getAngularVelocity()
        c, s = math.cos(yaw), math.sin(yaw)
        return (
            [float(matrix[0, 3]), float(matrix[1, 3]), yaw],
            [
                c * velocity[0] + s * velocity[1],
                c * velocity[1] - s * velocity[0],
                float(rate[2]),
            ],
        )


MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
PHYSICS = {"mujoco": MujocoPhysics, "dart": DartPhysics}


def main() -> None:
    """Reads what to simulate from the first line, then answers each line with a line."""
    setup = json.loads(sys.stdin.readline())
    try:
        robots = [Robot(Path(package)) for package in setup["packages"]]
        make = PHYSICS[setup["physics"]]
        physics = make(robots, setup["file"], setup["places"])
    except WorldError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return
    topics = [
        {
            "commands": [*robot.velocity, *robot.position],
            "states": robot.state_topic,
            "odometry": robot.odometry_topic,
            "rate": robot.rate,
        }
        for robot in robots
    ]
    print(json.dumps({"robots": topics}), flush=True)
    steps = 0
    for line in sys.stdin:
        request = json.loads(line)
        if request.get("reset"):
            physics, steps = make(robots, setup["file"], setup["places"]), 0
        for topic, value in request["commands"].items():
            assert any(robot.take(topic, value) for robot in robots), topic
        for _ in range(round(request["seconds"] / physics.step_time)):
            positions = physics.positions()
            speeds: dict[str, float] = {}
            for robot in robots:
                speeds |= robot.joint_speeds(positions, physics.step_time)
            physics.step(speeds)
            steps += 1
        positions, velocities = physics.positions(), physics.velocities()
        answer = {
            "time": round(steps * physics.step_time * 1e9),
            "robots": [
                {
                    "names": robot.published,
                    "positions": [positions[joint] for joint in robot.published],
                    "velocities": [velocities[joint] for joint in robot.published],
                    "motion": physics.motion(i),
                }
                for i, robot in enumerate(robots)
            ],
        }
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
