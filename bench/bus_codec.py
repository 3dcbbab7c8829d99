"""Decoding and encoding frames: the driver's compiled layouts beside cantools, in one run."""

from __future__ import annotations

from collections.abc import Iterator

import cantools

from bench.figure import EXAMPLE, Figure, least_times
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot
from thorvaldc.runtime.can_base.signal_codec import FrameCodec

TURNS = 2000


def figures() -> Iterator[Figure]:
    robot = compile_file(EXAMPLE).model
    if not isinstance(robot, Robot):
        raise RuntimeError("the example does not compile")
    text = emit(robot, ["can"])["can/robot.dbc"].decode("cp1252")
    database = cantools.database.load_string(text, "dbc")
    frames = {f.name: f for f in robot.buses[0].frames}
    node = robot.buses[0].nodes[0].name
    command, report = frames[f"{node}_rpdo4"], frames[f"{node}_tpdo1"]
    ours = FrameCodec(command), FrameCodec(report)
    theirs = [database.get_message_by_frame_id(f.cob_id) for f in (command, report)]
    values = [1.0, 0.5]
    named = dict(zip(ours[0].names, values, strict=True))
    data = bytes(range(8))

    def own_codec() -> None:
        encode, decode = ours[0].encode, ours[1].decode
        for _ in range(TURNS):
            encode(values)
            decode(data)

    def of_cantools() -> None:
        encode, decode = theirs[0].encode, theirs[1].decode
        for _ in range(TURNS):
            encode(named)
            decode(data, decode_choices=False)

    own, other = (t / TURNS for t in least_times([own_codec, of_cantools], rounds=15))
    yield Figure(
        "frame codec",
        own * 1e6,
        "us",
        None,
        "lower",
        "a command encoded and a report decoded, two and three values with scalings,"
        f" least of 15 x {TURNS}; cantools does the same in {other * 1e6:.2f} us",
    )
    yield Figure(
        "frame codec over cantools",
        own / other,
        "",
        1.0,
        "lower",
        "the two above, over one another",
    )
