"""The simulated servo controller by Acme."""

import struct

from thorvaldc.can.canopen import RPDO, TPDO, NmtState
from thorvaldc.simulation.bus.canopen_device import CanopenDevice

PERIOD = 0.02
COMMAND_TIMEOUT = 0.2


class AcmeServo(CanopenDevice):
    """Controls two speeds; switches the motors off without commands."""

    def __init__(self, specification):
        super().__init__(specification)
        channels = specification.node.channels
        actuators = [specification.actuator(channel.name) for channel in channels]
        self.motors = [specification.motor_of(actuator) for actuator in actuators]

    def initialised(self):  # after the boot-up message
        self.enabled = False
        self.commanded_at = self.now
        self.handlers[RPDO[0] + self.node_id] = self.handle_command
        self.every(lambda: PERIOD, self.report)

    def handle_command(self, frame):
        self.enabled, *speeds = struct.unpack("<Bhh", frame.data)
        self.commanded_at = self.now
        for motor, speed in zip(self.motors, speeds, strict=True):
            motor.turn(speed / 1000.0 if self.enabled else 0.0, self.now)

    def report(self):
        if self.now - self.commanded_at > COMMAND_TIMEOUT:
            self.stop_motors()
        if self.state is NmtState.OPERATIONAL:
            velocities = [round(1000.0 * motor.read(self.now).velocity) for motor in self.motors]
            self.send(TPDO[0] + self.node_id, struct.pack("<Bhh", self.enabled, *velocities))

    def stop(self):  # after a loss of power
        super().stop()
        self.stop_motors()

    def stop_motors(self):
        self.enabled = False
        for motor in self.motors:
            motor.release(self.now)
