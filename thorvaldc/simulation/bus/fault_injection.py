"""FaultInjector of a simulated bus: struck when a script says so, or at once."""

from __future__ import annotations

import random
from collections.abc import Callable

from thorvaldc.can.frame import CanFrame
from thorvaldc.can.nanoseconds import to_ns
from thorvaldc.model.bus_faults import BusFault, BusFaults
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.cia402_device import Cia402Drive
from thorvaldc.simulation.bus.roboteq_device import RoboteqController
from thorvaldc.simulation.bus.simulated_device import SimulatedDevice
from thorvaldc.simulation.bus.simulated_motors import Encoder, MotorModel
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.simulation.bus.timeline import Action

Tell = Callable[[float, BusFault, bool], None]
"""Told of each fault at its time (s): that it begins (``True``) or ends."""


class FaultInjector:
    """Plans a script's faults on a robot's buses.

    ``active`` are those under way, in the order in which they began.
    """

    def __init__(
        self, simulated: SimulatedRobot, script: BusFaults, tell: Tell | None = None
    ) -> None:
        self.simulated = simulated
        self.active: list[BusFault] = []
        self._tell = tell
        self._random = random.Random(f"{script.seed}:faults")
        for fault in script.faults:
            if fault.frame is not None:
                wire = simulated.wires[fault.bus]
                wire.at_frame(fault.frame, self._later(fault, fault.delay))
            else:
                time = to_ns((fault.time or 0.0) + fault.delay)
                simulated.timeline.at(time, self._later(fault, 0.0))

    def strike(self, fault: BusFault) -> None:
        """Let it happen now."""
        self.active.append(fault)
        self._say(fault, True)
        mend = self._begin(fault)
        if fault.duration is not None:
            timeline = self.simulated.timeline
            timeline.after(to_ns(fault.duration), lambda: self._end(fault, mend))

    def _later(self, fault: BusFault, delay: float) -> Action:
        def act() -> None:
            if delay > 0.0:
                self.simulated.timeline.after(to_ns(delay), lambda: self.strike(fault))
            else:
                self.strike(fault)

        return act

    def _end(self, fault: BusFault, mend: Action) -> None:
        self.active = [f for f in self.active if f is not fault]
        mend()
        self._say(fault, False)

    def _say(self, fault: BusFault, begins: bool) -> None:
        if self._tell is not None:
            self._tell(self.simulated.timeline.seconds, fault, begins)

    # -- what happens ----------------------------------------------------------------------

    def _begin(self, fault: BusFault) -> Action:
        """Let it happen; returns what ends it."""
        wire = self.simulated.wires[fault.bus]
        devices = self._devices(fault)
        if fault.kind == "power_cut":
            cut = [device for device in devices if device.powered]
            for device in cut:
                device.power_off()
            return lambda: _all(cut, SimulatedDevice.power_on)
        if fault.kind == "noise":
            wire.noise = fault.share

            def clear() -> None:
                wire.noise = 0.0

            return clear
        if fault.kind == "lost_frames":
            return self._lose(fault, devices)
        return self._begin_of(fault, devices[0])

    def _begin_of(self, fault: BusFault, device: SimulatedDevice) -> Action:
        """A fault of one device."""
        if fault.kind == "mute":
            return _switched(device, "muted")
        if fault.kind == "heartbeat_stop" and isinstance(device, CanopenDevice):
            return _switched(device, "heartbeat_stopped")
        if fault.kind == "emcy" and isinstance(device, CanopenDevice):
            device.emergency(fault.code, fault.register)
        elif fault.kind == "duplicate_id":
            device.change_node_id(fault.id)
        elif fault.kind == "bus_off":
            device.controller.go_bus_off()
        elif fault.kind == "wrong_bitrate":
            before = device.controller.bitrate
            device.change_bitrate(fault.bitrate)
            return lambda: device.change_bitrate(before)
        elif fault.kind == "frozen_encoder":
            encoder, _ = self._motor(device, fault.channel)
            return _switched(encoder, "frozen") if encoder is not None else _nothing
        elif fault.kind == "blocked_motor":
            _, motor = self._motor(device, fault.channel)
            return _switched(motor, "blocked") if motor is not None else _nothing
        elif fault.kind == "babble":
            return self._babble(fault, device)
        return _nothing

    def _devices(self, fault: BusFault) -> list[SimulatedDevice]:
        if fault.node is not None:
            return [self.simulated.devices[fault.node]]
        wire = self.simulated.wires[fault.bus]
        return [d for d in self.simulated.devices.values() if d.wire is wire]

    def _motor(
        self, device: SimulatedDevice, channel: str
    ) -> tuple[Encoder | None, MotorModel | None]:
        place = self._channel(device.name, channel)
        if isinstance(device, RoboteqController) and place < 2:
            found = device.channels[place]
            return found.encoder, found.motor
        if isinstance(device, Cia402Drive) and place < len(device.axes):
            axis = device.axes[place]
            return axis.encoder, axis.motor
        return None, None

    def _channel(self, node: str, channel: str) -> int:
        for bus in self.simulated.robot.buses:
            for found in bus.nodes:
                if found.name == node:
                    return [c.name for c in found.channels].index(channel)
        raise KeyError(node)

    def _lose(self, fault: BusFault, devices: list[SimulatedDevice]) -> Action:
        def accepts(frame: CanFrame) -> bool:
            hit = fault.cob_id is None or frame.id == fault.cob_id
            return not (hit and self._random.random() < fault.share)

        for device in devices:
            device.controller.accepts = accepts

        def mend() -> None:
            for device in devices:
                device.controller.accepts = None

        return mend

    def _babble(self, fault: BusFault, device: SimulatedDevice) -> Action:
        frame = CanFrame(fault.cob_id or 0, bytes(8))
        going = True

        def again() -> None:
            if going and device.powered:
                device.controller.send(frame)
                self.simulated.timeline.after(to_ns(fault.period), again)

        def stop() -> None:
            nonlocal going
            going = False

        again()
        return stop


def _switched(thing: object, name: str) -> Action:
    setattr(thing, name, True)
    return lambda: setattr(thing, name, False)


def _all(devices: list[SimulatedDevice], what: Callable[[SimulatedDevice], None]) -> None:
    for device in devices:
        what(device)


def _nothing() -> None:
    """Some faults are over when they have happened."""
