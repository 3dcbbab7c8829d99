#!/bin/sh
# Sets the CAN interfaces of vesc_rover up:
#   sh bring_up.sh [interface of main]
# Made by thorvaldc; changes are lost. Never tried on physical hardware.
set -eu

set_up() {
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
}

if [ "$(id -u)" -ne 0 ]; then
  echo "error: only root may set up an interface; try: sudo sh $0" >&2
  exit 3
fi
if [ $# -gt 1 ]; then
  echo "error: there is one interface to name, that of main" >&2
  exit 2
fi

set_up main "${1:-can0}" 500000
