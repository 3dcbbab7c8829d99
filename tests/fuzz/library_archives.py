"""Robots with libraries from archives, for `modules fetch`, which reads what others have packed."""

from __future__ import annotations

import gzip
import io
import random
import tarfile
import zipfile

from tests.cli.conftest import GOOD
from tests.fuzz.generator import Kind
from tests.fuzz.mutations import BYTE_MUTATIONS, YAML_MUTATIONS, Mutation

NAME = "parts/top/plate/module.yaml"
MODULE = b"""\
thorvaldc: 1
description: A plate.
mount: {kinds: [frame_clamp], link: body}
links: {body: {parts: [{shape: {box: [1, 1, 0.1]}, mass: 2, source: "estimated: a plate"}]}}
"""
ROBOT = f"library: [{{archive: parts.bin, folder: parts}}]\n{GOOD}".encode()
COMMANDS = ("modules fetch robot.yaml", "modules fetch --update robot.yaml --json")
LOCK = b"""\
thorvaldc_lock: 1
libraries:
  - {archive: parts.bin, folder: parts, sha256: %s}
addresses: {main: {canopen: {fl.controller: 1}}}
"""


def library_kinds() -> list[Kind]:
    """Returns the archives of a library, and the lock file that pins one."""
    packed, plain = io.BytesIO(), io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(NAME, MODULE)
    with tarfile.open(fileobj=plain, mode="w") as tar:
        info = tarfile.TarInfo(NAME)
        info.size = len(MODULE)
        tar.addfile(info, io.BytesIO(MODULE))
    files = [packed.getvalue(), gzip.compress(plain.getvalue(), mtime=0)]
    inside = [_inside(change) for change in BYTE_MUTATIONS]
    examples = [("parts.bin", {"robot.yaml": ROBOT, "parts.bin": data}) for data in files]
    lock = {"robot.yaml": ROBOT, "parts.bin": files[0], "robot.lock.yaml": LOCK % (b"0" * 64)}
    writes = ("robot.lock.yaml",)
    return [
        Kind("library", COMMANDS, examples, BYTE_MUTATIONS, writes=writes, weight=0.5),
        Kind("library in gzip", COMMANDS, examples[1:], inside, writes=writes, weight=0.5),
        Kind(
            "pinned library",
            (*COMMANDS, "check robot.yaml", "modules list robot.yaml"),
            [("robot.lock.yaml", lock), ("robot.yaml", lock)],
            YAML_MUTATIONS,
            writes=writes,
        ),
    ]


def _inside(change: Mutation) -> Mutation:
    """Returns a change of what a gzip file contains."""

    def changed(rng: random.Random, data: bytes) -> bytes:
        return gzip.compress(change(rng, gzip.decompress(data)), mtime=0)

    changed.__name__ = f"{change.__name__}_inside"
    return changed
