"""Injects faults into simulated CAN buses, from a script or from a test."""

from __future__ import annotations

import random
from collections.abc import Callable

from thorvaldc.can.frame import CanFrame
from thorvaldc.can.nanoseconds import to_ns
from thorvaldc.model.bus_faults import BusFault, BusFaults
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.simulated_device import SimulatedDevice
from thorvaldc.simulation.bus.simulated_motors import Encoder, MotorModel
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.simulation.bus.timeline import Action

Listener = Callable[[float, BusFault, bool], None]
"""Function with the arguments time (s), injected fault, and ``True`` at the start of the fault.

The function is called at the start and at the end of an injected fault."""


class FaultInjector:
    """Schedules the injected faults of a script on the simulated buses of a robot.

    ``active`` has the injected faults that are in effect, ordered by start time.
    """

    def __init__(
        self, simulated: SimulatedRobot, script: BusFaults, listener: Listener | None = None
    ) -> None:
        self.simulated = simulated
        self.active: list[BusFault] = []
        self._listener = listener
        self._random = random.Random(f"{script.seed}:faults")
        for fault in script.faults:
            if fault.frame is not None:
                wire = simulated.wires[fault.bus]
                wire.at_frame(fault.frame, self._starter(fault, fault.delay))
            else:
                time = to_ns((fault.time or 0.0) + fault.delay)
                simulated.timeline.at(time, self._starter(fault, 0.0))

    def inject(self, fault: BusFault) -> None:
        """Starts an injected fault immediately."""
        self.active.append(fault)
        self._report(fault, True)
        remove = self._start(fault)
        if fault.duration is not None:
            timeline = self.simulated.timeline
            timeline.after(to_ns(fault.duration), lambda: self._end(fault, remove))

    def _starter(self, fault: BusFault, delay: float) -> Action:
        def act() -> None:
            if delay > 0.0:
                self.simulated.timeline.after(to_ns(delay), lambda: self.inject(fault))
            else:
                self.inject(fault)

        return act

    def _end(self, fault: BusFault, remove: Action) -> None:
        self.active = [f for f in self.active if f is not fault]
        remove()
        self._report(fault, False)

    def _report(self, fault: BusFault, begins: bool) -> None:
        if self._listener is not None:
            self._listener(self.simulated.timeline.seconds, fault, begins)

    # -- kinds of faults ----------------------------------------------------------------------

    def _start(self, fault: BusFault) -> Action:
        """Starts an injected fault and returns a function that removes the injected fault."""
        wire = self.simulated.wires[fault.bus]
        devices = self._devices(fault)
        if fault.kind == "power_cut":
            powered = [device for device in devices if device.powered]
            for device in powered:
                device.power_off()

            def restore_power() -> None:
                for device in powered:
                    device.power_on()

            return restore_power
        if fault.kind == "noise":
            wire.noise = fault.share

            def end_noise() -> None:
                wire.noise = 0.0

            return end_noise
        if fault.kind == "lost_frames":
            return self._drop_frames(fault, devices)
        return self._start_device_fault(fault, devices[0])

    def _start_device_fault(self, fault: BusFault, device: SimulatedDevice) -> Action:
        if fault.kind == "mute":
            return _set_flag(device, "muted")
        if fault.kind == "heartbeat_stop" and isinstance(device, CanopenDevice):
            return _set_flag(device, "heartbeat_stopped")
        if fault.kind == "emcy" and isinstance(device, CanopenDevice):
            device.emergency(fault.code, fault.register)
        elif fault.kind == "duplicate_id":
            device.change_node_id(fault.id)
        elif fault.kind == "bus_off":
            device.controller.go_bus_off()
        elif fault.kind == "wrong_bitrate":
            bitrate = device.controller.bitrate
            device.change_bitrate(fault.bitrate)
            return lambda: device.change_bitrate(bitrate)
        elif fault.kind == "frozen_encoder":
            encoder, _ = self._channel_motor(device, fault.channel)
            return _set_flag(encoder, "frozen") if encoder is not None else _nothing
        elif fault.kind == "blocked_motor":
            _, motor = self._channel_motor(device, fault.channel)
            return _set_flag(motor, "blocked") if motor is not None else _nothing
        elif fault.kind == "babble":
            return self._babble(fault, device)
        return _nothing

    def _devices(self, fault: BusFault) -> list[SimulatedDevice]:
        if fault.node is not None:
            return [self.simulated.devices[fault.node]]
        wire = self.simulated.wires[fault.bus]
        return [d for d in self.simulated.devices.values() if d.wire is wire]

    def _channel_motor(
        self, device: SimulatedDevice, channel: str
    ) -> tuple[Encoder | None, MotorModel | None]:
        return device.channel_motor(self._channel_index(device.name, channel))

    def _channel_index(self, node_name: str, channel: str) -> int:
        for bus in self.simulated.robot.buses:
            for node in bus.nodes:
                if node.name == node_name:
                    return [c.name for c in node.channels].index(channel)
        raise KeyError(node_name)

    def _drop_frames(self, fault: BusFault, devices: list[SimulatedDevice]) -> Action:
        def accepts(frame: CanFrame) -> bool:
            affected = fault.cob_id is None or frame.id == fault.cob_id
            return not (affected and self._random.random() < fault.share)

        for device in devices:
            device.controller.accepts = accepts

        def remove_filter() -> None:
            for device in devices:
                device.controller.accepts = None

        return remove_filter

    def _babble(self, fault: BusFault, device: SimulatedDevice) -> Action:
        frame = CanFrame(fault.cob_id or 0, bytes(8))
        babbling = True

        def repeat() -> None:
            if babbling and device.powered:
                device.controller.send(frame)
                self.simulated.timeline.after(to_ns(fault.period), repeat)

        def stop() -> None:
            nonlocal babbling
            babbling = False

        repeat()
        return stop


def _set_flag(device: object, name: str) -> Action:
    setattr(device, name, True)
    return lambda: setattr(device, name, False)


def _nothing() -> None:
    """Does nothing at the end of an injected fault without duration, such as an EMCY message."""
