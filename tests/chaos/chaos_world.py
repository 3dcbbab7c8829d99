"""A robot with its driver, its clients and its faults in one process, in virtual time."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from copy import deepcopy
from typing import Any

from tests.chaos.chaos_client import ChaosClient
from tests.chaos.chaos_commissioning import Technician, delivered_ids
from tests.chaos.chaos_interface import LONGEST_JUMP, ChaosInterface
from tests.chaos.chaos_problems import (
    DISOBEDIENT,
    EMPTY_BATTERY,
    FALSE_REPORTS,
    IMPEDING,
    LATCHED,
    LYING,
    MASTER_BUS_OFF,
    OBJECT_WRITTEN,
    SECOND_MASTER,
    Problem,
    notice_time,
    problem_kind,
)
from tests.chaos.chaos_robots import chaos_robot, wrong_file
from tests.chaos.control_streams import MemoryControlServer, MemoryListener
from tests.chaos.invariants import (
    CHECK_PERIOD,
    DISOBEDIENCE,
    PUSHED,
    MotionInvariant,
    OdometryInvariant,
    StateInvariant,
    Violation,
    check_commands,
    check_explored_permission,
    check_stored,
)
from tests.chaos.permission import Permission, wheel_speed
from tests.chaos.schedule import DELIVERED, POWER_ON, READY, ChaosEvent, Schedule
from tests.chaos.true_motion import TrueMotion
from tests.robots import SPAN
from thorvaldc.can.frame import ErrorState, to_ns
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.model.settings import AUTOMATIC
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import BaseDriver, DriverState
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.cia402_device import Cia402Drive
from thorvaldc.simulation.bus.fault_injection import FaultInjector
from thorvaldc.simulation.bus.roboteq_device import RoboteqController
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

CONTROL_PERIOD = 0.01
"""Period (s) of the control loops of the drives, longer than usual to save computing time."""
READY_TIME = 40.0
"""Longest time (s) of a start-up."""
CALL_TIME = 0.045
"""s that a person waits for the effect of a call."""
REST_TIME = 0.3
"""s between the end of all faults and the first act of the person; devices boot in this time."""
LATE_FRAME_TIME = 0.04
"""s until the next command replaces a command that was sent late."""
PUSH_ENDS = 1.5
"""s after the end of a push in which the wheel, which may have no torque, rolls out."""
RECOVERIES = 4
RECOVERY_TWIST = Twist(0.3, 0.0, 0.0)
RECOVERED_SPEED = 0.15
BATTERY_TIME = 1.5
"""s from an empty battery until the driver disarms: the time that the level must last, reports."""
TWIST_REQUEST = '{"call": "twist"'


class ChaosWorld:
    """The simulated robot, the process of the driver, the clients and the judge.

    ``run`` runs a schedule and raises ``Violation`` if an invariant does not hold.
    """

    def __init__(self, robot_name: str, seed: int, start: str = "") -> None:
        self.robot = chaos_robot(robot_name)
        delivered = start == DELIVERED
        stored = delivered_ids(self.robot, seed) if delivered else None
        self.simulated = SimulatedRobot(
            self.robot, seed=seed, delivered=delivered, nonvolatile=stored
        )
        self.timeline = self.simulated.timeline
        for device in self.simulated.devices.values():
            if isinstance(device, Cia402Drive):
                device.control_period = CONTROL_PERIOD
            elif isinstance(device, RoboteqController):
                device.loop_period = CONTROL_PERIOD
        period = min(bus.sync_period for bus in self.robot.buses)
        needs_arming = self.robot.driver.arming != AUTOMATIC
        self.permission = Permission(self.robot, period, needs_arming)
        self.driven: DrivenRobot = None  # type: ignore[assignment]
        self.alive = False
        self.listener: MemoryListener | None = None
        self.interfaces: dict[str, ChaosInterface] = {}
        self.clients: dict[str, ChaosClient] = {}
        self.problems: dict[int, Problem] = {}
        settings = self.robot.driver
        self.limits: tuple[float, ...] = (
            settings.max_linear_velocity,
            settings.max_angular_velocity,
        )
        self.driver_hangs = False
        self.hung_until = -math.inf
        self.cycles = 0
        self.violation: Violation | None = None
        self._ends: dict[int, Callable[[], None]] = {}
        self._targets: dict[int, tuple[object, ...]] = {}
        self._pushes: dict[int, float] = {}
        """Speeds (m/s) that something else may add to a wheel, by number of the problem."""
        self._stall, self._stall_in_sending = 0.0, 0.0
        self._end = ""
        self._start_wrong = False
        self._numbers = 0
        self._forged_until = -math.inf
        self._late_frame, self._late_frame_until = 0.0, -math.inf
        self._recovering = False
        self._jumped: set[str] = set()
        """Actuators from a jump of their encoder until the driver that has seen it has homed them.
        Nobody notices a jump while no driver runs, or of a frozen encoder, before a homing."""
        self._seen_jumps: set[str] = set()
        self._battery_empty = 0.0
        self._injector = FaultInjector(self.simulated, BusFaults((), seed=seed))
        self.truth = TrueMotion(self.robot, self.simulated)
        self.technician = Technician(self) if delivered else None
        self.motion = MotionInvariant(self)
        self.state_check = StateInvariant(self)
        self.odometry = OdometryInvariant(self)
        self._digest = hashlib.sha256()

    # -- time and truth ----------------------------------------------------------------------------

    @property
    def now(self) -> float:
        return self.timeline.seconds

    def after(self, seconds: float, action: Callable[[], None]) -> None:
        self.timeline.after(to_ns(seconds), action)

    @property
    def pushed_speed(self) -> float:
        """Speed (m/s) that something else may add to the fastest wheel."""
        return sum(self._pushes.values())

    @property
    def impeded(self) -> bool:
        """``True`` if the drives may not receive what the driver sends.

        A driver that has just been started listens, and commands nothing.
        """
        if self.driver_hangs or not self.alive or self.driven.base.state.starts:
            return True
        if any(i.state is ErrorState.BUS_OFF for i in self.interfaces.values()):
            return True
        return any(p.kind in IMPEDING or p.delay > 0.0 for p in self.problems.values())

    @property
    def frame_delay(self) -> float:
        """Longest time (s) by which a frame on a bus is late."""
        return max((problem.delay for problem in self.problems.values()), default=0.0)

    @property
    def late_cycle(self) -> bool:
        return self.now < self.hung_until + 0.15

    @property
    def encoders_lie(self) -> bool:
        return bool(self._jumped) or any(
            problem.kind in LYING for problem in self.problems.values()
        )

    def forged_level(self, now: float) -> float:
        """Returns the speed (m/s) that forged commands, or a command sent late, may cause."""
        if now > self._forged_until:
            return self._late_frame if now <= self._late_frame_until else 0.0
        actuators = [self.robot.actuator_of(w.spin_joint) for w in self.robot.wheels]
        return max(a.max_velocity for a in actuators if a is not None) * 0.5

    def describe(self) -> str:
        if not self.alive:
            return "no driver runs"
        machine = self.driven.base.state_machine
        kinds = ", ".join(sorted({p.kind for p in self.problems.values()})) or "no problem"
        return (
            f"{machine.state.value} {machine.reason!r}, armed {self.driven.armed},"
            f" permitted {self.permission.twist(self.now)}, {kinds}"
        )

    def _monitor(self) -> None:
        now = self.now
        try:
            self.odometry.advance(now)
            self._judge_battery()
            self.motion.check(now)
        except Violation as violation:
            self.violation = violation
            raise
        self.after(CHECK_PERIOD, self._monitor)

    def _judge_battery(self) -> None:
        """Withdraws the permission when the driver must have noticed an empty battery."""
        kinds = [problem.kind for problem in self.problems.values()]
        if kinds != [EMPTY_BATTERY] or self.late_cycle or self.driver_hangs:
            self._battery_empty = 0.0
            return
        self._battery_empty += CHECK_PERIOD
        if self._battery_empty > BATTERY_TIME:
            self.permission.armed = False

    # -- the process of the driver -----------------------------------------------------------------

    def start_driver(self, wrong: bool = False) -> None:
        robot = wrong_file(self.robot) if wrong else self.robot
        self.interfaces = {}
        for bus in self.robot.buses:
            interface = ChaosInterface(self.simulated.wire(bus.name), "master", fifo=True)
            interface.world = self
            self.interfaces[bus.name] = interface
        base = CanBase(robot, self.interfaces, threaded=False)
        self.driven = DrivenRobot(robot, base, next(iter(self.interfaces.values())))
        self.driven.before_cycle = self._before_cycle
        self.listener = MemoryListener()
        self.driven.channel = MemoryControlServer(
            self.driven.services,
            self.listener,
            self.driven.driver.time_gaps.normal,
            self.driven.end_program,
        )
        self._note_resets(self.driven.driver)
        self.odometry.invalidate()
        self.permission.driver_restarted()
        self.alive, self.driver_hangs = True, False
        self._seen_jumps = set()
        self.hung_until = self.now
        for client in self.clients.values():
            client.stream = None

    def _note_resets(self, driver: BaseDriver) -> None:
        """Lets the true pose begin at the origin whenever the driver sets its pose."""
        reset_pose = driver.reset_pose

        def reset(*pose: Pose2) -> None:
            reset_pose(*pose)
            self.odometry.restart(self.now)

        driver.reset_pose = reset  # type: ignore[method-assign]

    def _before_cycle(self, deadline: float) -> None:
        if self._stall:
            seconds, self._stall = self._stall, 0.0
            self._hang(seconds)
        self.permission.cycle_starts(self.now)

    def stall_while_sending(self) -> None:
        if self._stall_in_sending:
            seconds, self._stall_in_sending = self._stall_in_sending, 0.0
            permitted = self.permission.twist(self.now)
            self._hang(seconds)
            # No program can take back the frame that it is about to send when it is stopped.
            self._late_frame = wheel_speed(self.robot, permitted, *self.limits)
            self._late_frame_until = self.now + LATE_FRAME_TIME

    def _hang(self, seconds: float) -> None:
        self.driver_hangs = True
        self.timeline.run_until(self.timeline.now + to_ns(seconds))
        self.driver_hangs = False
        self.hung_until = self.now

    def _watch(self, driven: DrivenRobot, state: DriverState) -> None:
        now = self.now
        base_state, base_period = self.driven.base.state, driven.period
        self.cycles += 1
        settings = driven.driver.settings
        # After a limit was lowered, the robot ramps down to it.
        ramps = (settings.max_linear_acceleration, settings.max_angular_acceleration)
        new = (settings.max_linear_velocity, settings.max_angular_velocity)
        self.limits = tuple(
            max(limit, previous - 0.5 * ramp * base_period)
            for limit, previous, ramp in zip(new, self.limits, ramps, strict=True)
        )
        awaits_homing = not driven.base.is_homed or driven.base.is_homing
        self.permission.cycle_ends(now, base_state.drives, base_state.starts, awaits_homing)
        for number, problem in list(self.problems.items()):
            problem.noticed = problem.noticed or not base_state.drives
            if problem.ended and (problem.noticed or problem.kind not in LATCHED):
                del self.problems[number]
        axes = self.driven.base._axes
        self._seen_jumps |= {axis.actuator.name for axis in axes if axis.jump}
        homed = {axis.actuator.name for axis in axes if axis.homed and not axis.jump}
        self._jumped -= self._seen_jumps & homed
        self._seen_jumps -= homed
        for client in self.clients.values():
            client.notice_end()
        check_explored_permission(self, now)
        self.state_check.check(now)
        check_commands(self, now)
        self.odometry.check(now)

    def run_until(self, end: float, stop: Callable[[], bool] = lambda: False) -> None:
        """Runs the driver, or the robot alone, until a time (s) or until ``stop()`` is true."""
        while self.now < end - 1e-9 and not stop():
            if not self.alive:
                self.timeline.run_until(to_ns(end), lambda: bool(self._end) or stop())
            else:
                self.driven.run(end, watch=self._watch, stop=lambda: bool(self._end) or stop())
            how, self._end = self._end, ""
            if how == "start" and not self.alive:
                self.start_driver(self._start_wrong)
            elif how in ("end", "kill") and self.alive:
                self._end_driver(how)
            elif how == "flash" and not self.alive and self.technician is not None:
                self.technician.work()

    def _end_driver(self, how: str) -> None:
        if how == "end":
            self.permission.disarm()
            self.driven.shutdown()
        else:
            self.driven.close()
        self.alive, self.listener = False, None
        self.hung_until = self.now
        self.permission.driver_restarted()

    # -- the mission -------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Runs the start-up until the robot is ready; a person homes its steering."""
        self.simulated.power_on()
        self.start_driver()
        self.run_until(READY_TIME, lambda: self.driven.ready or not self.driven.base.is_homed)
        if not self.driven.ready:
            self.driven.home_steering()
        self.run_until(READY_TIME, lambda: self.driven.ready)
        assert self.driven.ready, self.describe()
        self.run_until(self.now + 0.1)

    def run(self, schedule: Schedule) -> dict[str, Any]:
        """Runs the mission and the recovery; returns numbers of the run."""
        if schedule.start != READY:
            self.simulated.power_on()
        if schedule.start == POWER_ON:
            self.start_driver()
        start = self.now
        self._note_stored()
        self._injector._random.seed(f"{schedule.seed}:chaos")
        self._monitor()
        for event in schedule.events:
            self.after(event.at, lambda event=event: self._act(event))  # type: ignore[misc]
        try:
            self.run_until(start + schedule.duration)
            self._recover()
            check_stored(self, self._stored)
        except Violation as violation:
            self.violation = self.violation or violation
        if self.violation is not None:
            # The time counts from the start of the mission, as that of the events.
            self.violation.time -= start
            raise self.violation
        return {"seconds": self.now - start, "cycles": self.cycles, "digest": self.digest()}

    def _note_stored(self) -> None:
        devices = self.simulated.devices
        self._stored = {name: deepcopy(device.nonvolatile) for name, device in devices.items()}

    def digest(self) -> str:
        """Returns a number that differs if anything on the buses differed."""
        wires = [(w.frames, w.errors, w.busy) for w in self.simulated.wires.values()]
        twist = self.truth.twist()
        self._digest.update(repr((self.timeline.now, wires, twist, self.odometry.pose)).encode())
        return self._digest.hexdigest()[:16]

    def _act(self, event: ChaosEvent) -> None:
        if self._recovering:
            return  # the mission has ended
        getattr(self, f"act_{event.act}")(**event.values)

    def client(self, name: str) -> ChaosClient:
        return self.clients.setdefault(name, ChaosClient(self, name))

    # -- acts --------------------------------------------------------------------------------------

    def act_call(self, client: str, service: str, arguments: dict[str, Any] | None = None) -> None:
        self.client(client).call(service, arguments or {})

    def act_drive(
        self,
        client: str,
        source: str,
        twist: list[float],
        seconds: float,
        rate: float = 20.0,
        held: bool = False,
    ) -> None:
        self.client(client).drive(source, twist, seconds, rate, held)

    def act_close(self, client: str) -> None:
        self.client(client).close()

    def act_hang(self, client: str) -> None:
        self.client(client).hang()

    def act_raw(self, client: str, text: str, times: int = 1) -> None:
        """Sends text that need not be a request."""
        self.client(client).reads = False
        for _ in range(times):
            self.client(client).send(text.encode())
        if times > 50:
            self.client(client).floods = True
            self.permission.flooding.add(self.client(client).connection)
        if text.startswith(TWIST_REQUEST):
            self.client(client).tell("twist", json.loads(text)["arguments"])

    def act_stall(self, seconds: float, sending: bool = False) -> None:
        if sending:
            self._stall_in_sending = seconds
        else:
            self._stall = seconds

    def act_end(self) -> None:
        self._end = "end"

    def act_kill(self) -> None:
        """Kills the program that controls the bus: the driver, or the flash of the technician."""
        if self.technician is not None and self.technician.busy:
            self.technician.kill()
        else:
            self._end = "kill"

    def act_flash(self) -> None:
        self._end = "flash"

    def act_start(self, wrong: bool = False) -> None:
        self._end, self._start_wrong = "start", wrong

    def act_clock_jump(self, seconds: float) -> None:
        for interface in self.interfaces.values():
            interface.jump(seconds)
        for problem in self.problems.values():
            # The driver counts reports by the times of their reception.
            if problem.kind == FALSE_REPORTS and problem.notice is not None:
                problem.notice += min(abs(seconds), LONGEST_JUMP)

    def act_master_bus_off(self, bus: str) -> None:
        if bus in self.interfaces and self.alive:
            self.interfaces[bus].controller.go_bus_off()
            self._open_problem(MASTER_BUS_OFF)

    def act_inject(
        self,
        kind: str,
        bus: str,
        node: str | None = None,
        seconds: float | None = None,
        **more: Any,
    ) -> None:
        if "data" in more:
            more["data"] = bytes.fromhex(more["data"])
        target = (kind, bus, node, more.get("channel"))
        if target in self._targets.values():
            return  # the end of the first of two equal faults would end both
        fault = BusFault(kind, bus, node, 0.0, None, SPAN, **more)
        remove = self._injector.start(fault)
        problem = problem_kind(self.robot, fault)
        number = self._open_problem(problem, notice_time(self.robot, problem, fault))
        if kind == "late_frames":
            self.problems[number].delay = fault.latency
        if kind == OBJECT_WRITTEN:
            written = self.simulated.devices[node or ""]
            assert isinstance(written, CanopenDevice)
            key = fault.index, fault.subindex
            self.problems[number].holds = lambda: (
                key in written.objects and written.objects[key].value == fault.value
            )
        tiny_deceleration = kind == OBJECT_WRITTEN and fault.value == 1
        if kind in DISOBEDIENT or tiny_deceleration:
            self.problems[number].delay = DISOBEDIENCE
        elif kind == PUSHED:
            self._pushes[number] = 1.1 * abs(fault.speed) * max(w.radius for w in self.robot.wheels)
        if kind == "encoder_jump":
            nodes = (n for b in self.robot.buses for n in b.nodes if n.name == node)
            channels = {c.name: c.actuator for c in next(nodes).channels}
            self._jumped.add(str(channels[more["channel"]]))
        self._targets[number] = target
        device = self.simulated.devices.get(node or "")
        original = device.nonvolatile.get("node_id") if device is not None else None
        if kind == "duplicate_id" and device is not None:
            original = next(
                n.id for b in self.robot.buses for n in b.nodes if n.name == device.name
            )

        def end() -> None:
            if self._ends.pop(number, None) is None:
                return
            remove()
            del self._targets[number]
            if number in self._pushes:
                self.after(PUSH_ENDS, lambda: self._pushes.pop(number, None))
            if kind == "duplicate_id" and device is not None and original is not None:
                device.change_node_id(original)
            self._close_problem(number)

        self._ends[number] = end
        if kind == "forged_frames" and self.problems[number].kind == SECOND_MASTER:
            self._forged_until = self.now + (seconds or 0.0) + 0.06
        if seconds is not None:
            self.after(seconds, end)

    def _open_problem(self, kind: str, notice: float | None = None) -> int:
        self._numbers += 1
        self.problems[self._numbers] = Problem(kind, self.now, notice)
        if kind in LYING:
            self.odometry.invalidate()
        return self._numbers

    def _close_problem(self, number: int) -> None:
        problem = self.problems.get(number)
        if problem is not None:
            problem.ended = True
            if not self.alive:
                del self.problems[number]

    # -- the recovery ----------------------------------------------------------------------------

    def _recover(self) -> None:
        """Ends all injected faults; a person resets and arms; the robot must drive again."""
        self._recovering = True
        self.act_end_faults()
        self._end = ""
        self.run_until(self.now + REST_TIME)
        if self.technician is not None:
            if self.alive:
                self._end_driver("end")
            self.technician.finish()
            self._note_stored()
        for attempt in range(RECOVERIES):
            if not self.alive:
                self._end, self._start_wrong = "start", False
                self.run_until(self.now + 0.04)
            if self._drives_again(attempt > 0):
                return
        raise Violation("recovery", self.now, f"the robot does not drive again: {self.describe()}")

    def act_end_faults(self) -> None:
        for end in list(self._ends.values()):
            end()
        for client in self.clients.values():
            client.close()

    def _drives_again(self, resets: bool) -> bool:
        """``resets``: the person resets a robot that is ready, too, as its arming is refused."""
        person = self.client("person")
        person.connect()
        for force in ({}, {"force": True}):
            person.call("release_safety_stop", force)
            for lock in self.robot.twist_locks:
                person.call("lock", {"name": lock.name, "locked": False, **force})
        if self.driven.robot is not self.robot:
            self._end = "end"
            self.run_until(self.now + CALL_TIME)
            return False
        self.run_until(self.now + CALL_TIME)
        if resets or not self.driven.base.state.drives:
            self._call(person, "reset_faults")
            self.run_until(
                self.now + READY_TIME,
                lambda: (
                    self.driven.ready
                    or self.driven.base.state.value in ("standby", "fault", "estop")
                ),
            )
        if self._jumped or not self.driven.base.is_homed:
            self._call(person, "home_steering")
            self.run_until(self.now + READY_TIME, lambda: self.driven.ready)
        self._call(person, "twist", source="teleop_joy")
        self._call(person, "arm")
        person.drive("teleop_joy", list(RECOVERY_TWIST), 2.0, 20.0)
        end = self.now + 2.0
        self.run_until(end, lambda: self.truth.twist().vx > RECOVERED_SPEED)
        return self.truth.twist().vx > RECOVERED_SPEED

    def _call(self, client: ChaosClient, service: str, **arguments: Any) -> None:
        client.call(service, arguments)
        self.run_until(self.now + CALL_TIME)
