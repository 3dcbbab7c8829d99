"""Duration of a flash of four new drives on a simulated bus, in virtual time."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bench.figure import Figure, in_turns

ROBOT = """
thorvaldc: 1
name: four_drives
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m, height: 650 mm}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, params: &p
    {controller: controller/cia402_propulsion_steering}, can: {id: 1, serial: "0x101"}}
  fr: {type: assembly/steered_drive, mount: frame.front_right, params: *p,
    can: {id: 2, serial: "0x102"}}
  rl: {type: assembly/steered_drive, mount: frame.rear_left, params: *p,
    can: {id: 3, serial: "0x103"}}
  rr: {type: assembly/steered_drive, mount: frame.rear_right, params: *p,
    can: {id: 4, serial: "0x104"}}
"""
SWAPPED = {"fl_controller": {"node_id": 2}, "fr_controller": {"node_id": 1}}
ROUNDS = 5


def figures() -> Iterator[Figure]:
    from thorvaldc.commissioning.bus_configuration import configuration_of
    from thorvaldc.commissioning.bus_master import BusMaster
    from thorvaldc.commissioning.flash import Flash
    from thorvaldc.commissioning.journal import Journal, JournalFile
    from thorvaldc.compiler.pipeline import compile_file
    from thorvaldc.model import Robot
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "robot.yaml").write_text(ROBOT, encoding="utf-8")
        robot = compile_file(folder / "robot.yaml").model
        if not isinstance(robot, Robot):
            raise TypeError("the robot of the bench does not compile")
        bus = robot.buses[0]
        results: list[tuple[float, int, float]] = []

        def flash() -> None:
            simulated = SimulatedRobot(robot, delivered=True, nonvolatile=SWAPPED)
            simulated.power_on()
            simulated.run(0.2)
            start_time, start_frames = simulated.timeline.seconds, simulated.wire().frames
            store = JournalFile(folder / f"{len(results)}.flash.jsonl")
            master = BusMaster(simulated.interface(receive_limit=100_000), bus)
            start = time.perf_counter()
            plan = Flash(master, configuration_of(robot, bus), Journal(store)).apply()
            wall = time.perf_counter() - start
            store.close()
            if len(plan.steps) != 9:
                raise RuntimeError(
                    "unexpected plan: four new drives, two of them exchanged, need 9 steps"
                )
            results.append(
                (
                    simulated.timeline.seconds - start_time,
                    simulated.wire().frames - start_frames,
                    wall,
                )
            )

        (times,) = in_turns(flash, rounds=ROUNDS)
    virtual, frames, wall = results[-1]
    yield Figure(
        "flash of four drives",
        statistics.median(times),
        "s",
        None,
        "lower",
        f"two new, two exchanged, 72 values each; {virtual:.1f} s of bus time, {frames} frames, "
        f"journal on the disk {wall:.2f} s in real time; median of {ROUNDS}",
    )
