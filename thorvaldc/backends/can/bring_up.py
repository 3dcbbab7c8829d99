"""A shell script that sets up the CAN interfaces of the robot (Linux, SocketCAN)."""

from __future__ import annotations

from thorvaldc.model import Robot

HEAD = """\
#!/bin/sh
# Sets the CAN interfaces of {robot} up:
#   sh bring_up.sh{usage}
# Made by thorvaldc; changes are lost. Never tried on physical hardware.
set -eu

set_up() {{
  bus=$1 interface=$2 bitrate=$3
  if [ ! -e "/sys/class/net/$interface" ]; then
    echo "error: there is no interface $interface for the bus $bus" >&2
    exit 3
  fi
  ip link set dev "$interface" down
  # restart-ms 0: after bus-off the interface stays down until somebody has looked for the cause.
  ip link set dev "$interface" type can bitrate "$bitrate" restart-ms 0
  ip link set dev "$interface" txqueuelen 128
  ip link set dev "$interface" up
  echo "$bus: $interface, $bitrate bit/s"
}}

if [ "$(id -u)" -ne 0 ]; then
  echo "error: only root may set up an interface; try: sudo sh $0" >&2
  exit 3
fi
if [ $# -gt {count} ]; then
  echo "error: {count_words} to name, {usage_words}" >&2
  exit 2
fi

"""


def script(robot: Robot) -> str:
    """Return the POSIX shell script that sets up the CAN interfaces.

    The default names of the CAN interfaces are can0, can1, and so on.
    """
    names = [bus.name for bus in robot.buses]
    usage = "".join(f" [interface of {name}]" for name in names)
    text = HEAD.format(
        robot=robot.name,
        usage=usage,
        usage_words=", ".join(f"that of {name}" for name in names),
        count=len(names),
        count_words="there is one interface"
        if len(names) == 1
        else f"there are {len(names)} interfaces",
    )
    for i, bus in enumerate(robot.buses):
        text += f'set_up {bus.name} "${{{i + 1}:-can{i}}}" {bus.bitrate}\n'
    return text
