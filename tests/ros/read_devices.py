"""Reads what motor controllers and IO boards report, and writes settings of motor controllers."""

from __future__ import annotations

import math
from typing import Any

from control_msgs.msg import DynamicInterfaceGroupValues
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

from tests.ros.client import Client


def values_of(message: Any) -> dict[str, dict[str, float]]:
    return {
        name: dict(zip(group.interface_names, group.values, strict=True))
        for name, group in zip(message.interface_groups, message.interface_values, strict=True)
    }


def setting(name: str, value: Any) -> Any:
    if isinstance(value, str):
        kind = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
    else:
        kind = ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value)
    return Parameter(name=name, value=kind)


def main() -> None:
    client = Client()
    client.listen(DynamicInterfaceGroupValues, "/motor_controller_data")
    client.listen(DynamicInterfaceGroupValues, "/io_data")

    def write(*settings: Any) -> list[str]:
        request = SetParameters.Request(parameters=list(settings))
        results = client.request(SetParameters, "setup_motor_controller", request).results
        assert all(result.successful is not bool(result.reason) for result in results)
        return [result.reason for result in results]

    client.arm()
    client.drive(0.2)
    data = values_of(client.last["motor_controller_data"])
    assert len(data) == 4, data
    for controller, values in data.items():
        assert values["propulsion_velocity"] > 0.5, (controller, values)
        assert values["supply_voltage"] > 40.0, (controller, values)
        assert "content" not in values  # the multiplexer of the constants
        assert math.isfinite(sum(values.values())), (controller, values)
    name = next(iter(data))
    (refused,) = write(setting(f"{name}.max_propulsion_speed", 1000))
    assert refused == "the robot drives; stop it first"
    client.rest()
    assert write(setting(f"{name}.max_propulsion_speed", 1000)) == [""]
    assert write(setting("max_steering_speed", 1000)) == [""]  # of all motor controllers
    refusals = write(
        setting("nobody.max_propulsion_speed", 1000),
        setting(f"{name}.top_speed", 1000),
        setting(f"{name}.max_propulsion_speed", 10**9),
        setting(f"{name}.max_propulsion_speed", "fast"),
    )
    for reason, text in zip(
        refusals,
        ("no controller `nobody`", "max_propulsion_acc", "at most", "a number"),
        strict=True,
    ):
        assert text in reason, reason
    ((board, values),) = values_of(client.wait("io", lambda: client.last.get("io_data"))).items()
    assert values["beacon_red_state"] == 0.0
    assert client.switch(f"{board}_set_beacon_red") == (True, "")

    def is_on() -> bool:
        return values_of(client.last["io_data"])[board]["beacon_red_state"] == 1.0

    client.wait("the beacon", is_on)


if __name__ == "__main__":
    main()
