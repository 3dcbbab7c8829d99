"""Encoding and decoding of frames: the driver's codec compared with cantools, in one run."""

from __future__ import annotations

from collections.abc import Iterator

import cantools

from bench.figure import EXAMPLE, Figure, in_turns
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
    codecs = FrameCodec(command), FrameCodec(report)
    messages = [database.get_message_by_frame_id(f.cob_id) for f in (command, report)]
    values = [1.0, 0.5]
    named = dict(zip(codecs[0].names, values, strict=True))
    data = bytes(range(8))

    def use_codec() -> None:
        encode, decode = codecs[0].encode, codecs[1].decode
        for _ in range(TURNS):
            encode(values)
            decode(data)

    def use_cantools() -> None:
        encode, decode = messages[0].encode, messages[1].decode
        for _ in range(TURNS):
            encode(named)
            decode(data, decode_choices=False)

    times = in_turns(use_codec, use_cantools, rounds=15)
    codec_time, cantools_time = (min(each) / TURNS for each in times)
    yield Figure(
        "frame codec",
        codec_time * 1e6,
        "us",
        None,
        "lower",
        "encode a command and decode a report, two and three values with scalings,"
        f" least of 15 x {TURNS}; cantools needs {cantools_time * 1e6:.2f} us",
    )
    yield Figure.ratio("frame codec over cantools", 1.0, zip(*times, strict=True), "of these times")
