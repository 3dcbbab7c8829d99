"""The outputs of the examples, and the rule for golden files.

The text files that people read are golden files: URDF, MJCF, ROS 2 parameters and the files of the
bus; launch files, the long DCFs, the C header and the datasheet for one example only.  Of all
files, also of meshes, the model and files that repeat others, one list keeps the SHA-256, so no
byte changes without notice.
"""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

from thorvaldc.backends import DEFAULT_TARGETS
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = Path(__file__).parent
SUMS = GOLDEN / "SHA256SUMS"
EXAMPLES = {
    path.parent.name: path
    for path in sorted([*ROOT.glob("examples/*/robot.yaml"), *ROOT.glob("examples/*/fleet.yaml")])
}


def expected_sums(example: str) -> str:
    """Return the lines of the reviewed list for an example."""
    lines = SUMS.read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(line for line in lines if line.split()[1].startswith(f"{example}/"))


def expected_files(example: str) -> dict[str, str]:
    """Return the golden files of an example by path."""
    folder = GOLDEN / example
    return {
        path.relative_to(folder).as_posix(): path.read_bytes().decode()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def current_files(example: str) -> tuple[dict[str, str], str]:
    """Return the contents that these files should have, and the lines of the list, from a new
    build."""
    compilation = compile_file(EXAMPLES[example])
    if compilation.model is None:
        raise RuntimeError(f"{example}: {[d.message for d in compilation.report.errors]}")
    datasheet = ["datasheet"] if isinstance(compilation.model, Robot) else []
    files = emit(compilation.model, [*DEFAULT_TARGETS, *datasheet], compilation.report)
    sums = [f"{sha256(files[path]).hexdigest()}  {example}/{path}\n" for path in sorted(files)]
    golden = {path: files[path].decode() for path in sorted(files) if _is_golden(example, path)}
    return golden, "".join(sums)


WITH_LAUNCH = "4wd4ws_wide"  # a robot with most parts of a ROS 2 package
WITH_DCF = "1wd1ws_front"  # a robot with one motor controller
WITH_DATASHEET = "1wd1ws_front"  # a robot with few parts


def _is_golden(example: str, path: str) -> bool:
    if EXAMPLES[example].name == "fleet.yaml":
        return path.startswith("mjcf/")  # its robots are in other examples
    if path.startswith("can/dcf/") or path.endswith(".h"):
        return example == WITH_DCF
    if path.startswith("datasheet/"):
        return example == WITH_DATASHEET
    if path.startswith("ros2/"):
        # The launch files of the examples differ in names only; URDF, MJCF, meshes and the model
        # repeat other files.
        if path.startswith(("ros2/config/", "ros2/README.md")):
            return not path.endswith(".json")
        return example == WITH_LAUNCH and not path.startswith(
            ("ros2/urdf/", "ros2/meshes/", "ros2/mjcf/", "ros2/sdf/", "ros2/resource/")
        )
    # The JSON budget repeats the table.
    return path.startswith(("urdf/", "mjcf/", "can/")) and not path.endswith("budget.json")
