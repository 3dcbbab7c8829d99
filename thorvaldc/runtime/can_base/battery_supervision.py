"""Judges the batteries of a robot, and limits or stops the robot while their charge is low.

Level of a battery, from its state of charge and the thresholds of the robot file:

    charge   100 %           warn         limit          stop          0 %
               |--------------|-------------|--------------|------------|
    level           OK             WARN          LIMIT          STOP
    speed          100 %          100 %        ``speed``         0

The battery with the worst level determines the level of the robot, because the model does not tell
which battery supplies which motor.  A battery that has sent no state of charge for
``SILENCE_LIMIT`` seconds has the level LIMIT, and after ``BatterySettings.silence`` the level STOP.
A battery that does not allow a discharge current, or that reports alarms, is a warning and a reason
not to arm the robot.

A level becomes worse after ``WORSE_TIME`` seconds, so that a single wrong report changes nothing.
A level becomes better when the charge is by ``HYSTERESIS`` above the threshold.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator, Sequence

from thorvaldc.model.robot import BatterySettings
from thorvaldc.runtime.can_base.battery_and_io_drivers import BatteryDriver

SILENCE_LIMIT = 1.0
"""Time (s) without a state of charge after which the speed is limited."""
INTERVAL = 0.1
"""Time (s) between two judgements, which is the period of the reports of the KC battery."""
WORSE_TIME = 1.0
"""Time (s) for which a worse level must last."""
HYSTERESIS = 0.02
"""Distance (0 to 1) of the charge above a threshold at which the level becomes better."""


class BatteryLevel(enum.IntEnum):
    """Reaction to the state of a battery; see the docstring of this module."""

    OK = 0
    WARN = 1
    LIMIT = 2
    STOP = 3


class _Judgement:
    """Level of one battery with its reason, and the time since which it has been worse."""

    def __init__(self, now: float) -> None:
        self.level = BatteryLevel.OK
        self.reason = ""
        self.first_seen = now
        self.worse_since = math.inf


class BatterySupervision:
    """Level of all batteries on the buses of a robot.

    A robot without a battery on its buses always has the level ``OK``.

    - ``level``: worst level of all batteries;
    - ``reason``: reason of the level with the name of the battery, empty at the level ``OK``.
    """

    def __init__(self, settings: BatterySettings, batteries: Sequence[BatteryDriver]) -> None:
        self.settings = settings
        self.batteries = batteries
        self.level = BatteryLevel.OK
        self.reason = ""
        self._judgements: dict[str, _Judgement] = {}
        self._due = -math.inf

    @property
    def speed_share(self) -> float:
        """Share (0 to 1) of the top speeds of the robot at the present level."""
        if self.level is BatteryLevel.STOP:
            return 0.0
        return self.settings.speed if self.level is BatteryLevel.LIMIT else 1.0

    def update(self, now: float) -> BatteryLevel:
        """Judges the newest reports of all batteries at the time ``now`` (s).

        The batteries are judged once in ``INTERVAL``, because their charge changes slowly.
        """
        if now < self._due:
            return self.level
        self._due = now + INTERVAL
        self.level, self.reason = BatteryLevel.OK, ""
        for battery in self.batteries:
            name = battery.node.name
            judgement = self._judgements.get(name)
            if judgement is None:
                judgement = self._judgements[name] = _Judgement(now)
            self._judge(battery, judgement, now)
            if judgement.level > self.level:
                self.level, self.reason = judgement.level, f"{name}: {judgement.reason}"
        return self.level

    def warnings(self) -> list[str]:
        """Returns the reason of each battery whose level is not ``OK``, and its own warnings."""
        warnings = [f"{name}: {j.reason}" for name, j in self._judgements.items() if j.level]
        return warnings + [f"{b.node.name}: {b.warning}" for b in self.batteries if b.warning]

    def arming_reasons(self, now: float) -> Iterator[str]:
        """Yields the reasons against arming the robot at the time ``now`` (s)."""
        for battery in self.batteries:
            state, name = battery.state, battery.node.name
            if now - battery.charge_time > SILENCE_LIMIT or math.isnan(state.charge):
                yield f"{name}: no reports of its charge"
            elif state.charge < self.settings.arm:
                yield (
                    f"{name}: {100.0 * state.charge:.0f} % left, "
                    f"less than {100.0 * self.settings.arm:.0f} %"
                )
            if battery.warning:
                yield f"{name}: {battery.warning}"

    # -- inside --------------------------------------------------------------------------------

    def _judge(self, battery: BatteryDriver, judgement: _Judgement, now: float) -> None:
        silence = now - max(battery.charge_time, judgement.first_seen)
        charge = battery.state.charge
        if silence > SILENCE_LIMIT:
            level = BatteryLevel.LIMIT
            if silence > self.settings.silence:
                level = BatteryLevel.STOP
            judgement.level, judgement.worse_since = max(level, judgement.level), math.inf
            judgement.reason = f"no reports of its charge for {silence:.0f} s"
            return
        if math.isnan(charge):
            return  # the first report is still awaited
        level = self._level(charge)
        if level > judgement.level:
            judgement.worse_since = min(judgement.worse_since, now)
            if now - judgement.worse_since < WORSE_TIME:
                return
        elif level < judgement.level:
            level = max(level, self._level(charge - HYSTERESIS))
        judgement.level, judgement.worse_since = level, math.inf
        judgement.reason = f"{100.0 * charge:.0f} % left"

    def _level(self, charge: float) -> BatteryLevel:
        settings = self.settings
        if charge < settings.stop:
            return BatteryLevel.STOP
        if charge < settings.limit:
            return BatteryLevel.LIMIT
        return BatteryLevel.WARN if charge < settings.warn else BatteryLevel.OK
