"""Simulated robots that are assembled wrongly, and what the checks must find."""

from __future__ import annotations

import dataclasses
import math
import random
import re
from collections.abc import Callable
from dataclasses import dataclass, field

from thorvaldc.commissioning.commission_report import Finding
from thorvaldc.commissioning.commission_report import driven_joints as joints
from thorvaldc.model import Robot
from thorvaldc.simulation.bus.motor_wiring import Wiring
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.simulation.physics.sim_base import SimulatedJoints
from thorvaldc.tools.commission.assembly_findings import findings
from thorvaldc.tools.commission.motor_checks import MotorChecks, largest_speed
from thorvaldc.tools.commission.motor_session import MotorSession
from thorvaldc.tools.commission.results import MotorResult
from thorvaldc.tools.commission.simulated_operator import SimulatedOperator

EXCHANGED, REVERSED, ENCODER_REVERSED = "are exchanged: each", "the wrong way", "counts against"
ENCODERS, WATCHDOG = "encoders of", "watchdog"
SCALE, ZERO = "in place of|the homing of", "off straight ahead|the homing of"
"""A drive that homes at a limit switch does not get there with a wrong scale, or if the switch is
beyond the mechanical stop."""


@dataclass
class Assembly:
    """What is wrong with a robot.

    - ``channels``: joint that each channel moves, ``encoders``: joint that it measures, by motor;
    - ``joints``: direction, scale and zero of the joints, by motor;
    - ``dead``: controllers whose watchdog does not act;
    - ``expected``: text and motors of each finding that must be there.
    """

    robot: Robot
    channels: dict[str, str] = field(default_factory=dict)
    encoders: dict[str, str] = field(default_factory=dict)
    joints: dict[str, Wiring] = field(default_factory=dict)
    dead: list[str] = field(default_factory=list)
    expected: list[tuple[str, frozenset[str]]] = field(default_factory=list)

    @property
    def wiring(self) -> dict[str, Wiring]:
        wiring = {}
        for name in {*self.channels, *self.encoders, *self.joints}:
            joint = self.channels.get(name, name)
            own = self.joints.get(joint, Wiring())
            wiring[name] = own._replace(motor=joint, encoder=self.encoders.get(name, ""))
        for channel, joint in self.channels.items():
            assert channel in wiring
            assert joint in {j.name for j in joints(self.robot)}
        return wiring


def wrong_assembly(robot: Robot, seed: int) -> Assembly:
    """Returns a robot with one or two random errors at different motors."""
    rng = random.Random(seed)
    assembly = Assembly(robot)
    free = [motor.name for motor in joints(robot)]
    rng.shuffle(free)
    for _ in range(rng.choice((1, 1, 2))):
        _add_error(assembly, free, rng)
    return assembly


def _add_error(assembly: Assembly, free: list[str], rng: random.Random) -> None:
    motors = {motor.name: motor for motor in joints(assembly.robot)}
    if not free:
        return
    kinds = [REVERSED, ENCODER_REVERSED, SCALE]
    kinds += [EXCHANGED, EXCHANGED, ENCODERS] * (len(free) > 1)
    kinds += [ZERO] * (motors[free[0]].role == "steering")
    kinds += [WATCHDOG] * (motors[free[0]].role == "propulsion")
    kind = rng.choice(kinds)
    name = free.pop(0)
    blamed = {name}
    if kind == REVERSED:
        assembly.joints[name] = Wiring(direction=-1)
    elif kind == ENCODER_REVERSED:
        assembly.joints[name] = Wiring(encoder_scale=-1.0)
    elif kind == SCALE:
        assembly.joints[name] = Wiring(encoder_scale=rng.choice((0.25, 0.5, 0.75, 1.5, 2.0, 4.0)))
    elif kind == ZERO:
        degrees = rng.choice((-1, 1)) * rng.uniform(5.0, 40.0)
        assembly.joints[name] = Wiring(zero=math.radians(degrees))
    elif kind == WATCHDOG:
        assembly.dead.append(str(motors[name].node))
        # The first wheel of a controller is the one that is stopped by the watchdog.
        free[:] = [other for other in free if motors[other].node != motors[name].node]
        for other in motors.values():
            if other.node == motors[name].node and other.role == "propulsion":
                blamed.add(other.name)
    else:
        other = free.pop(0)
        blamed.add(other)
        wires = assembly.channels if kind == EXCHANGED else assembly.encoders
        wires.update({name: other, other: name})
    assembly.expected.append((kind, frozenset(blamed)))


@dataclass
class Outcome:
    """Result of the checks of a simulated robot.

    - ``excess``: largest speed (rad/s) of a joint beyond the stated one of its time.
    - ``moving``: joints that move at the end.
    """

    session: MotorSession
    checks: MotorChecks
    results: dict[str, MotorResult]
    found: list[Finding]
    excess: float
    moving: list[str]

    def passed(self, name: str) -> bool:
        """Checks whether a motor has passed."""
        result = self.results[name]
        blamed = any(name in finding.motors for finding in self.found)
        figures = all(figure.passed for figure in result.figures)
        return figures and not blamed and not result.skipped


def run_checks(
    assembly: Assembly,
    *,
    base: SimulatedJoints | None = None,
    devices: Robot | None = None,
    person: type[SimulatedOperator] = SimulatedOperator,
    prepare: Callable[[SimulatedRobot], object] = lambda simulated: None,
    stop: Callable[[SimulatedRobot, MotorSession], object] = lambda simulated, session: False,
) -> Outcome:
    """Runs the checks of a robot.

    - ``devices``: robot whose devices are on the bus, if they are not those of the file;
    - ``person``: operator beside the robot;
    - ``prepare``: called with the simulated robot;
    - ``stop``: called in each cycle with the simulated robot, ends the checks if it returns true.
    """
    robot = assembly.robot
    simulated = SimulatedRobot(devices or robot, wiring=assembly.wiring, base=base)
    simulated.power_on()
    simulated.run(0.5)
    for node in assembly.dead:
        simulated.devices[node].lose_watchdog()
    prepare(simulated)
    interfaces = {bus.name: simulated.interface(bus.name, fifo=True) for bus in robot.buses}
    session = MotorSession(robot, interfaces, threaded=False)
    results: dict[str, MotorResult] = {}
    checks = MotorChecks(session, person(simulated), results)
    excess = -math.inf
    stated = max(largest_speed(axis, session.base) for axis in session.base.axes)

    def watch() -> bool:
        nonlocal excess
        now = simulated.timeline.seconds
        driven = [axis for axis in session.base.axes if axis.powered]
        limit = largest_speed(driven[0], session.base) if driven else stated
        fastest = max(abs(motor.read(now).velocity) for motor in simulated.motors.values())
        excess = max(excess, fastest - limit)
        return bool(stop(simulated, session))

    session.run(checks.run(), stop=watch)
    simulated.run(2.0)
    now = simulated.timeline.seconds
    moving = [n for n, m in simulated.motors.items() if abs(m.read(now).velocity) > 0.02]
    return Outcome(session, checks, results, findings(robot, results), excess, moving)


def has_lost_watchdog(outcome: Outcome) -> bool:
    """Checks whether the base has named a drive without watchdog by its value (object 0x1016)."""
    return "heartbeat_consumer_time" in outcome.checks.interruption


def problems(assembly: Assembly, outcome: Outcome) -> list[str]:
    """Returns what the checks have not found, or have found where nothing is wrong."""
    interruption = outcome.checks.interruption
    named_by_value = has_lost_watchdog(outcome)
    texts = []
    for kind, blamed in assembly.expected:
        if not (kind == WATCHDOG and named_by_value) and not any(
            re.search(kind, f.text) and set(f.motors) <= blamed for f in outcome.found
        ):
            texts.append(f"not found: {kind} {sorted(blamed)}")
    right = {m.name for m in joints(assembly.robot)} - {
        name for _, blamed in assembly.expected for name in blamed
    }
    texts += [f"blamed: {f}" for f in outcome.found if set(f.motors) & right]
    if interruption and not named_by_value:
        texts.append(f"interrupted: {interruption}")
    if outcome.excess > 0.0:
        texts.append(f"faster than stated by {outcome.excess} rad/s")
    return [*texts, *(f"moves at the end: {name}" for name in outcome.moving)]


def with_encoder(robot: Robot, name: str, pulses: int) -> Robot:
    """Returns a robot whose motor ``name`` has another encoder, such as the drive of another."""
    actuators = tuple(
        dataclasses.replace(a, encoder_ppr=pulses) if a.name == name else a for a in robot.actuators
    )
    return dataclasses.replace(robot, actuators=actuators)
