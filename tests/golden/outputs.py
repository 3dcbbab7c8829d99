"""What an example is compiled to, and which of it is kept whole.

Kept whole are the texts that people read: URDF, MJCF, ROS 2 parameters and what is
said of the bus (the long DCFs and the C header of one example alone).  Of the rest
(meshes, the model, and what repeats another file) the SHA-256 is kept, so that no
byte changes unseen.
"""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

from thorvaldc.backends import DEFAULT_TARGETS
from thorvaldc.compiler.pipeline import compile_file, emit

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = Path(__file__).parent
SUMS = "SHA256SUMS"
EXAMPLES = {
    path.parent.name: path
    for path in sorted([*ROOT.glob("examples/*/robot.yaml"), *ROOT.glob("examples/*/fleet.yaml")])
}


def expected_files(example: str) -> dict[str, str]:
    """The golden files of an example by path."""
    folder = GOLDEN / example
    return {
        path.relative_to(folder).as_posix(): path.read_bytes().decode()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def made_files(example: str) -> dict[str, str]:
    """What those files would be now."""
    done = compile_file(EXAMPLES[example])
    if done.model is None:
        raise RuntimeError(f"{example}: {[d.message for d in done.report.errors]}")
    files = emit(done.model, DEFAULT_TARGETS, done.report)
    sums = [f"{sha256(files[path]).hexdigest()}  {path}\n" for path in sorted(files)]
    kept = {path: files[path].decode() for path in sorted(files) if _is_kept(example, path)}
    return {**kept, SUMS: "".join(sums)}


WITH_DCF = "1wd1ws_front"  # it has one controller


def _is_kept(example: str, path: str) -> bool:
    if EXAMPLES[example].name == "fleet.yaml":
        return path.startswith("mjcf/")  # the robots are those of other examples
    if path.startswith("can/dcf/") or path.endswith(".h"):
        return example == WITH_DCF
    # The description in the ROS 2 parameters is the URDF once more, the budget a table.
    return path.startswith(("urdf/", "mjcf/", "ros2/", "can/")) and not path.endswith(
        ("robot_state_publisher.yaml", "budget.json")
    )
