"""The command ``thorvaldc call``: calls a service of a running base driver."""

from __future__ import annotations

import json as json_format
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thorvaldc.cli import diagnostic_output, options
from thorvaldc.cli.exits import DONE, INPUT, OutsideError

if TYPE_CHECKING:
    from thorvaldc.runtime.control_channel import ControlClient

POLL_PERIOD = 0.2
"""Time in s between two looks at a robot that homes its steering."""


def call(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            autocompletion=options.driver_names,
            help="Name of the running driver.",
        ),
    ],
    service: Annotated[
        str,
        typer.Argument(
            metavar="SERVICE",
            autocompletion=options.service_names,
            help="Without a service, all are listed.",
        ),
    ] = "",
    arguments: Annotated[
        list[str], typer.Argument(metavar="ARGUMENT=VALUE", help="Values as JSON, or text.")
    ] = [],  # noqa: B006
    json: options.Json = False,
) -> int:
    from thorvaldc.runtime.control_channel import ControlClient
    from thorvaldc.runtime.service_table import ServiceError

    values = dict(_parse_argument(text) for text in arguments)
    if service == "twist":
        # The driver voids a twist when its connection closes.
        raise typer.BadParameter(
            "a twist is valid only while its connection is open, and `call` closes it at once;"
            f" drive with `thorvaldc teleop --to {name}` or `thorvaldc run FILE --twist`",
            param_hint="SERVICE",
        )
    client = ControlClient(name)
    try:
        if warning := client.other_version():
            diagnostic_output.message(f"warning: {warning}")
        result = client.call(service or "services", **values)
        if service == "arm" and result:
            diagnostic_output.message(result)
            _wait_until_armed(client)
            result = None
    except ServiceError as error:
        diagnostic_output.message(f"error: {error}")
        return INPUT
    except ConnectionError as error:
        raise OutsideError(str(error)) from None
    finally:
        client.close()
    if json:
        diagnostic_output.print_json(result)
    elif service:
        _print_result(result)
    else:
        _print_services(result)
    return DONE


def _wait_until_armed(client: ControlClient) -> None:
    """Waits until a robot that homes its steering first is armed.

    The connection stays open meanwhile, because the robot ends disarmed without it.  Raises
    ``ServiceError`` if the robot is not armed at the end of the homing.
    """
    from thorvaldc.runtime.service_table import ServiceError

    while (state := client.call("state"))["arming"]:
        time.sleep(POLL_PERIOD)
    if not state["armed"]:
        raise ServiceError(state["held"] or state["fault"] or "the robot is not armed")


def _parse_argument(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise typer.BadParameter(f"{text!r} is not NAME=VALUE", param_hint="ARGUMENTS")
    try:
        return name, json_format.loads(value)
    except ValueError:
        return name, value


def _print_result(result: Any, indent: str = "") -> None:
    """Prints the result of a service call.

    A nested dictionary is printed as indented lines. A dictionary without nested dictionaries is
    printed on one line.
    """
    if not isinstance(result, dict):
        if result is not None:
            print(f"{indent}{_text(result)}")
        return
    for key, value in result.items():
        if isinstance(value, dict) and any(isinstance(entry, dict) for entry in value.values()):
            print(f"{indent}{key}:")
            _print_result(value, indent + "  ")
        elif isinstance(value, dict) and value:
            entries = "  ".join(f"{name} {_text(entry)}" for name, entry in value.items())
            print(f"{indent}{key}: {entries}")
        else:
            print(f"{indent}{key}: {_text(value)}")


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value + 0.0:.4g}"  # adding 0.0 turns -0.0 into 0.0
    if isinstance(value, list):
        return ", ".join(_text(entry) for entry in value) or "-"
    return str(value) if value not in ("", None, {}) else "-"


def _print_services(services: Sequence[Mapping[str, Any]]) -> None:
    for service in services:
        arguments = " ".join(
            f"{argument['name']}=..." if argument["required"] else f"[{argument['name']}=...]"
            for argument in service["arguments"]
        )
        print(f"{service['name']} {arguments}".rstrip())
        print(f"    {service['summary']}")
