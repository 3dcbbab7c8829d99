"""Checks the state in battery messages for each direction of the current."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from sensor_msgs.msg import BatteryState

from thorvaldc.ros.messages import battery_message
from thorvaldc.runtime.can_base.battery_and_io_drivers import BatteryState as ReportedBattery

STATUSES = {
    0.2: BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
    -0.2: BatteryState.POWER_SUPPLY_STATUS_CHARGING,
    0.0: BatteryState.POWER_SUPPLY_STATUS_NOT_CHARGING,
    math.nan: BatteryState.POWER_SUPPLY_STATUS_UNKNOWN,
}


def main() -> None:
    for current, status in STATUSES.items():
        battery = ReportedBattery(2.0, 48.0, current, temperatures=[20.0, 31.0])
        message = battery_message("front", battery, Time(sec=3), "base")
        assert message.power_supply_status == status, current
        assert math.isnan(current) or abs(message.current + current) < 1e-6
        assert (message.location, message.header.frame_id) == ("front", "base")
        assert message.header.stamp.sec == 3
        assert (message.voltage, message.temperature, message.present) == (48.0, 31.0, True)
    unknown = battery_message("front", ReportedBattery(), Time(), "base")
    assert math.isnan(unknown.temperature)
    assert not unknown.present


if __name__ == "__main__":
    main()
