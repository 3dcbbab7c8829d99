"""Each quirk of a simulated CANopen device changes the response to one request."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from importlib.resources import files

import pytest

from tests.examples import example_robot
from tests.simulation.bus.robots import cia402_robot
from tests.simulation.bus.test_canopen_device import Bench
from thorvaldc.can.canopen import NMT
from thorvaldc.can.frame import CanFrame
from thorvaldc.compiler.bus.injected_faults import read_faults
from thorvaldc.diagnostics import Report
from thorvaldc.model.scenario import Quirk
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot


def sdo(command: int, index: int, subindex: int, value: int = 0) -> Callable[[Bench], str]:
    """Returns a function that returns the bytes of an SDO response, or its abort code."""

    def respond(bench: Bench) -> str:
        request = struct.pack("<BHBI", command, index, subindex, value)
        response = bench.master.request(0x605, request, 0x585)
        code = struct.unpack_from("<I", response, 4)[0]
        return f"abort {code:08x}" if response[0] == 0x80 else response.hex()

    return respond


def second_consumer(bench: Bench) -> str:
    bench.master.write(5, 0x1016, 1, 0x7F0064, 4)
    return sdo(0x23, 0x1016, 2, 0x7F00C8)(bench)


def selected_twice(command: int) -> Callable[[Bench], str]:
    """Returns a function that selects the device, and then sends a request for another one."""

    def respond(bench: Bench) -> str:
        assert bench.master.select(0x469, 2, 3, 0x1001)
        return (bench.master.lss(command, 0x77) or b"").hex()

    return respond


CASES = [
    (Quirk.LSS_RESPONDS_WHEN_SELECTED, selected_twice(0x43), "", "44" + 14 * "0"),
    (Quirk.LSS_RESPONDS_WHEN_SELECTED, selected_twice(0x51), "", "4f" + 14 * "0"),
    (Quirk.LENGTH_ABORTS, sdo(0x23, 0x1017, 0), "abort 06070010", "abort 06070012"),
    (Quirk.LENGTH_ABORTS, sdo(0x2F, 0x1017, 0), "abort 06070010", "abort 06070013"),
    (Quirk.ERROR_HISTORY_ABORTS, sdo(0x40, 0x1003, 1), "4303100100000000", "abort 08000024"),
    (Quirk.ONE_CONSUMER_PER_NODE, second_consumer, "6016100200000000", "abort 06040043"),
    (Quirk.FIXED_COB_IDS, sdo(0x23, 0x1005, 0, 0x80), "6005100000000000", "abort 06010002"),
    (Quirk.FIXED_COB_IDS, sdo(0x23, 0x1014, 0, 0x85), "6014100000000000", "abort 06010002"),
    (Quirk.SEGMENTED_TRANSFERS, sdo(0x40, 0x1017, 0), "4b17100064000000", "4117100002000000"),
    (Quirk.SEGMENTED_TRANSFERS, sdo(0x2B, 0x1017, 0), "6017100000000000", "abort 05040001"),
]


@pytest.mark.parametrize(("quirk", "response", "default", "with_quirk"), CASES)
def test_response_with_and_without_quirk(
    quirk: Quirk, response: Callable[[Bench], str], default: str, with_quirk: str
) -> None:
    assert response(Bench(5)) == default
    assert response(Bench(5, quirks=frozenset({quirk}))) == with_quirk


def test_inhibit_times() -> None:
    """TPDO3 of a drive is due every 10 ms, and sent when its inhibit time is over."""

    def count(*quirks: Quirk) -> int:
        simulated = SimulatedRobot(cia402_robot(), quirks=quirks)
        device = simulated.devices["fl_controller"]
        device.nonvolatile["parameters"]["1802.05"] = 10
        simulated.power_on()
        master = simulated.interface()
        simulated.run(0.2)
        master.send(CanFrame(NMT, bytes([1, 1])))
        sent: list[int] = []
        simulated.wire().observers.append(
            lambda time, frame, _: sent.append(time) if frame.id == 0x381 else None
        )
        simulated.run(1.0)
        return len(sent)

    assert 95 <= count() <= 101
    assert 19 <= count(Quirk.INHIBIT_TIMES) <= 21
    assert 95 <= count(Quirk.INHIBIT_TIMES, Quirk.NO_INHIBIT_TIMES) <= 101


def test_a_document_declares_quirks(tmp_path: object) -> None:
    schema = json.loads((files("thorvaldc.schema") / "bus_faults.schema.json").read_text())
    assert schema["properties"]["quirks"]["items"]["enum"] == [quirk.value for quirk in Quirk]
    path = f"{tmp_path}/quirks.yaml"
    with open(path, "w") as file:
        file.write("thorvaldc: 1\nquirks: [length_aborts, fixed_cob_ids]\n")
    report = Report()
    script = read_faults(path, example_robot("4wd4ws_wide"), report)
    assert script is not None, list(report)
    assert script.quirks == (Quirk.LENGTH_ABORTS, Quirk.FIXED_COB_IDS)
    assert script.faults == ()
