"""Opens CAN interfaces for tests, and frames of all kinds to send over them."""

from __future__ import annotations

import pytest

from tests.robots import SPAN
from thorvaldc.can.frame import CanFrame
from thorvaldc.can.open_interface import open_interface
from thorvaldc.can.python_can_interface import PythonCanInterface
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Bus

HEARTBEAT = CanFrame(0x701, b"\x05")
ALL_KINDS = (
    HEARTBEAT,
    CanFrame(0x080),
    CanFrame(0x203, bytes(range(8))),
    CanFrame(0x1ABCDEF0, b"\x01\x02", extended=True),
    CanFrame(0x583, remote=True, requested=8),
)


@pytest.fixture
def bus() -> Bus:
    return Bus("can", 500_000, 0.02, (), (), SPAN)


def open_python_can(spec: str, bus: Bus) -> PythonCanInterface:
    interface = open_interface(spec, bus)
    assert isinstance(interface, PythonCanInterface)
    return interface


def refusal(spec: str, bus: Bus) -> tuple[str, str]:
    with pytest.raises(DiagnosticError) as caught:
        open_interface(spec, bus)
    diagnostic = caught.value.diagnostic
    assert diagnostic.code.name == "bus-interface"
    assert diagnostic.code.outside
    assert "\n" not in diagnostic.message
    return diagnostic.message, diagnostic.hint or ""
