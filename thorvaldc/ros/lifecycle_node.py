"""The ROS 2 lifecycle node of the base driver; docs/ros2-node.md describes its interface.

- configured: the model is read, and all topics and services exist;
- active: the base is open, and the control loop runs; the robot moves only after ``enable``;
- deactivated: the robot has come to rest, and the base is closed.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist as TwistMessage
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Bool, String

from thorvaldc.can.frame import CanFrame
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model.settings import FOR_FILTERS
from thorvaldc.ros import messages
from thorvaldc.ros.bases import NodeError, description_text, open_robot
from thorvaldc.ros.guarded_node import GuardedLifecycleNode
from thorvaldc.ros.message_wait import handle_messages
from thorvaldc.ros.node_parameters import Changes, NodeParameters
from thorvaldc.ros.node_services import create_services
from thorvaldc.ros.parameters import TOPICS
from thorvaldc.ros.sensor_topics import SensorTopics
from thorvaldc.ros.topic_base import TopicBase, robot_behind_topics
from thorvaldc.ros.topic_twists import ClockWatch, TwistInputs
from thorvaldc.runtime.can_base.battery_and_io_drivers import SUPPLY
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.filter_covariance import filter_covariance
from thorvaldc.runtime.run_session import UNTESTED
from thorvaldc.runtime.service_notify import LowBattery
from thorvaldc.runtime.service_table import ServiceError
from thorvaldc.runtime.state_text import FAULT, state_rows

NODE_NAME = "base_driver"
REPORT_PERIOD = 1.0
"""Real time (s) between two messages on /diagnostics, if nothing changes."""
LONGEST_DELIVERY = 0.5
"""Longest real time (s) for which a node that ends waits for the subscribers of the odometry."""
DEVICE_PERIOD = 0.1
"""Time (s) of the robot between two messages with the values that its devices report."""
LONGEST_BACKLOG = 0.1
"""Longest time (s) of /clock that a simulation in MuJoCo catches up: messages may be late."""
RELAY_QUEUE = 64
"""Frames of foreign devices that wait in a topic, in each direction."""
DONE, FAILED = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


def latched(depth: int = 1) -> QoSProfile:
    """Returns the QoS of a topic whose newest messages also reach later subscribers."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class BaseDriverNode(GuardedLifecycleNode):
    """The base driver of one robot as a ROS 2 node.

    The program calls ``run_due`` when ``wait`` has passed, and handles the callbacks of the node in
    the same thread meanwhile.
    """

    def __init__(self, **options: Any) -> None:
        """Creates the node and reads the model.

        ``options``: arguments of ``rclpy.node.Node``, such as ``namespace`` and
        ``parameter_overrides``.  Raises ``NodeError`` or ``DiagnosticError`` if a parameter or the
        model is wrong.
        """
        super().__init__(NODE_NAME, **options)
        self.parameters = NodeParameters(self)
        self.parameters.give = self._use_parameters
        self.values = self.parameters.values
        self.model = self.parameters.robot
        self.model_file = Path(self.values["model_file"])
        self._model_text = self._described_model()  # of the file as it is now
        self.robot: DrivenRobot | None = None
        self.inputs = TwistInputs(self.model, self.values, self.get_logger().warning)
        self.clock_watch = ClockWatch()
        self._low_battery = LowBattery(self.model)
        self.problem = ""
        """Reason why the node is not active although it was, or why it could not be activated."""
        self._entities: list[Any] = []
        self._sensors: SensorTopics | None = None
        self._next_report = 0.0
        self._next_device_data = -math.inf
        self._reported: Any = None
        self._logged_fault = ""
        simulated = self.values["base"] in ("ideal", "mujoco")
        self.owns_clock = simulated and self.values["publish_clock"]
        if self.values["publish_clock"] and not simulated:
            self.get_logger().warning("publish_clock: only the bases ideal and mujoco have a clock")
        self._tf_type: Any = messages.optional_type("tf2_msgs", "TFMessage")
        self._frame_type: Any = messages.optional_type("can_msgs", "Frame")
        self._device_types: Any = tuple(
            messages.optional_type("control_msgs", name)
            for name in ("DynamicInterfaceGroupValues", "InterfaceValue")
        )

    # -- lifecycle -----------------------------------------------------------------------------

    def on_configure(self, state: Any) -> Any:
        try:
            self._create_topics()
        except NodeError as error:
            self._remove_topics()
            self.get_logger().error(str(error))
            self.problem = str(error)
            return FAILED
        self._report()
        return DONE

    def on_activate(self, state: Any) -> Any:
        return DONE if self._open() else FAILED

    def on_deactivate(self, state: Any) -> Any:
        self.stop_robot()
        self._report()
        return DONE

    def on_cleanup(self, state: Any) -> Any:
        self._remove_topics()
        return DONE

    def on_shutdown(self, state: Any) -> Any:
        self.stop_robot()
        self._remove_topics()
        return DONE

    def on_error(self, state: Any) -> Any:
        self.stop_robot()
        self._remove_topics()
        return DONE

    # -- the loop ------------------------------------------------------------------------------

    def wait(self) -> float:
        """Returns the real time (s) until ``run_due`` must be called."""
        report = self._next_report - time.monotonic()
        return report if self.robot is None else min(report, self.robot.wait())

    def await_states(self, longest: float) -> float | None:
        """Waits for joint states behind topics, at most ``longest`` s of real time.

        The other messages are handled together, once per control cycle, which saves most of the
        time that rclpy takes.  Returns the time (s) that the executor may wait, or ``None`` if
        nothing is left to it: no request waits, and its events are looked at with each report.
        """
        if self.robot is None or not isinstance(self.robot.base, TopicBase):
            return longest
        self.robot.base.poll(longest)
        requested = handle_messages(self, list(self.subscriptions), list(self.services))
        return 0.0 if requested or time.monotonic() >= self._next_report else None

    def run_due(self) -> None:
        """Runs the control cycle and sends the messages that are due."""
        robot = self.robot
        if robot is not None:
            self._watch_clock(robot)  # also while no cycle is due because the time stands
        if robot is not None and robot.wait() <= 0.0:
            try:
                robot.run_due_cycle()
            except BaseException:
                self.robot = None
                robot.close()
                raise
            self._low_battery.cycle_done(robot)
            reported = self._reported
            self._publish(robot)
            if self._reported != reported:
                self._log_fault(robot)
            self._watch_bus(robot)
        if time.monotonic() >= self._next_report:
            self._report()

    def stop_robot(self) -> None:
        """Stops the robot and closes its base."""
        robot, self.robot = self.robot, None
        if robot is not None:
            robot.pace.real_time = time.monotonic  # no message of /clock is taken meanwhile
            robot.pace.backlog = 0.0
            robot.shutdown()
            self._publish_end(robot)
            # Subscribers must see the robot at rest, also if the node is removed right after.
            self._odometry.wait_for_all_acked(Duration(seconds=LONGEST_DELIVERY))

    def restart_simulation(self) -> None:
        """Starts the simulation again at the time 0; the robot is disarmed.

        Raises ``ServiceError`` if it cannot be started.
        """
        self.robot = None
        if not self._open():
            raise ServiceError(self.problem)

    # -- inside --------------------------------------------------------------------------------

    def _open(self) -> bool:
        values = self.values
        if values["base"] == "bus" and not values["bus"].startswith("sim:"):
            self.get_logger().warning(UNTESTED)
        try:
            if values["base"] == TOPICS:
                self.robot = robot_behind_topics(
                    self, self.model, values["joint_topics"], values["longest_silence"]
                )
            else:
                self.robot = open_robot(
                    self.model,
                    self.model_file,
                    values["base"],
                    values["bus"],
                    values["real_time_factor"],
                    values["world"],
                )
            if values["base"] == "mujoco" and self._follows_clock():
                # The robots of a fleet have one time.
                self.robot.pace.real_time = self.ros_time
                self.robot.pace.backlog = LONGEST_BACKLOG
                self.robot.pace.restart()
            if self._sensors is not None:
                self._sensors.attach(self.robot)
        except DiagnosticError as error:
            self.problem = error.one_line
        except (NodeError, OSError) as error:
            self.problem = str(error)
        else:
            self.problem, self._reported = "", None
            self._next_device_data = -math.inf
            self._joints = messages.JointMessages(self.model)
            self.parameters.give_all()
            return True
        self.get_logger().error(self.problem)
        return False

    def _use_parameters(self, parameter_set: str | None, changes: Changes) -> None:
        if self.robot is None:
            return
        if parameter_set is not None:
            self.robot.driver.use(parameter_set or None)
        if any(changes.values()):
            new = {"radii": changes["radii"], "noise": changes["noise"], **changes["limits"]}
            self.robot.driver.update(**new)

    def _create_topics(self) -> None:
        model, add = self.model, self._entities.append
        self._odometry = self.create_publisher(Odometry, "odometry/base_raw", 10)
        self._joint_states = self.create_publisher(JointState, "joint_states", 10)
        count = len(model.batteries) + 1  # and their common supply
        self._battery = self.create_publisher(BatteryState, "battery_data", latched(count))
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._base_state = self.create_publisher(DiagnosticStatus, "base_state", latched())
        self._joint_commands = self.create_publisher(JointState, "joint_commands", 10)
        self._entities += [self._odometry, self._joint_states, self._battery, self._diagnostics]
        self._entities += [self._base_state, self._joint_commands]
        self._create_device_topics()
        if model.sensors and self.values["base"] == "mujoco" and self.values["publish_sensors"]:
            self._sensors = SensorTopics(self)
            self._entities += self._sensors.entities
        self._clock_topic = self._tf = self._from_devices = None
        if self.owns_clock:
            self._clock_topic = self.create_publisher(Clock, "/clock", 1)
            add(self._clock_topic)
        if self._tf_type is not None:
            self._tf = self.create_publisher(self._tf_type, "/tf", 100)
            add(self._tf)
        elif self.values["enable_odom_tf"]:
            self.get_logger().warning(
                "tf2_msgs is not installed: the transform from odom to base_link is not published"
            )
        stamped = self.values["stamped"]
        twist = TwistStamped if stamped else TwistMessage
        callback: Callable[..., None] = self._on_stamped_twist if stamped else self._on_twist
        for source in model.twist_sources:
            take = functools.partial(callback, source.name)
            add(self.create_subscription(twist, source.topic, take, 1, timed=True))
        for lock in model.twist_locks:
            add(
                self.create_subscription(
                    Bool, lock.topic, lambda m, name=lock.name: self._on_lock(name, m), 10
                )
            )
        if any(frame.kind == "relay" for bus in model.buses for frame in bus.frames):
            self._create_relay()
        model_topic = self.create_publisher(String, "robot_model", latched())
        add(model_topic)
        model_topic.publish(String(data=self._model_text))
        if self.values["publish_description"]:
            description = self.create_publisher(String, "robot_description", latched())
            add(description)
            description.publish(String(data=description_text(model, self.model_file)))
        self._entities += create_services(self)

    def _create_device_topics(self) -> None:
        self._device_topics: dict[str, Any] = {}
        if self.values["base"] not in ("bus", "virtual"):
            return
        if None in self._device_types:
            self.get_logger().warning(
                "control_msgs is not installed: motor_controller_data and io_data are not published"
            )
            return
        for topic in ("motor_controller_data", "io_data"):
            publisher = self.create_publisher(self._device_types[0], topic, 10)
            self._device_topics[topic] = publisher
            self._entities.append(publisher)

    def _described_model(self) -> str:
        """Returns which model the node drives, as JSON."""
        content = self.model_file.read_bytes()
        values = {
            "robot": self.model.name,
            "namespace": self.model.namespace,
            "model_file": str(self.model_file.resolve()),
            "sha256": hashlib.sha256(content).hexdigest(),
        }
        return json.dumps(values)

    def _create_relay(self) -> None:
        frame = self._frame_type
        if frame is None:
            self.get_logger().warning(
                "can_msgs is not installed: no frames of foreign devices are relayed"
            )
            return
        self._from_devices = self.create_publisher(frame, "can_frames_device_r", RELAY_QUEUE)
        self._entities.append(self._from_devices)
        self._entities.append(
            self.create_subscription(frame, "can_frames_device_t", self._on_frame, RELAY_QUEUE)
        )

    def _remove_topics(self) -> None:
        for entity in self._entities:
            # Each of the three ignores entities of the other kinds.
            for destroy in (
                self.destroy_publisher,
                self.destroy_subscription,
                self.destroy_service,
            ):
                destroy(entity)
        self._entities.clear()

    # -- messages in ---------------------------------------------------------------------------

    def message_failed(self, reason: str) -> None:
        """Brings the robot to rest: the message may have been one that stops it."""
        if self.robot is not None:
            self.robot.void(reason)

    def ros_time(self) -> float:
        """Returns the time (s) of ROS: simulated, of /clock, or of the computer."""
        if self.owns_clock and self.robot is not None:
            return self.robot.now
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def _follows_clock(self) -> bool:
        """Returns whether the time is that of /clock, which another node publishes."""
        return self.get_parameter("use_sim_time").value and not self.owns_clock

    def _on_twist(self, source: str, message: Any, waited: float) -> None:
        problem = self.clock_watch.problem
        self.inputs.publish(self.robot, source, message, problem, waited=waited)

    def _on_stamped_twist(self, source: str, message: Any, waited: float) -> None:
        problem, ros_time = self.clock_watch.problem, self.ros_time()
        self.inputs.publish_stamped(self.robot, source, message, problem, ros_time, waited)

    def _on_lock(self, name: str, message: Any) -> None:
        robot = self.robot
        if robot is not None:
            try:
                robot.call("lock", f"the topic of {name}", name=name, locked=bool(message.data))
            except ServiceError as error:
                self.get_logger().warning(str(error))

    def _on_frame(self, message: Any) -> None:
        robot = self.robot
        if robot is None or robot.void_reason():
            return
        data = bytes(message.data[: message.dlc])
        frame = CanFrame(message.id, data, message.is_extended, message.is_rtr)
        robot.base.send_to_device(frame, robot.now)

    # -- messages out --------------------------------------------------------------------------

    def _stamp(self, robot: DrivenRobot | None) -> Any:
        """Returns the time of the robot's joint states, where another program measures them."""
        if robot is not None and self.owns_clock:
            nanoseconds = round(robot.now * 1e9)
        elif robot is not None and isinstance(robot.base, TopicBase) and robot.base.has_time:
            nanoseconds = robot.base.stamp
        else:
            return self.get_clock().now().to_msg()
        return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)

    def _publish(self, robot: DrivenRobot) -> None:
        state, stamp = robot.driver.state, self._stamp(robot)
        if self._clock_topic is not None:
            self._clock_topic.publish(Clock(clock=stamp))
        if not robot.base.lacks_joint_states:
            self._publish_motion(robot, stamp)
        if self._sensors is not None:
            self._sensors.publish()
        if state.command is not None:
            command = state.command.joints
            message = messages.joint_commands_message(self.model, command, stamp)
            self._joint_commands.publish(message)
        if robot.now >= self._next_device_data:
            self._next_device_data = robot.now + DEVICE_PERIOD
            self._publish_device_data(robot, stamp)
        if self._from_devices is not None:
            for frame in robot.base.frames_from_devices():
                relayed = self._frame_type(
                    id=frame.id, is_extended=frame.extended, dlc=len(frame.data)
                )
                relayed.header.stamp = stamp
                relayed.data[: len(frame.data)] = list(frame.data)
                self._from_devices.publish(relayed)
        summary = (
            *(state.mode, state.fault, bool(state.not_followed)),
            *(robot.armed, robot.paused, robot.base.hold_reason),
        )
        if summary != self._reported:
            self._reported = summary
            self._next_report = 0.0

    def _publish_device_data(self, robot: DrivenRobot, stamp: Any) -> None:
        for topic, publisher in self._device_topics.items():
            data = getattr(robot.base, topic)(robot.now)
            publisher.publish(messages.device_message(self._device_types, data, stamp))

    def _publish_motion(self, robot: DrivenRobot, stamp: Any) -> None:
        state, values = robot.driver.state, self.values
        frames = values["odom_frame_id"], values["base_frame_id"]
        covariance = state.odometry.covariance
        if values["twist_covariance"] == FOR_FILTERS:
            driver, period = robot.driver, 1.0 / values["rate"]
            estimator, moved = driver.calculator.estimator, driver.odometry.motion_time
            covariance = filter_covariance(estimator, state.joints, state.odometry, period, moved)
        self._odometry.publish(messages.odometry_message(state, covariance, stamp, *frames))
        if self._tf is not None and values["enable_odom_tf"]:
            transform = messages.transform_message(state, stamp, *frames)
            self._tf.publish(self._tf_type(transforms=[transform]))
        joints = self._joints.message(state, stamp, robot.base.other_joints())
        if joints is not None:
            self._joint_states.publish(joints)

    def _publish_end(self, robot: DrivenRobot) -> None:
        """Publishes the robot at its last measurement.

        The twist of the driver is the mean of the last cycle, in which the robot still slowed down.
        """
        driver = robot.driver
        if (joints := driver.state.joints) is not None:
            driver.state.odometry = driver.calculator.odometry(joints)
        self._publish(robot)

    def _report(self) -> None:
        self._next_report = time.monotonic() + REPORT_PERIOD
        if not self._entities:
            return
        robot, stamp = self.robot, self._stamp(self.robot)
        taken = f"geometry_msgs/msg/Twist{'Stamped' if self.values['stamped'] else ''}"
        for source in self.model.twist_sources:
            publishers = self.get_publishers_info_by_topic(source.topic)
            self.inputs.note_types(source.name, [p.topic_type for p in publishers], taken)
        message = DiagnosticArray()
        message.header.stamp = stamp
        name = f"{self.get_namespace().rstrip('/')}/{NODE_NAME}".lstrip("/")
        message.status = messages.diagnostic_statuses(name, self, robot)
        self._diagnostics.publish(message)
        self._base_state.publish(message.status[0])
        if self._clock_topic is not None and robot is not None:
            self._clock_topic.publish(Clock(clock=stamp))  # also while the simulation is paused
        if robot is not None:
            batteries, supply = dict(robot.base.batteries()), robot.base.supply()
            if len(batteries) > 1 and supply is not None:
                batteries[SUPPLY] = supply
            for battery, reported in batteries.items():
                frame = self.values["base_frame_id"]
                self._battery.publish(messages.battery_message(battery, reported, stamp, frame))

    # -- supervision ---------------------------------------------------------------------------

    def _log_fault(self, robot: DrivenRobot) -> None:
        fault = dict(state_rows(robot.state())).get(FAULT, "")
        if fault and fault != self._logged_fault:
            self.get_logger().error(fault)
        self._logged_fault = fault

    def _watch_clock(self, robot: DrivenRobot) -> None:
        """Stops the robot while the ROS clock of another node stands still or jumps."""
        if self.owns_clock:
            return
        ros_time = self.ros_time() if self._follows_clock() else None
        timeout = self.values["command_timeout"]
        jump = self.clock_watch.update(ros_time, time.monotonic(), timeout)
        if jump or self.clock_watch.problem:
            robot.void(jump or self.clock_watch.problem)
        if jump and robot.owns_clock:
            robot.pace.restart()

    def _watch_bus(self, robot: DrivenRobot) -> None:
        problem = robot.base.lost
        if problem:
            self.get_logger().error(f"{problem}; activate the node again when it is back")
            self.trigger_deactivate()
            self.problem = problem

    def simulation(self) -> DrivenRobot:
        """Returns the simulated robot.  Raises ``ServiceError`` if there is none."""
        if self.robot is None or not self.robot.owns_clock:
            raise ServiceError("there is no simulation: the node is inactive")
        return self.robot
