"""Reads the section `ros2_driver` of a sensor module: the driver of the real sensor."""

from __future__ import annotations

from thorvaldc.compiler.hardware.joint_reader import ModuleValues
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import FIRST_USE, Label, did_you_mean
from thorvaldc.model.ros2_driver import RAW_IMU, Ros2Driver


def read_ros2_driver(node: Node | None, kind: str, values: ModuleValues) -> Ros2Driver | None:
    """Returns the driver of a sensor, or ``None`` if its module states none.

    ``kind``: type of the sensor.  Reports a sensor whose topics other programs do not know, topics
    that sensors of its type do not have, and topics that no topic of the driver becomes.
    """
    if node is None or not values.is_present(node):
        return None
    scope = values.scope
    topics = {name: scope.text(topic) for name, topic in entries(node.get("topics")).items()}
    _check_topics(node, kind, list(topics), values)
    _check_parameters(node, values)
    ports = {name: scope.text(port) for name, port in entries(node.get("ports")).items()}
    return Ros2Driver(
        scope.text(node.get("package")),
        scope.text(node.get("executable")),
        scope.text(node.get("frame")),
        tuple(topics.items()),
        tuple((name, port) for name, port in ports.items() if port),
        values.properties(node.get("parameters")),
    )


def _check_topics(node: Node, kind: str, topics: list[str], values: ModuleValues) -> None:
    from thorvaldc.backends.ros2_parts import SENSOR_TOPICS  # for the few modules with a driver

    if kind not in SENSOR_TOPICS:
        values.report.add(
            "unknown-value",
            f"a sensor of the type `{kind}` has no topic in ROS 2 for a driver",
            node.where,
            hint=f"types with topics: {', '.join(SENSOR_TOPICS)}",
        )
        return
    required = [name for name, *_ in SENSOR_TOPICS[kind]]
    known = [*required, *(RAW_IMU if kind == "imu" else ())]
    for name, topic in entries(node.get("topics")).items():
        if name not in known:
            values.report.add(
                "unknown-key",
                f"`{name}` is not a topic of a {kind}",
                topic.where,
                hint=did_you_mean(name, known, f"its topics: {', '.join(known)}"),
            )
    if kind == "imu" and RAW_IMU[0] in topics:
        return  # the filter publishes the topic of the sensor
    for name in required:
        if name not in topics:
            values.report.add(
                "missing-key",
                f"no topic of the driver becomes the topic `{name}` of the {kind}",
                (node.get("topics") or node).where,
                hint=f"add `{name}: <topic of the driver>`",
            )


def _check_parameters(node: Node, values: ModuleValues) -> None:
    """Reports a parameter of the driver that two keys set."""
    frame = node.get("frame")
    places = {values.scope.text(frame): frame.span} if frame is not None else {}
    for key in ("ports", "parameters"):
        for name, entry in entries(node.get(key)).items():
            first = places.setdefault(name, entry.where)
            if first is not entry.where:
                values.report.add(
                    "conflicting-keys",
                    f"two keys set the parameter `{name}` of the driver",
                    entry.where,
                    hint="remove one of them",
                    labels=[Label(first, FIRST_USE)],
                )
