"""Numbers of the protocol CANSimple of ODrive motor controllers with the firmware 0.6.

Sources: the page "CAN Protocol" of the documentation at docs.odriverobotics.com, and the
definitions of the messages and enumerations in the repository odriverobotics/ros_odrive.
"""

from __future__ import annotations

import enum

BROADCAST_ID = 63
"""Node id that addresses all ODrives; it is also that of an ODrive without a node id."""


class Command(enum.IntEnum):
    """Lower five bits of the CAN identifier; the upper six bits are the node id."""

    GET_VERSION = 0x00
    HEARTBEAT = 0x01
    ESTOP = 0x02
    GET_ERROR = 0x03
    RX_SDO = 0x04
    TX_SDO = 0x05
    SET_AXIS_STATE = 0x07
    GET_ENCODER_ESTIMATES = 0x09
    SET_CONTROLLER_MODE = 0x0B
    SET_INPUT_VEL = 0x0D
    GET_TEMPERATURE = 0x15
    REBOOT = 0x16
    GET_BUS_VOLTAGE_CURRENT = 0x17
    CLEAR_ERRORS = 0x18

    def identifier(self, node_id: int) -> int:
        """Returns the 11-bit CAN identifier of the message of a node."""
        return node_id << 5 | self


class AxisState(enum.IntEnum):
    UNDEFINED = 0
    IDLE = 1
    CLOSED_LOOP_CONTROL = 8


VELOCITY_CONTROL, PASSTHROUGH = 2, 1
"""Control mode and input mode of a velocity that is followed as fast as the motor can."""
READ = 0
"""Opcode of RxSdo: read an endpoint."""


class Error(enum.IntFlag):
    """Bits of ``active_errors`` and of ``disarm_reason``."""

    INITIALIZING = 0x1
    SYSTEM_LEVEL = 0x2
    TIMING_ERROR = 0x4
    MISSING_ESTIMATE = 0x8
    BAD_CONFIG = 0x10
    DRV_FAULT = 0x20
    MISSING_INPUT = 0x40
    DC_BUS_OVER_VOLTAGE = 0x100
    DC_BUS_UNDER_VOLTAGE = 0x200
    DC_BUS_OVER_CURRENT = 0x400
    DC_BUS_OVER_REGEN_CURRENT = 0x800
    CURRENT_LIMIT_VIOLATION = 0x1000
    MOTOR_OVER_TEMP = 0x2000
    INVERTER_OVER_TEMP = 0x4000
    VELOCITY_LIMIT_VIOLATION = 0x8000
    POSITION_LIMIT_VIOLATION = 0x10000
    WATCHDOG_TIMER_EXPIRED = 0x1000000
    ESTOP_REQUESTED = 0x2000000
    SPINOUT_DETECTED = 0x4000000
    BRAKE_RESISTOR_DISARMED = 0x8000000
    THERMISTOR_DISCONNECTED = 0x10000000
    CALIBRATION_ERROR = 0x40000000


def error_names(errors: int) -> str:
    """Returns the names of the set bits of ``errors``; unknown bits as a hexadecimal number."""
    names = [error.name or "" for error in Error if errors & error]
    known = sum(Error)
    if errors & ~known:
        names.append(f"{errors & ~known:#x}")
    return ", ".join(names)
