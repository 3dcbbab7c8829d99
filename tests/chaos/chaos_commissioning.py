"""A technician who commissions the buses of a robot while devices and programs fail."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from tests.chaos.invariants import Violation
from tests.commissioning.bench import QUICK, Dead, MemoryStorage, MortalInterface, Watch
from thorvaldc.commissioning.bus_configuration import configuration_of
from thorvaldc.commissioning.bus_master import BusMaster
from thorvaldc.commissioning.flash import Flash
from thorvaldc.commissioning.journal import Journal
from thorvaldc.commissioning.planner import make_plan
from thorvaldc.commissioning.scanner import Scanner
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Bus, Robot
from thorvaldc.simulation.bus.canopen_device import CanopenDevice

if TYPE_CHECKING:
    from tests.chaos.chaos_world import ChaosWorld

IDS = (1, 2, 3, 9, 30, 77, 112, 126)
WITHOUT_ID = 255
SHARE_WITHOUT_ID = 0.25
TRIES = 6
"""Largest number of flashes after the last injected fault."""


def delivered_ids(robot: Robot, seed: int) -> dict[str, dict[str, int]]:
    """Returns different random node ids for the motor controllers; some have no id."""
    draw = random.Random(f"ids {seed}")
    names = [node.name for bus in robot.buses for node in bus.nodes if node.channels]
    return {
        name: {"node_id": WITHOUT_ID if draw.random() < SHARE_WITHOUT_ID else node_id}
        for name, node_id in zip(names, draw.sample(IDS, len(names)), strict=True)
    }


class Technician:
    """Runs ``can flash`` on each bus, in a process that can be killed.

    Each flash that was interrupted is resumed by the next call of ``work``.
    """

    def __init__(self, world: ChaosWorld) -> None:
        self.world = world
        self.busy = False
        self._interface: MortalInterface | None = None
        self._storages = {bus.name: MemoryStorage() for bus in world.robot.buses}
        devices = world.simulated.devices.values()
        self._watch = Watch([d for d in devices if isinstance(d, CanopenDevice)], still=False)

    def kill(self) -> None:
        if self._interface is not None:
            self._interface.dead = True

    def work(self) -> None:
        """Flashes all buses; a refusal ends the work, and the next call tries again."""
        self.busy = True
        try:
            for bus in self.world.robot.buses:
                self._flash(bus)
        except (DiagnosticError, Dead):
            pass
        finally:
            self.busy = False
        self._check_ids()

    def finish(self) -> None:
        """Flashes until each bus is as the robot file states.

        Raises ``Violation`` if this needs more than ``TRIES`` flashes.
        """
        remaining = ""
        for _ in range(TRIES):
            self.work()
            remaining = self._remaining()
            if not remaining:
                return
        raise Violation("commissioning", self.world.now, f"not finished: {remaining}")

    def _flash(self, bus: Bus) -> None:
        master = self._master(bus)
        try:
            journal = Journal(self._storages[bus.name])
            flash = Flash(master, configuration_of(self.world.robot, bus), journal)
            if journal.unfinished is None:
                flash.apply()
            else:
                flash.resume()
        finally:
            master.interface.close()

    def _remaining(self) -> str:
        """Returns the first step that is left to do on a bus, or why there is no plan."""
        for bus in self.world.robot.buses:
            if Journal(self._storages[bus.name]).unfinished is not None:
                return f"the journal of `{bus.name}`"
            master = self._master(bus)
            try:
                configuration = configuration_of(self.world.robot, bus)
                plan = make_plan(configuration, Scanner(master, configuration).active())
                if plan.steps:
                    return str(plan.steps[0])
            except DiagnosticError as error:
                return str(error)
            finally:
                master.interface.close()
        return ""

    def _master(self, bus: Bus) -> BusMaster:
        wire = self.world.simulated.wire(bus.name)
        self._interface = MortalInterface(wire, "master", receive_limit=100_000)
        return BusMaster(self._interface, bus, QUICK)

    def _check_ids(self) -> None:
        if self._watch.doubles:
            raise Violation("node id", self.world.now, "; ".join(self._watch.doubles))
