"""Simulated hours in which the supervision of the motion may see no fault.

``python -m bench.supervision [HOURS [SEED]]`` drives all examples on their buses over kerbs, on
rough ground, on their design slopes and against the limits of their torques; 20 hours take some
hours of processor time.
"""

from __future__ import annotations

import itertools
import math
import random
import re
import shutil
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from bench.figure import ROOT, Figure
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Fleet, ObjectValue, Robot
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.bus.cia402_device import Cia402Drive
from thorvaldc.simulation.bus.roboteq_device import RoboteqController
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

GROUP = "long"

EXAMPLES = sorted(path.parent.name for path in (ROOT / "examples").glob("[0-9]*/robot.yaml"))
CIA402 = "4wd4ws_slim"
"""Example that also runs with CiA 402 drives."""
KERB = "{from: [%g, -30], to: [%g, 30], height: 40 mm}"
WORLDS = {
    "kerbs": "kerbs: [" + ", ".join(KERB % (x, x) for x in (-3.0, 2.0, 4.0)) + "]",
    "rough": "ground: {type: rough, amplitude: 40 mm, wavelength: 600 mm, seed: 3, size: [60, 60]}",
    "slope": "ground: {type: slope, angle: %g, direction: %g deg}",
    "steep": "ground: {type: slope, angle: %g, direction: 0}, friction: 1.2",
}
STEEP = 1.2
"""Slope of the world ``steep`` as a multiple of the design slope.

The torques saturate on it, but the robots still hold.  On 1.6 times their design slope some of them
roll back, which is a fault."""
DEVICE_PERIOD = 0.01
"""Period (s) of the control loops of the drives, longer than usual to save time."""
PRESENT_POSITION = 37
"""Homing method of CiA 402 that takes the present position as home."""
MISSION = 30.0
"""Duration (s) of a drive on one ground."""
SHORT = 0.05
"""Simulated hours of ``python -m bench``."""


def figures() -> Iterator[Figure]:
    faults, hours = drive(SHORT, 0)
    yield Figure(
        "faults of the motion supervision",
        len(faults),
        "",
        0.0,
        "lower",
        f"in {hours:.2f} simulated hours of all examples on kerbs, rough ground and slopes",
    )


def drive(hours: float, seed: int, *, verbose: bool = False) -> tuple[list[str], float]:
    """Drives the examples in turn; returns the faults and the simulated hours."""
    draw = random.Random(seed)
    variants = [(CIA402, True)] + [(name, False) for name in EXAMPLES]
    faults: list[str] = []
    driven = 0.0
    for (name, cia402), world in itertools.cycle(itertools.product(variants, WORLDS)):
        if driven >= hours * 3600.0:
            return faults, driven / 3600.0
        seconds, fault = _mission(name, cia402, world, draw)
        driven += seconds
        label = f"{name}{' CiA 402' if cia402 else ''} on {world}"
        # A drive may report a fault of its own, such as a motor that stalls at a kerb.
        if "follow" in fault or "stand" in fault or "cut the power" in fault:
            faults.append(f"{label}: {fault}")
        if verbose:
            print(f"{driven / 3600.0:7.3f} h  {label}  {fault}", flush=True)
    raise AssertionError("there is no example")


def _mission(name: str, cia402: bool, world: str, draw: random.Random) -> tuple[float, str]:
    """Drives one example on one ground; returns the duration (s) and the reason of a fault."""
    with TemporaryDirectory() as folder:
        copy = Path(shutil.copytree(ROOT / "examples" / name, Path(folder, name)))
        fleet = _fleet(copy, cia402, world, draw)
    robot = _with_quick_homing(fleet.placements[0].robot)
    base = MujocoBase(robot, MujocoScene(emit(fleet, ["mjcf"])), "robot/")
    simulated = SimulatedRobot(robot, seed=draw.randrange(1 << 30), base=base)
    for device in simulated.devices.values():
        if isinstance(device, Cia402Drive):
            device.control_period = DEVICE_PERIOD
        elif isinstance(device, RoboteqController):
            device.loop_period = DEVICE_PERIOD
    simulated.power_on()
    interfaces = {bus.name: simulated.interface(bus.name, fifo=True) for bus in robot.buses}
    can_base = CanBase(robot, interfaces, threaded=False)
    clock = interfaces[robot.buses[0].name]
    runner: DrivenRobot = DrivenRobot(robot, can_base, clock)
    twist = ZERO_TWIST

    def feed(driver: BaseDriver, now: float) -> None:
        driver.command(twist, now)

    runner.feed = feed
    start = clock.now
    runner.run(start + 60.0, stop=lambda: runner.ready or runner.state is BaseState.FAULT)
    runner.run(clock.now + 0.2)
    if runner.ready:
        runner.arm()
    end = clock.now + MISSION
    settings = robot.driver
    while clock.now < end and runner.state is not BaseState.FAULT:
        speed = draw.uniform(-1.0, 1.0) * settings.max_linear_velocity
        rate = draw.choice((0.0, 0.0, draw.uniform(-0.5, 0.5) * settings.max_angular_velocity))
        side = draw.choice((0.0, 0.0, 0.3 * speed))
        seconds = draw.uniform(1.5, 5.0)
        for part in (Twist(speed, side, rate), Twist(-speed, -side, rate), ZERO_TWIST):
            twist = part
            runner.run(clock.now + seconds, stop=lambda: runner.state is BaseState.FAULT)
    machine = can_base.state_machine
    reason = machine.reason if runner.state is BaseState.FAULT else ""
    return clock.now - start, reason


def _fleet(folder: Path, cia402: bool, world: str, draw: random.Random) -> Fleet:
    text = (folder / "robot.yaml").read_text(encoding="utf-8")
    if cia402:
        text = re.sub(
            r"(type: assembly/steered_drive.*?)(, params: \{(.*?)\})?\}\n",
            lambda m: (
                f"{m[1]}, params: {{controller: controller/cia402_propulsion_steering"
                f"{', ' + m[3] if m[3] else ''}}}}}\n"
            ),
            text,
        )
    (folder / "robot.yaml").write_text(text, encoding="utf-8")
    match = re.search(r"slope: ([0-9.]+) deg", text)
    slope = math.radians(float(match[1])) if match else 0.0
    ground = WORLDS[world]
    if world == "slope":
        ground %= (slope, draw.choice((0, 45, 90, 180)))
    elif world == "steep":
        ground %= STEEP * slope
    (folder / "study.yaml").write_text(
        "thorvaldc: 1\nscenario: study\nduration: 1 s\nrobots: {robot: {robot: robot.yaml}}\n"
        f"world: {{{ground}}}\n",
        encoding="utf-8",
    )
    compilation = compile_file(folder / "study.yaml")
    if compilation.scenario is None:
        raise SystemExit("; ".join(d.message for d in compilation.report))
    return compilation.scenario.fleet


def _with_quick_homing(robot: Robot) -> Robot:
    """Returns the robot with CiA 402 drives that home at the present angle 0, to save time."""

    def changed(entry: ObjectValue) -> ObjectValue:
        if entry.name.endswith("_homing_method"):
            return replace(entry, value=PRESENT_POSITION)
        return replace(entry, value=0) if entry.name.endswith("_home_offset") else entry

    buses = tuple(
        replace(
            bus,
            nodes=tuple(replace(n, objects=tuple(map(changed, n.objects))) for n in bus.nodes),
        )
        for bus in robot.buses
    )
    return replace(robot, buses=buses)


def main() -> int:
    hours = float(sys.argv[1]) if len(sys.argv) > 1 else SHORT
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    faults, driven = drive(hours, seed, verbose=True)
    print(f"{len(faults)} faults in {driven:.2f} simulated hours")
    for fault in faults:
        print(fault)
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
