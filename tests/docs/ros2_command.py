"""Stand-in for the command ``ros2``, which no wheel of ROS 2 contains: the calls of the tutorial.

Runs in the Python of ROS 2, with real messages, services and topics.  Launch files run on the
double of ``launch``, which starts the installed program of the base driver; the other nodes of a
launch file are left out.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import yaml


def interface(name: str) -> Any:
    package, kind, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), short)


def fill(message: Any, values: dict[str, Any]) -> None:
    for name, value in values.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)


def launch(arguments: argparse.Namespace) -> None:
    from tests.backends.ros2.launch_double import run

    prefix = Path(f"ws/install/{arguments.package}").resolve()
    share = prefix / "share" / arguments.package
    started = run(share / "launch" / arguments.file, {arguments.package: share}).started
    (driver,) = (node for node in started if node.executable == "base_driver")
    command = [str(prefix / "lib" / arguments.package / "base_driver"), "--ros-args"]
    for file in driver.files:
        command += ["--params-file", str(file)]
    for name, value in driver.parameters.items():
        command += ["-p", f"{name}:={json.dumps(value)}"]
    sites = ":".join(map(str, prefix.glob("lib/python3*/site-packages")))
    os.environ["PYTHONPATH"] = f"{sites}:{os.environ['PYTHONPATH']}"
    print(f"[INFO] [launch]: {driver.executable}", flush=True)
    os.execv(sys.executable, [sys.executable, *command])


def call(arguments: argparse.Namespace) -> None:
    import rclpy

    kind = interface(arguments.type)
    rclpy.init()
    node = rclpy.create_node("ros2_service")
    client = node.create_client(kind, arguments.name)
    assert client.wait_for_service(20.0)
    request = kind.Request()
    fill(request, yaml.safe_load(arguments.values or "{}"))
    print(f"requester: making request: {request}\n")
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=20.0)
    print(f"response:\n{future.result()}\n")


def publish(arguments: argparse.Namespace) -> None:
    import rclpy

    kind = interface(arguments.type)
    rclpy.init()
    node = rclpy.create_node("ros2_topic")
    publisher = node.create_publisher(kind, arguments.name, 10)
    message = kind()
    fill(message, yaml.safe_load(arguments.values))
    while publisher.get_subscription_count() == 0:
        time.sleep(0.1)
    print("publisher: beginning loop")
    for number in range(1, arguments.times + 1):
        publisher.publish(message)
        print(f"publishing #{number}: {message}\n", flush=True)
        time.sleep(1.0 / arguments.rate)


def echo(arguments: argparse.Namespace) -> None:
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.qos import qos_profile_sensor_data

    rclpy.init()
    node = rclpy.create_node("ros2_topic")
    messages: list[Any] = []
    node.create_subscription(Odometry, arguments.name, messages.append, qos_profile_sensor_data)
    while not messages:
        rclpy.spin_once(node, timeout_sec=1.0)
    value = messages[0]
    for part in arguments.field.split("."):
        value = getattr(value, part)
    print(f"{value}\n---")


def main() -> None:
    parser = argparse.ArgumentParser(prog="ros2")
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("launch")
    command.set_defaults(function=launch)
    command.add_argument("package")
    command.add_argument("file")
    service = commands.add_parser("service").add_subparsers(required=True)
    command = service.add_parser("call")
    command.set_defaults(function=call)
    for name in ("name", "type", "values"):
        command.add_argument(name)
    topic = commands.add_parser("topic").add_subparsers(required=True)
    command = topic.add_parser("pub")
    command.set_defaults(function=publish)
    command.add_argument("--rate", type=float, required=True)
    command.add_argument("--times", type=int, required=True)
    for name in ("name", "type", "values"):
        command.add_argument(name)
    command = topic.add_parser("echo")
    command.set_defaults(function=echo)
    command.add_argument("--once", action="store_true", required=True)
    command.add_argument("--field", required=True)
    command.add_argument("name")
    arguments = parser.parse_args()
    arguments.function(arguments)


if __name__ == "__main__":
    main()
