"""Exchanges frames with a foreign device over the topics of a node, and reads its transform."""

from __future__ import annotations

from can_msgs.msg import Frame
from tf2_msgs.msg import TFMessage

from tests.ros.client import Client
from thorvaldc.can.frame import CanFrame
from thorvaldc.can.simulated_bus_client import SimulatedBusClient

FROM_DEVICE, TO_DEVICE, OF_A_DRIVE = 0x1C0, 0x240, 0x201


def main() -> None:
    bus = SimulatedBusClient("relay")
    client = Client()
    client.listen(Frame, "/can_frames_device_r", 10)
    client.listen(TFMessage, "/tf", 10)
    client.wait("odometry", lambda: "base_raw" in client.last)
    received = client.wait(
        "a frame of the device",
        lambda: client.last.get("can_frames_device_r"),
        lambda: bus.send(CanFrame(FROM_DEVICE, b"\1\2\3\4")),
    )
    assert (received.id, received.dlc) == (FROM_DEVICE, 4)
    assert bytes(received.data[:4]) == b"\1\2\3\4"
    assert received.header.stamp.sec > 0

    def offer() -> None:
        for identifier in (OF_A_DRIVE, TO_DEVICE):
            frame = Frame(id=identifier, dlc=2)
            frame.data[:2] = [7, 9]
            client.publish("can_frames_device_t", frame)

    def sent() -> bytes | None:
        while (got := bus.receive(0.0)) is not None:
            assert got.frame.id != OF_A_DRIVE or got.frame.data != b"\7\x09"
            if got.frame.id == TO_DEVICE:
                return got.frame.data
        return None

    assert client.wait("a frame for the device", sent, offer) == b"\7\x09"
    (transform,) = client.last["tf"].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")
    assert transform.transform.rotation.w == 1.0
    assert client.switch("board_set_relay_0") == (True, "")


if __name__ == "__main__":
    main()
