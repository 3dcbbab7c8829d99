"""Robots in a world, as Gazebo simulates them: the systems of the SDF files over a physics engine.

This program stands for Gazebo, which cannot run in the tests.  It reads the generated SDF files
with a plain XML reader, and does what the systems of gz-sim 8 to 10 do.  A second reader, who did
not write the backend, compared the rules with the sources of July and August 2026; the comments
name the files.  It imports nothing of thorvaldc, and refuses plug-ins and elements that it does not
know, which Gazebo would ignore.  DART is the physics engine of Gazebo, and builds the robot from
the SDF; MuJoCo steps the MJCF files of the same build.

Not simulated: the mean of the last 10 steps that OdometryPublisher has as its twist, collisions
of other parts than tyres, and sensors.

It runs as a child process: one line of JSON in (commands by topic, and the time in ns to reach),
one line out (time in ns, joint states and true motion of each robot).
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
        *("joint_name", "topic", "use_velocity_commands", "cmd_max", "cmd_min", "p_gain"),
        *("i_gain", "d_gain", "i_max", "i_min", "cmd_offset", "initial_position"),
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


def topic_of(plugin: Element, name: str, default: str) -> str:
    return text_of(plugin, name, default).strip("/")


def world_name(world_file: str) -> str:
    world = parse(world_file).getroot().find("world")
    return "default" if world is None else str(world.get("name"))


class Pid:
    """The force of a JointPositionController: gz-math, src/PID.cc; p stands for the error."""

    def __init__(self, plugin: Element) -> None:
        defaults = {"p_gain": 1.0, "i_gain": 0.1, "d_gain": 0.01, "i_max": 1.0, "i_min": -1.0}
        defaults |= {"cmd_max": 1000.0, "cmd_min": -1000.0, "cmd_offset": 0.0}
        self.set = {n: float(text_of(plugin, n, str(value))) for n, value in defaults.items()}
        self.last = self.integral = 0.0

    def update(self, error: float, step: float) -> float:
        """Returns the force for an error, which is the position minus the target."""
        values = self.set
        self.integral += values["i_gain"] * step * error
        self.integral = clamp(self.integral, values["i_min"], values["i_max"])
        damping = values["d_gain"] * (error - self.last) / step
        self.last = error
        force = values["cmd_offset"] - values["p_gain"] * error - self.integral - damping
        return clamp(force, values["cmd_min"], values["cmd_max"])


def clamp(value: float, low: float, high: float) -> float:
    """Returns the nearest value in a range; there is none if ``low`` is above ``high``."""
    return min(max(value, low), high) if low <= high else value


class Robot:
    """The systems of one model.

    ``velocity`` and ``position`` map topics to the joints of both kinds of controllers; ``limits``
    has the greatest speed (rad/s) of a joint with a position controller, in both directions, and
    ``pids`` has the controllers of those that a force moves.
    Topics are as gz-transport compares them: ``a`` and ``/a`` are the same.
    """

    def __init__(self, package: Path, world: str = "default") -> None:
        model = parse(package / "sdf" / "model.sdf").getroot().find("model")
        if model is None:
            raise WorldError("sdf/model.sdf has no model")
        self.model = model
        self.scope = f"model/{model.get('name')}"
        self.world = world
        joints = [str(joint.get("name")) for joint in model.iter("joint")]
        self.velocity: dict[str, str] = {}
        self.position: dict[str, str] = {}
        self.limits: dict[str, float] = {}
        self.pids: dict[str, Pid] = {}
        self.targets: dict[str, float] = {}
        self.speeds: dict[str, float] = {}
        self.state_topic = self.odometry_topic = ""
        self.rate = self.odometry_rate = 0.0
        self.frames = ["", ""]
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
            getattr(self, f"_add_{name}")(plugin, named, joints)

    # The controllers take the newest command for as long as they live: gz-sim,
    # src/systems/joint_controller/JointController.cc and
    # src/systems/joint_position_controller/JointPositionController.cc.

    def _add_JointController(self, plugin: Element, named: list[str], joints: list[str]) -> None:
        (joint,) = named
        self.velocity[topic_of(plugin, "topic", f"{self.scope}/joint/{joint}/cmd_vel")] = joint
        self.speeds[joint] = 0.0

    def _add_JointPositionController(
        self, plugin: Element, named: list[str], joints: list[str]
    ) -> None:
        (joint,) = named
        self.position[topic_of(plugin, "topic", f"{self.scope}/joint/{joint}/0/cmd_pos")] = joint
        if text_of(plugin, "use_velocity_commands") == "true":
            # `cmd_min` is not read, and only a stated `cmd_max` limits.
            self.limits[joint] = float(text_of(plugin, "cmd_max", "inf"))
        else:
            self.pids[joint] = Pid(plugin)
            limit = f"joint[@name='{joint}']/axis/limit/velocity"
            self.limits[joint] = float(text_of(self.model, limit, "inf"))
        self.targets[joint] = float(text_of(plugin, "initial_position", "0"))

    def _add_JointStatePublisher(
        self, plugin: Element, named: list[str], joints: list[str]
    ) -> None:
        """src/systems/joint_state_publisher/JointStatePublisher.cc: joints in their own order."""
        default = f"world/{self.world}/{self.scope}/joint_state"
        self.state_topic = topic_of(plugin, "topic", default)
        self.rate = float(text_of(plugin, "update_rate", "0"))
        self.published = sorted(set(named or joints), key=joints.index)

    def _add_OdometryPublisher(self, plugin: Element, named: list[str], joints: list[str]) -> None:
        """src/systems/odometry_publisher/OdometryPublisher.cc"""
        name = str(self.model.get("name"))
        self.odometry_topic = topic_of(plugin, "odom_topic", f"{self.scope}/odometry")
        self.odometry_rate = float(text_of(plugin, "odom_publish_frequency", "50"))
        self.frames = [
            text_of(plugin, "odom_frame", f"{name}/odom"),
            text_of(plugin, "robot_base_frame", f"{name}/base_footprint"),
        ]

    def take(self, topic: str, value: float) -> bool:
        """Takes a command; returns whether the topic is one of this robot."""
        if topic in self.velocity:
            self.speeds[self.velocity[topic]] = value
        elif topic in self.position:
            self.targets[self.position[topic]] = value
        return topic in self.velocity or topic in self.position

    def joint_speeds(self, positions: dict[str, float], step: float) -> dict[str, float]:
        """Returns the commanded speed of each joint that has one, in rad/s."""
        speeds = dict(self.speeds)
        for joint, target in self.targets.items():
            if joint in self.pids:
                continue
            top, error = self.limits[joint], positions[joint] - target
            # Within reach of one step the joint stops at the target; else it has its top speed.
            if abs(error) > top * step:
                speeds[joint] = top if error < 0.0 else -top
            else:
                speeds[joint] = -error / step
        return speeds

    def joint_forces(self, positions: dict[str, float], step: float) -> dict[str, float]:
        """Returns the commanded torque of each joint that has one, in N m."""
        return {
            joint: pid.update(positions[joint] - self.targets[joint], step)
            for joint, pid in self.pids.items()
        }


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

    def step(self, speeds: dict[str, float], forces: dict[str, float]) -> None:
        for joint, speed in (speeds | forces).items():
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
        self.world.addSkeleton(self._ground(world))
        self.skeletons = [
            self._skeleton(robot.model, place) for robot, place in zip(robots, places, strict=True)
        ]
        self.joints: dict[str, Any] = {}
        for robot, skeleton in zip(robots, self.skeletons, strict=True):
            self.world.addSkeleton(skeleton)
            for name in {*robot.published, *robot.speeds, *robot.targets}:
                self.joints[name] = skeleton.getJoint(name)
            for name in {*robot.speeds, *robot.targets} - robot.pids.keys():
                # gz-physics, dartsim/src/JointFeatures.cc: a joint with velocity commands has a
                # servo of limited force; others have the type FORCE, as at the start.
                self.joints[name].setActuatorType(dartpy.dynamics.ActuatorType.SERVO)
        self.roots = [
            skeleton.getBodyNode(str(robot.model.get("canonical_link")))
            for robot, skeleton in zip(robots, self.skeletons, strict=True)
        ]

    def _ground(self, world: Element) -> Any:
        dart = self.dart
        ground = "model/link/collision/surface/friction/ode/mu"
        skeleton = dart.dynamics.Skeleton("ground")
        _, body = skeleton.createWeldJointAndBodyNodePair()
        shape = body.createShapeNode(dart.dynamics.BoxShape([200.0, 200.0, 1.0]))
        shape.createCollisionAspect()
        shape.createDynamicsAspect().setFrictionCoeff(float(text_of(world, ground, "1")))
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
                parent = text_of(joint, "parent")
                if link.find(f"pose[@relative_to='{parent}']") is None:
                    raise WorldError(f"the pose of {name} is not relative to {parent}")
                created, body = self._joined(skeleton, joint, bodies[parent])
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
        # gz-physics, dartsim/src/SDFFeatures.cc, CopyStandardJointAxisProperties: a limit of effort
        # or speed below 0 is none.  Both bound the servo of a velocity command.
        limit, dynamics = axis.find("limit"), axis.find("dynamics")
        if limit is not None:
            created.setPositionLowerLimit(0, float(text_of(limit, "lower", "-1e16")))
            created.setPositionUpperLimit(0, float(text_of(limit, "upper", "1e16")))
            effort, speed = (float(text_of(limit, n, "inf")) for n in ("effort", "velocity"))
            effort, speed = (math.inf if value < 0.0 else value for value in (effort, speed))
            created.setForceLowerLimit(0, -effort)
            created.setForceUpperLimit(0, effort)
            created.setVelocityLowerLimit(0, -speed)
            created.setVelocityUpperLimit(0, speed)
            created.setLimitEnforcement(True)
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
            ode = "surface/friction/ode"
            friction = float(text_of(collision, f"{ode}/mu", "1"))
            if friction != float(text_of(collision, f"{ode}/mu2", str(friction))):
                raise WorldError("the Python interface of DART has only one friction for a shape")
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

    def step(self, speeds: dict[str, float], forces: dict[str, float]) -> None:
        for joint, value in (speeds | forces).items():
            self.joints[joint].setCommand(0, value)
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


def load(setup: dict[str, Any]) -> tuple[list[Robot], MujocoPhysics | DartPhysics]:
    """Returns the robots of the packages, and their physics at the start."""
    file = setup["file"]
    world = world_name(file) if setup["physics"] == "dart" else "default"
    robots = [Robot(Path(package), world) for package in setup["packages"]]
    return robots, PHYSICS[setup["physics"]](robots, file, setup["places"])


def main() -> None:
    """Reads what to simulate from the first line, then answers each line with a line."""
    setup = json.loads(sys.stdin.readline())
    try:
        robots, physics = load(setup)
    except WorldError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return
    topics = [
        {
            "commands": [*robot.velocity, *robot.position],
            "states": robot.state_topic,
            "rate": robot.rate,
            "odometry": robot.odometry_topic,
            "odometry_rate": robot.odometry_rate,
            "frames": robot.frames,
        }
        for robot in robots
    ]
    print(json.dumps({"robots": topics}), flush=True)
    steps, step_ns = 0, round(physics.step_time * 1e9)
    for line in sys.stdin:
        request = json.loads(line)
        if request["reset"]:
            # src/SystemManager.cc, Reset: systems without a reset of their own are loaded anew, so
            # that the controllers have forgotten their commands.
            (robots, physics), steps = load(setup), 0
        for topic, value in request["commands"].items():
            assert any(robot.take(topic, value) for robot in robots), topic
        while steps * step_ns < request["until"]:
            positions = physics.positions()
            speeds: dict[str, float] = {}
            forces: dict[str, float] = {}
            for robot in robots:
                speeds |= robot.joint_speeds(positions, physics.step_time)
                forces |= robot.joint_forces(positions, physics.step_time)
            physics.step(speeds, forces)
            steps += 1
        positions, velocities = physics.positions(), physics.velocities()
        answer = {
            "time": steps * step_ns,
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
