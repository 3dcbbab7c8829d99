"""Tests of the worker process: limits, isolation and interruption."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from tests.child_process import ChildProcess, is_running
from tests.compiler.extras.xacro_files import (
    HEAD,
    STL,
    load,
    load_one,
    mesh,
)
from thorvaldc.compiler.extras import xacro_expand


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("<link name='${[0] * 10**10}'/>", "memory"),
        ("<link name='${list(range(10**12))}'/>", "memory"),
        (
            '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',
            "calls itself",
        ),
        ('<xacro:include filename="a.xacro"/>', "calls itself"),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="memory limits require Linux")
def test_a_file_that_exceeds_a_limit_is_an_error(tmp_path: Path, body: str, words: str) -> None:
    loaded = load_one(tmp_path, body)
    assert loaded.codes[0] in ("extra-limit", "extra-expansion")
    assert words in loaded.only.message


def test_a_file_that_hangs_is_stopped_and_the_next_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(xacro_expand, "LIMITS", replace(xacro_expand.LIMITS, wall_seconds=1.0))
    start = time.monotonic()
    loaded = load(
        tmp_path,
        "[{xacro: a.xacro}, {xacro: b.xacro}]",
        a_xacro=HEAD + "<link name='${len([0 for i in range(10**11) if not i+1])}'/></robot>",
        b_xacro=HEAD + "<link name='b'/></robot>",
    )
    assert time.monotonic() - start < 60.0
    assert loaded.codes == ["extra-limit"]
    assert "longer than 1 s" in loaded.only.message
    assert [link.name for link in loaded.parts.links] == ["b"]


def test_output_of_a_file_does_not_mix_with_the_answers(tmp_path: Path) -> None:
    body = "<link name='a${xacro.message(1)}'/>"
    body += "\n<xacro:property name='x' value='${xacro.warning(2)}'/>"
    loaded = load_one(tmp_path, body + "<link name='b${x}'/>")
    assert [link.name for link in loaded.parts.links] == ["a", "b"]
    assert loaded.codes == ["extra-warning"]


def test_sums_of_floats_are_the_same_on_every_python(tmp_path: Path) -> None:
    origin = "<origin xyz='${1e16 * (1 - python.sum([0.1] * 10))} ${python.sum([1, 2], 3)} 0'/>"
    joint = f"<joint name='j' type='fixed'><parent link='a'/><child link='b'/>{origin}</joint>"
    loaded = load_one(tmp_path, "<link name='a'/><link name='b'/>" + joint)
    assert loaded.joint("j").pose.xyz == (1.11022302463, 6.0, 0.0)  # `sum` of 3.12: 0


def test_the_result_does_not_depend_on_the_folder(tmp_path: Path) -> None:
    loaded = []
    for name in ("x", "y"):
        (tmp_path / name).mkdir()
        loaded.append(
            load(
                tmp_path / name,
                "- {xacro: a.xacro, packages: {p: .}}",
                a_xacro=HEAD + mesh("$(find p)/m.stl") + "<gazebo>$(find p)/x</gazebo></robot>",
                m_stl=STL,
            )
        )
    assert list(loaded[0].files) == list(loaded[1].files) == ["a.xacro"]
    parts = [each.parts for each in loaded]
    assert repr(parts[0]) == repr(parts[1])
    assert str(os.getcwd()) not in repr(parts)
    assert struct.unpack_from("<I", parts[0].meshes[0].data, 80) == (4,)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_an_interrupt_ends_the_worker(tmp_path: Path) -> None:
    (tmp_path / "a.xacro").write_text(
        HEAD + "<link name='${len([0 for i in range(10**11) if not i+1])}'/></robot>",
        encoding="utf-8",
    )
    program = (
        "from pathlib import Path\n"
        "from thorvaldc.compiler.extras import xacro_expand as x\n"
        f"folder = Path({str(tmp_path)!r})\n"
        "request = x.ExpansionRequest(folder / 'a.xacro', {}, {})\n"
        "x.expand([request], x.DisplayPaths(folder, '', {}))\n"
    )
    process = ChildProcess([sys.executable, "-c", program], stderr=subprocess.DEVNULL)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    deadline = time.monotonic() + 30.0
    worker = ""
    while not worker and time.monotonic() < deadline:
        time.sleep(0.02)
        worker = children.read_text().strip()
    time.sleep(0.3)  # the worker is expanding now, or starts soon
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=300) != 0
    while is_running(worker) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not is_running(worker)
