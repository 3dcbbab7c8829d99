"""The parameters of the ROS 2 node ``base_driver``, as a table that needs no ROS."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass

from thorvaldc.model import Robot
from thorvaldc.model.settings import DRIVER, FOR_FILTERS, MEASURED, ODOM_FRAME
from thorvaldc.runtime.pace import TimeGapRule
from thorvaldc.runtime.run_time_parameters import COMMAND_TIMEOUT, LARGEST, LIMITS, Parameters

ParameterValue = str | bool | float
TOPICS = "topics"
BASES = ("ideal", "mujoco", "virtual", "bus", TOPICS)
"""Values of the parameter ``base``: ideal joints, a simulation in MuJoCo, a simulated bus in the
process of the node, the buses of the robot, or joints behind topics of another program."""
GAZEBO, ROS2_CONTROL, JOINT_STATES = "gazebo", "ros2_control", "joint_states"
DIALECTS = (GAZEBO, ROS2_CONTROL, JOINT_STATES)
"""Values of the parameter ``joint_topics``, see ``joint_messages.py``."""
MODEL_FILE, PARAMETER_SET = "model_file", "parameter_set"
USE_NODE_NAMESPACE = "use_node_namespace"
RADIUS, NOISE = "radius.", "noise."
"""Beginnings of the names of parameters for each wheel and each measurement error."""
SMALLEST = 1e-6
"""Smallest age (s) of a command that is refused; 0 is not allowed."""


@dataclass(frozen=True, slots=True)
class NodeParameter:
    """A parameter of the node.

    - ``default``: default value, whose type is that of all values, or a function that returns it
      for a robot;
    - ``unit``: unit of a number, or an empty text;
    - ``read_only``: ``True`` if the value is fixed when the node starts;
    - ``lowest``, ``highest``: range of a number, which may depend on the robot;
    - ``choices``: allowed texts, or empty for any text.
    """

    name: str
    default: ParameterValue | Callable[[Robot], ParameterValue]
    description: str
    unit: str = ""
    read_only: bool = True
    lowest: float | Callable[[Robot], float] = -math.inf
    highest: float | Callable[[Robot], float] = math.inf
    choices: tuple[str, ...] = ()

    def default_for(self, robot: Robot) -> ParameterValue:
        """Returns the default value for a robot."""
        return self.default(robot) if callable(self.default) else self.default

    def range_for(self, robot: Robot) -> tuple[float, float]:
        """Returns the lowest and the highest value for a robot; infinite without a range."""
        lowest = self.lowest(robot) if callable(self.lowest) else self.lowest
        highest = self.highest(robot) if callable(self.highest) else self.highest
        return lowest, highest

    @property
    def text(self) -> str:
        """Description with the unit and the choices, for the descriptor of the parameter."""
        unit = f" [{self.unit}]" if self.unit else ""
        choices = f": {', '.join(self.choices)}" if self.choices else ""
        return f"{self.description}{choices}{unit}"


Bound = Callable[[Robot], float]


def _bounds(range_of: Callable[[Parameters], tuple[float, float]]) -> tuple[Bound, Bound]:
    """Returns the least and the greatest value for a robot, its parameter sets included.

    What is accepted at a time is the rule of the driver alone, see ``Parameters.changed``.
    """

    def ranges(robot: Robot) -> list[tuple[float, float]]:
        sets = (None, *(s.name for s in robot.parameter_sets))
        return [range_of(Parameters.from_robot(robot, chosen)) for chosen in sets]

    return (
        lambda robot: min(least for least, _ in ranges(robot)),
        lambda robot: max(most for _, most in ranges(robot)),
    )


def _limit(name: str) -> NodeParameter:
    speed = "velocity" if name.endswith("velocity") else "acceleration"
    kind = "linear" if "linear" in name else "angular"
    lowest, highest = _bounds(lambda parameters: parameters.range_of(name))
    return NodeParameter(
        name,
        lambda robot: float(getattr(robot.driver, name)),
        f"limit of the {kind} {speed} of the commanded twist; at most the value of the robot file",
        LIMITS[name],
        read_only=False,
        lowest=lowest,
        highest=highest,
    )


def default_silence(robot: Robot) -> float:
    """Returns the time (s) without joint states after which a robot behind topics stops.

    Nothing stops its joints in the meantime, so that it is a share of the command time-out, which
    follows from the stopping distance of the robot where it has one.
    """
    return TimeGapRule.without_watchdog(robot.driver).longest_short


def _shortest_silence(robot: Robot) -> float:
    return TimeGapRule.without_watchdog(robot.driver).normal


_TIMEOUT = _bounds(lambda parameters: parameters.range_of(COMMAND_TIMEOUT))
PARAMETERS: tuple[NodeParameter, ...] = (
    NodeParameter(
        MODEL_FILE,
        "",
        "path of the file model.json of a build; everything about the robot comes from it",
    ),
    NodeParameter(
        USE_NODE_NAMESPACE,
        False,
        "names of joints and frames begin with the name space of the node, not with that of the"
        " model",
    ),
    NodeParameter("base", "bus", "what the node drives", choices=BASES),
    NodeParameter(
        "bus", "socketcan:can0", "CAN interface of the base `bus`, as `run --bus` takes it"
    ),
    NodeParameter(
        "joint_topics",
        GAZEBO,
        "topics of the joints of the base `topics`: one topic for each joint, two forward"
        " controllers of ros2_control, or messages JointState",
        choices=DIALECTS,
    ),
    NodeParameter(
        "longest_silence",
        default_silence,
        "time of ROS without usable joint states after which the base `topics` is in a fault; at"
        " most the command time-out, by default half of it",
        "s",
        lowest=_shortest_silence,
        highest=lambda robot: max(robot.driver.command_timeout, _shortest_silence(robot)),
    ),
    NodeParameter(
        "real_time_factor",
        1.0,
        "speed of a simulation relative to the real time; 0: as fast as possible",
        lowest=0.0,
        highest=1000.0,
    ),
    NodeParameter("publish_clock", False, "publish the simulated time on /clock (ideal, mujoco)"),
    NodeParameter("world", "", "build of a scenario with this robot; empty: level ground (mujoco)"),
    NodeParameter("publish_sensors", True, "measure with the sensors of the modules (mujoco)"),
    NodeParameter("sensor_errors", 1.0, "factor of the errors of sensors", lowest=0.0, highest=1e3),
    NodeParameter("publish_images", False, "cameras draw images, which needs OpenGL (mujoco)"),
    NodeParameter("autostart", True, "configure and activate the node at its start; never arms it"),
    NodeParameter(
        "stamped",
        lambda robot: robot.ros.stamped,
        "twists are messages of the type TwistStamped, not Twist",
    ),
    NodeParameter(
        "enable_odom_tf",
        lambda robot: robot.ros.odom_tf == DRIVER,
        "publish the transform from odom_frame_id to base_frame_id",
        read_only=False,
    ),
    NodeParameter(
        "odom_frame_id", lambda robot: robot.prefix + ODOM_FRAME, "frame of the odometry"
    ),
    NodeParameter(
        "base_frame_id",
        lambda robot: robot.prefix + robot.links[0].name,
        "frame of the robot",
    ),
    NodeParameter(
        "publish_description",
        False,
        "publish the URDF on robot_description, where no robot_state_publisher does",
    ),
    NodeParameter(
        "twist_covariance",
        MEASURED,
        "covariance of the twist of the odometry, and of a simulated IMU: of one measurement, or"
        " for filters that take the errors of two measurements as independent",
        choices=(MEASURED, FOR_FILTERS),
    ),
    NodeParameter(
        "rate",
        lambda robot: robot.driver.rate,
        "frequency of the control loop, from the model",
        "Hz",
    ),
    NodeParameter(
        COMMAND_TIMEOUT,
        lambda robot: robot.driver.command_timeout,
        "age of a twist at which the robot stops; at most the value of the robot file",
        "s",
        read_only=False,
        lowest=_TIMEOUT[0],
        highest=_TIMEOUT[1],
    ),
    *(_limit(name) for name in LIMITS),
    NodeParameter(
        PARAMETER_SET,
        "",
        "parameter set of the robot file that is in force; empty: the ordinary values",
        read_only=False,
    ),
    NodeParameter(
        "max_command_age",
        lambda robot: robot.driver.command_timeout,
        "a stamped twist that is older is refused",
        "s",
        read_only=False,
        lowest=SMALLEST,
        highest=10.0,
    ),
    NodeParameter(
        "max_command_lead",
        0.1,
        "a stamped twist is refused whose stamp is further in the future, by the clock of its"
        " computer",
        "s",
        read_only=False,
        lowest=0.0,
        highest=1.0,
    ),
)
"""Parameters of the node of every robot, in the order in which they are declared."""


def parameters_of(robot: Robot) -> list[NodeParameter]:
    """Returns all parameters of the node of a robot: with its wheel radii and its noise."""
    radii = []
    for i, wheel in enumerate(robot.wheels):
        lowest, highest = _bounds(lambda parameters, i=i: parameters.radius_range(i))  # type: ignore[misc]
        text = f"rolling radius of the wheel {wheel.name}; it can be changed at rest"
        name = f"{RADIUS}{wheel.name}"
        radii.append(NodeParameter(name, wheel.radius, text, "m", False, lowest, highest))
    noise = [
        NodeParameter(
            f"{NOISE}{name}",
            value,
            f"standard deviation `{name}` of the measurements, as in the robot file",
            read_only=False,
            lowest=0.0,
            highest=LARGEST,
        )
        for name, value in asdict(Parameters.from_robot(robot).noise).items()
        if value is not None  # it follows from another one
    ]
    return [*PARAMETERS, *radii, *noise]
