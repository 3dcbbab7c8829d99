"""Reads ROS bags.

A ROS bag is an MCAP file, a folder written by ``ros2 bag record``, or a ROS 1 bag file.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.compiler.sandbox.worker_process import WorkerLimitError, WorkerLimits, limited_worker
from thorvaldc.diagnostics import OutsideError, Report, Span
from thorvaldc.diagnostics.files import MAX_LOG_BYTES, check_regular, read_bounded
from thorvaldc.diagnostics.installation import install_command

ODOM, TRUE_ODOM = "odom", "ground_truth/odom"
COMMANDED_TWIST, LIMITED_TWIST = "cmd_vel", "cmd_vel_limited"
JOINTS, COMMANDS = "joint_states", "joint_commands"
DESCRIPTION = "robot_description"
TYPES = {
    ODOM: "nav_msgs/msg/Odometry",
    TRUE_ODOM: "nav_msgs/msg/Odometry",
    COMMANDED_TWIST: "geometry_msgs/msg/TwistStamped",
    LIMITED_TWIST: "geometry_msgs/msg/TwistStamped",
    JOINTS: "sensor_msgs/msg/JointState",
    COMMANDS: "sensor_msgs/msg/JointState",
}
"""ROS message type of each topic of a robot.  The topic names have no namespace."""
SUFFIXES = (".mcap", ".db3", ".bag")
"""File name suffixes of ROS bags.  A folder is a bag if it contains ``metadata.yaml``."""
_LIMITS = WorkerLimits(
    wall_seconds=120.0,
    processor_seconds=30,
    memory_bytes=384 << 20,  # the interpreter and its packages need a third of it
    file_bytes=MAX_LOG_BYTES,  # a bag may be unpacked to temporary files
)
_MAX_METADATA_BYTES = 1_000_000
# A message in memory needs some 1.5 kB and its data.  A compressed bag of short messages needs 20
# times its size.
_MESSAGE_OVERHEAD = 1500
_MEMORY_OF_SMALL_BAG = 256_000_000
_EXPANSION = 25


class MissingPackageError(OutsideError):
    """An optional Python package is not installed; the message explains how to install it."""


def require_rosbags() -> None:
    """Raises ``MissingPackageError`` if the package ``rosbags`` is not installed."""
    try:
        import rosbags.rosbag2  # noqa: F401
    except ImportError:
        raise MissingPackageError(
            f"MCAP files require rosbags, which is not installed: {install_command('record')}"
        ) from None


@dataclass(frozen=True, slots=True)
class Bag:
    """Messages on selected topics of a ROS bag.

    - ``topics``: message type of every topic in the bag.
    - ``messages``: list of tuples (time, message) for each selected topic, in order of time.  The
      times of the messages are in seconds since the start of the ROS bag.
    """

    topics: Mapping[str, str]
    messages: Mapping[str, list[tuple[float, Any]]]


def is_bag(path: Path) -> bool:
    """Returns whether a file or folder is a ROS bag.

    A ROS bag file is recognised by its suffix, and a ROS bag folder by its file ``metadata.yaml``.
    """
    return path.suffix.lower() in SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(
    path: Path,
    display: str,
    span: Span,
    choose: Callable[[Mapping[str, str]], Collection[str]],
    report: Report,
) -> Bag | None:
    """Reads selected topics from a ROS bag.  Returns ``None`` if the ROS bag is not readable.

    - ``display``: name of the bag in messages.
    - ``span``: source span of the diagnostics about the bag.
    - ``choose``: function that receives the message type of every topic in the bag and returns the
      names of the topics to read.

    Raises ``MissingPackageError`` if the package ``rosbags`` is not installed.
    """
    require_rosbags()
    try:
        memory = _MEMORY_OF_SMALL_BAG + _EXPANSION * _check_files(path)
        _check_in_worker(path)
        with _open(path) as reader:
            topics = {c.topic: c.msgtype for c in reader.connections}
            selected = set(choose(topics))
            messages: dict[str, list[tuple[float, Any]]] = {
                name: [] for name in topics if name in selected
            }
            connections = [c for c in reader.connections if c.topic in selected]
            size = 0
            # If the list of connections is empty, the package rosbags reads all topics.
            for connection, time, data in reader.messages(connections) if connections else ():
                size += len(data)
                memory -= len(data) + _MESSAGE_OVERHEAD
                if size > MAX_LOG_BYTES:  # of uncompressed messages
                    raise OSError(f"its messages have more than {MAX_LOG_BYTES / 1e6:g} MB")
                if memory < 0:
                    raise OSError("its messages have many times the size of the file")
                message = reader.deserialize(data, connection.msgtype)
                seconds = (time - reader.start_time) / 1e9
                messages[connection.topic].append((seconds, message))
            return Bag(topics, messages)
    except Exception as error:  # rosbags raises many types of exceptions for a damaged bag
        reason = " ".join(str(error).split()).replace(str(path), path.name).rstrip(".")
        report.add(
            "record-unreadable",
            f"`{display}` cannot be read as a ROS bag: {reason or type(error).__name__}",
            span,
            hint="if the file is truncated, `mcap recover` may repair it"
            if _is_mcap(path)
            else None,
        )
        return None


def _open(path: Path) -> Any:
    """Returns the reader of a bag as a context manager."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    return AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))


def _check_files(path: Path) -> int:
    """Returns the number of bytes in the files of a ROS bag.

    Raises ``OSError`` if a file is no regular file, or if the files are too large.
    """
    size = 0
    for file in path.iterdir() if path.is_dir() else [path]:
        if file.suffix.lower() in (*SUFFIXES, ".zstd", ".yaml"):
            status = os.stat(file)
            check_regular(status)
            size += status.st_size
            limit = _MAX_METADATA_BYTES if file.suffix.lower() == ".yaml" else MAX_LOG_BYTES
            if status.st_size > limit:
                raise OSError(f"{file.name} has more than {limit / 1e6:g} MB")
    return size


def answer(request: dict[str, Any], _: bytes) -> tuple[dict[str, Any], bytes]:
    """Reads the bag of a request in a limited worker process, see ``worker_protocol``.

    A bag of some kilobytes can expand to gigabytes, or state that it does, by its compressed chunks
    or its index.  The compiler reads a bag only after the worker process has read it.
    """
    try:
        with _open(Path(request["bag"])) as reader:
            for _ in reader.messages():
                pass
    except MemoryError:
        raise
    except Exception as error:  # rosbags raises many types of exceptions for a damaged bag
        # lz4 raises RuntimeError if it has no memory.
        if isinstance(error.__context__, MemoryError) or "resize buffer" in str(error):
            raise MemoryError from error
        return {"error": " ".join(str(error).split())[:300] or type(error).__name__}, b""
    return {}, b""


def _check_in_worker(path: Path) -> None:
    """Raises ``OSError`` if a worker process with limits cannot read a bag."""
    folders = [os.path.abspath(folder) for folder in sys.path]
    imports = ["rosbags.highlevel", "rosbags.typesys"]
    with limited_worker(__name__, _LIMITS, path=folders, imports=imports) as worker:
        try:
            problem, _ = worker.ask({"bag": str(path.absolute())})
        except WorkerLimitError as error:
            raise OSError(f"it {error}") from error
    if problem:
        raise OSError(problem["error"])


def _is_mcap(path: Path) -> bool:
    try:
        return read_bounded(path, 8, cut=True) == b"\x89MCAP0\r\n"
    except OSError:
        return False
