"""Tests of the containment of a worker process, each layer alone and all together."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from thorvaldc.compiler.sandbox import containment

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has the layers")

# Each attempt returns normally if it succeeds, and raises OSError if the layer forbids it.
PROGRAM = """
import ctypes, json, os, socket, subprocess, sys
from thorvaldc.compiler.sandbox import containment
layer, inside, outside = sys.argv[1:]
modules = [os.path.dirname(os.__file__), *sys.path]
libc = ctypes.CDLL(None, use_errno=True)
def raw(name, *arguments):
    if getattr(libc, name)(*arguments) < 0:
        raise OSError(ctypes.get_errno(), name)
def call(number, *arguments):
    if libc.syscall(number, *arguments) < 0:
        raise OSError(ctypes.get_errno(), str(number))
def append():
    with open(inside + "/kept.txt", "a") as file:
        file.write("x")
def connect(family, address):
    socket.socket(family).connect(address)
attempts = {
    "read inside": lambda: open(inside + "/kept.txt").read(),
    "list inside": lambda: os.listdir(inside),
    "read outside": lambda: open(outside + "/secret.txt").read(),
    "read by a link": lambda: open(inside + "/link").read(),
    "list outside": lambda: os.listdir(outside),
    "environment of the parent": lambda: open(f"/proc/{os.getppid()}/environ").read(),
    "own memory": lambda: open("/proc/self/mem", "r+b"),
    "append": append,
    "create": lambda: os.open(inside + "/new.txt", os.O_WRONLY | os.O_CREAT),
    "truncate": lambda: os.open(inside + "/kept.txt", os.O_RDONLY | os.O_TRUNC),
    "truncate by path": lambda: os.truncate(inside + "/kept.txt", 0),
    "delete": lambda: os.unlink(inside + "/kept.txt"),
    "rename": lambda: os.rename(inside + "/kept.txt", inside + "/other.txt"),
    "make a folder": lambda: os.mkdir(inside + "/folder"),
    "make a link": lambda: os.symlink("kept.txt", inside + "/symlink"),
    "start a program": lambda: os.execv("/bin/true", ["true"]),
    "start a process": lambda: subprocess.run(["/bin/true"]),
    "fork": lambda: os.fork() or os._exit(0),
    "signal the parent": lambda: os.kill(os.getppid(), 0),
    "trace the parent": lambda: raw("ptrace", 16, os.getppid(), 0, 0),
    "read the parent's memory": lambda: raw("process_vm_readv", os.getppid(), 0, 0, 0, 0, 0),
    "limit the parent": lambda: raw("prlimit", os.getppid(), 7, 0, 0),
    "open a socket": lambda: socket.socket(),
    "io_uring": lambda: call(425, 1, ctypes.create_string_buffer(120)),
    "mount": lambda: raw("mount", b"x", inside.encode(), b"tmpfs", 0, 0),
    "mode": lambda: os.chmod(inside + "/kept.txt", 0o777),
}
if layer == "all":
    reason = "; ".join(filter(None, containment.contain([inside, *modules], 1 << 30).values()))
else:
    libc.prctl(38, 1, 0, 0, 0)
    try:
        reason = (
            containment._restrict_files(libc, [inside, *modules])
            if layer == "landlock"
            else containment._filter_calls(libc)
        )
    except OSError as error:
        reason = str(error)
done = []
for name, attempt in [] if reason else attempts.items():
    try:
        attempt()
        done.append(name)
    except OSError:
        pass
print(json.dumps([reason, done]))
"""
READS = ["read inside", "list inside"]


def run(folder: Path, layer: str) -> list[str]:
    inside, outside = folder / "inside", folder / "outside"
    inside.mkdir()
    outside.mkdir()
    (inside / "kept.txt").write_text("kept", encoding="utf-8")
    (outside / "secret.txt").write_text("secret", encoding="utf-8")
    (inside / "link").symlink_to(outside / "secret.txt")
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM, layer, str(inside), str(outside)],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )
    assert result.returncode == 0, result.stderr
    reason, done = json.loads(result.stdout.splitlines()[-1])
    if reason:
        pytest.skip(f"this kernel has no {layer}: {reason}")
    return list(done)


def test_all_layers_leave_only_reading_inside(tmp_path: Path) -> None:
    assert run(tmp_path, "all") == READS
    assert (tmp_path / "inside" / "kept.txt").read_text(encoding="utf-8") == "kept"
    assert sorted(p.name for p in (tmp_path / "inside").iterdir()) == ["kept.txt", "link"]


def test_landlock_alone_permits_no_other_file(tmp_path: Path) -> None:
    done = run(tmp_path, "landlock")
    assert not {"read outside", "read by a link", "list outside", "own memory"} & {*done}
    assert not {"environment of the parent", "append", "create", "delete", "rename"} & {*done}
    assert not {"make a folder", "make a link", "start a program", "start a process"} & {*done}
    assert {*READS} <= {*done}


def test_seccomp_alone_permits_nothing_but_reading(tmp_path: Path) -> None:
    reads = {*READS, "read outside", "read by a link", "list outside", "environment of the parent"}
    assert {*run(tmp_path, "seccomp")} <= reads


HEADERS = (  # of the kernel, by the column of the table
    Path("/usr/include/x86_64-linux-gnu/asm/unistd_64.h"),
    Path("/usr/include/asm-generic/unistd.h"),
)


@pytest.mark.parametrize("column", [0, 1])
def test_the_numbers_of_the_calls_are_those_of_the_kernel(column: int) -> None:
    """aarch64 uses the generic numbers."""
    if not HEADERS[column].is_file():
        pytest.skip("the headers of the kernel (linux-libc-dev) are not installed")
    text = HEADERS[column].read_text(encoding="utf-8")
    kernel = {
        name: int(number)
        for name, number in re.findall(r"#define __NR(?:3264)?_(\w+)\s+(\d+)", text)
    }
    kernel.setdefault("newfstatat", kernel.get("fstatat", -1))
    table = {name: numbers[column] for name, numbers in containment._PERMITTED.items()}
    table |= {name: numbers[column] for name, numbers in containment._OPEN.items()}
    table |= {"prlimit64": containment._OWN_LIMITS[column], "fcntl": containment._FCNTL[column]}
    wrong = {name: n for name, n in table.items() if n != -1 and kernel.get(name) != n}
    assert wrong == {}
