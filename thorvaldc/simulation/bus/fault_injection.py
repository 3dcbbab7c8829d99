"""Injects faults into simulated CAN buses, from a script or from a test."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import partial

from thorvaldc.can.frame import CanFrame, to_ns
from thorvaldc.can.frame_bits import frame_bits
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.simulated_device import SimulatedDevice
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.simulation.bus.timeline import Action
from thorvaldc.simulation.bus.wire import CanController

_CANOPEN_FLAGS = {
    "heartbeat_stop": "heartbeat_stopped",
    **{
        kind: kind for kind in ("commands_ignored", "sync_ignored", "nmt_ignored", "frozen_reports")
    },
}
"""Flags of a ``CanopenDevice`` by the kind of the fault that sets them."""
_DISTURBANCES = {"pushed_motor": "push", "runaway_motor": "runaway"}
"""Arguments of ``MotorModel.disturb`` by the kind of the fault."""
Removal = Callable[[], object]
"""Function that ends a fault."""
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
        remove = self.start(fault)
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

    def _end(self, fault: BusFault, remove: Removal) -> None:
        self.active = [f for f in self.active if f is not fault]
        remove()
        self._report(fault, False)

    def _report(self, fault: BusFault, begins: bool) -> None:
        if self._listener is not None:
            self._listener(self.simulated.timeline.seconds, fault, begins)

    # -- kinds of faults ----------------------------------------------------------------------

    def start(self, fault: BusFault) -> Removal:
        """Starts an injected fault, and returns the function that ends it."""
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
            return _set(wire, "noise", fault.share, 0.0)
        if fault.kind in ("lost_frames", "late_frames", "repeated_frames"):
            return self._filter_frames(fault, None if fault.node is None else devices[0])
        if fault.kind == "forged_frames":
            return self._forge(fault)
        return self._start_device_fault(fault, devices[0])

    def _start_device_fault(self, fault: BusFault, device: SimulatedDevice) -> Removal:
        if fault.kind == "mute":
            return _set(device, "muted")
        if isinstance(device, CanopenDevice) and fault.kind in _CANOPEN_FLAGS:
            return _set(device, _CANOPEN_FLAGS[fault.kind])
        if fault.kind == "emcy" and isinstance(device, CanopenDevice):
            device.emergency(fault.code, fault.register)
        elif fault.kind == "duplicate_id":
            device.change_node_id(fault.id)
        elif fault.kind == "clone":
            return self._clone(device)
        elif fault.kind == "watchdog_lost":
            device.lose_watchdog()
        elif fault.kind == "object_written":
            key = fault.index, fault.subindex
            previous = device.overwrite_object(*key, fault.value)
            if previous is not None:
                return partial(device.overwrite_object, *key, previous)
        elif fault.kind == "battery_charge":
            charge = device.set_charge(fault.charge)
            return partial(device.set_charge, charge)
        elif fault.kind == "bus_off":
            device.controller.go_bus_off()
        elif fault.kind == "wrong_bitrate":
            bitrate = device.controller.bitrate
            device.change_bitrate(fault.bitrate)
            return lambda: device.change_bitrate(bitrate)
        elif fault.kind == "babble":
            return self._babble(fault, device)
        elif fault.channel:
            return self._start_channel_fault(fault, device)
        return _nothing

    def _start_channel_fault(self, fault: BusFault, device: SimulatedDevice) -> Removal:
        encoder, motor = device.channel_motor(self._channel_index(device.name, fault.channel))
        if encoder is not None and fault.kind == "encoder_jump":
            encoder.jump(fault.angle if motor is None else motor.direction * fault.angle)
        elif encoder is not None and fault.kind == "frozen_encoder":
            return _set(encoder, "frozen")
        elif motor is not None and fault.kind == "blocked_motor":
            return _set(motor, "blocked")
        elif motor is not None and fault.kind in _DISTURBANCES:
            speed = motor.direction * fault.speed  # of the joint
            motor.disturb(device.now, **{_DISTURBANCES[fault.kind]: speed})
            return lambda: motor.disturb(device.now)
        return _nothing

    def _devices(self, fault: BusFault) -> list[SimulatedDevice]:
        if fault.node is not None:
            return [self.simulated.devices[fault.node]]
        wire = self.simulated.wires[fault.bus]
        return [d for d in self.simulated.devices.values() if d.wire is wire]

    def _channel_index(self, node_name: str, channel: str) -> int:
        for bus in self.simulated.robot.buses:
            for node in bus.nodes:
                if node.name == node_name:
                    return [c.name for c in node.channels].index(channel)
        raise KeyError(node_name)

    def _clone(self, device: SimulatedDevice) -> Removal:
        """Adds a device with the id and the behaviour of ``device`` to the CAN bus."""
        simulated = self.simulated
        name = f"{device.name}_clone"
        while name in simulated.devices:
            name += "_clone"
        clone = simulated.clone(device.name, name)
        clone.power_on()

        def remove_clone() -> None:
            clone.power_off()
            clone.wire.detach(clone.controller)
            del simulated.devices[name]

        return remove_clone

    def _filter_frames(self, fault: BusFault, device: SimulatedDevice | None) -> Removal:
        """Lets receivers lose CAN frames, or receive CAN frames late or twice.

        If ``device`` is ``None``, the fault affects every receiver on the CAN bus.
        """
        wire, timeline = self.simulated.wires[fault.bus], self.simulated.timeline

        def deliver_later(controller: CanController, frame: CanFrame, delay: int) -> None:
            timeline.after(delay, lambda: controller.deliver(frame) if controller.online else None)

        def accepts(controller: CanController, frame: CanFrame) -> bool:
            if device is not None and controller is not device.controller:
                return True
            if fault.cob_id is not None and not _is_meant(fault, frame):
                return True
            if self._random.random() >= fault.share:
                return True
            if fault.kind == "repeated_frames":
                deliver_later(controller, frame, controller.time_of(frame_bits(frame)))
                return True
            if fault.kind == "late_frames":
                deliver_later(controller, frame, to_ns(fault.latency))
            return False

        wire.filters.append(accepts)
        return lambda: wire.filters.remove(accepts)

    def _forge(self, fault: BusFault) -> Removal:
        """Sends CAN frames from an additional CAN controller on the CAN bus."""
        wire = self.simulated.wires[fault.bus]
        sender = CanController(wire, "foreign_sender", wire.bitrate)
        length = self._frame_length(fault.bus, _frame(fault, b"").key)
        wire.attach(sender)
        sender.switch_on()

        def send() -> None:
            if sender.powered:
                data = self._random.randbytes(length) if fault.data is None else fault.data
                sender.send(_frame(fault, data))
                if fault.period > 0.0:
                    self.simulated.timeline.after(to_ns(fault.period), send)

        send()
        return lambda: wire.detach(sender)

    def _frame_length(self, bus_name: str, key: int) -> int:
        """Returns the number of data bytes of the CAN frames with the key ``key``."""
        for bus in self.simulated.robot.buses:
            for frame in bus.frames:
                if bus.name == bus_name and frame.key == key:
                    return frame.length
        return 8

    def _babble(self, fault: BusFault, device: SimulatedDevice) -> Removal:
        frame = _frame(fault, bytes(8))
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


def _frame(fault: BusFault, data: bytes) -> CanFrame:
    """Returns a CAN frame with the identifier and the format of an injected fault."""
    if fault.format == "remote":
        return CanFrame(fault.cob_id or 0, remote=True, requested=len(data))
    return CanFrame(fault.cob_id or 0, data, fault.format == "extended")


def _is_meant(fault: BusFault, frame: CanFrame) -> bool:
    """Returns whether an injected fault with a ``cob_id`` affects a CAN frame."""
    form = _frame(fault, b"")
    return frame.key == form.key and frame.remote >= form.remote


def _set(target: object, name: str, value: object = True, end: object = False) -> Removal:
    """Sets an attribute, and returns the function that sets its value at the end of the fault."""
    setattr(target, name, value)
    return lambda: setattr(target, name, end)


def _nothing() -> None:
    """Does nothing at the end of an injected fault without duration, such as an EMCY message."""
