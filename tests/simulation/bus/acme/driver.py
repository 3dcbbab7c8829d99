"""The driver of a servo controller by Acme."""

from thorvaldc.runtime.can_base.motor_controller import Intent, MotorController


class AcmeServoController(MotorController):
    problem = ""

    def __init__(self, robot, bus, node):
        super().__init__(robot, bus, node)
        self.enabled = False
        self.handlers[self.codecs["report"].key] = self.handle_report

    def handle_report(self, data, time):
        enabled, *velocities = self.codecs["report"].decode(data)
        self.enabled = bool(enabled)
        for axis, velocity in zip(self.axes, velocities, strict=True):
            axis.update(time, 0.0, velocity)

    def cyclic_frames(self, intent, now):
        enable = intent in (Intent.FOLLOW, Intent.QUICK_STOP)
        speeds = [axis.target if intent is Intent.FOLLOW else 0.0 for axis in self.axes]
        command = self.codecs["command"]
        return [command.can_frame(command.encode([enable, *speeds]))]

    @property
    def follows(self):
        return self.enabled

    @property
    def is_off(self):
        return not self.enabled

    def allow_reset(self):
        pass
