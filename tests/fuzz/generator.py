"""Hostile and broken files of every kind that a command reads.

Each kind has valid examples, commands that read it, and changes that suit its format.  A seed
determines the kind, the example, the changes and the command.
"""

from __future__ import annotations

import contextlib
import functools
import random
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.cli.conftest import GOOD
from tests.example_packages import PACKAGES
from tests.fuzz import mutations
from tests.fuzz.mutations import Mutation
from tests.fuzz.products import ONE, bombs, meshes, png_bomb, products

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
Files = Mapping[str, bytes]
"""The files of a case, by their path in its folder."""

SPECIAL = ("missing", "folder", "pipe", "device", "loop", "not permitted", "huge", "socket")
"""What a case puts at the place of the file instead of a changed one."""


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    - ``commands``: command lines that read it; ``BROKEN`` is its path.
    - ``examples``: name of the file to change, and all files, of each example.
    - ``schema``: name of the kind for ``thorvaldc schema``, if it has a schema.
    - ``writes``: first words of the paths that the commands may write.
    - ``weight``: relative number of cases.
    """

    name: str
    commands: Sequence[str]
    examples: Sequence[tuple[str, Files]]
    changes: Sequence[Mutation]
    schema: str | None = None
    writes: tuple[str, ...] = ()
    weight: float = 1.0


@dataclass(frozen=True)
class Case:
    """A folder and a command.

    - ``file``: path of the broken file.
    - ``special``: one of ``SPECIAL``, or empty.
    """

    seed: int
    kind: Kind
    file: str
    files: Files
    command: str
    special: str
    description: str


def case_of(seed: int) -> Case:
    """Returns the case of a seed; it is the same on every machine."""
    rng = random.Random(seed)
    all_kinds = kinds()
    kind = rng.choices(all_kinds, [kind.weight for kind in all_kinds])[0]
    file, files = rng.choice(kind.examples)
    command = rng.choice(kind.commands).replace("BROKEN", file)
    if kind.name != "plug-in" and rng.random() < 0.04:
        special = rng.choice(SPECIAL)
        return Case(seed, kind, file, files, command, special, special)
    data, names = files[file], []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        change = rng.choice(kind.changes)
        # A change of a structure needs one; an earlier change may have destroyed it.
        with contextlib.suppress(ValueError, TypeError, LookupError, RecursionError, struct.error):
            data = change(rng, data)[:4_000_000]
            names.append(change.__name__)
    return Case(seed, kind, file, {**files, file: data}, command, "", ", ".join(names))


# -- kinds --------------------------------------------------------------------------------

YAML, JSON = mutations.YAML_MUTATIONS, mutations.JSON_MUTATIONS
XML, CSV = mutations.XML_MUTATIONS, mutations.CSV_MUTATIONS
BYTES, TEXT = mutations.BYTE_MUTATIONS, mutations.TEXT_MUTATIONS
STORE = "can {} robot.yaml --bus virtual:delivered --store store.json"
JOURNAL = "can flash robot.yaml --bus virtual:delivered --store store.json --yes --journal {} --{}"
RUN = "--bus virtual --fast --duration 0.1"


@functools.cache
def kinds() -> tuple[Kind, ...]:
    """Returns all kinds of files."""
    from tests.fuzz.imported_files import imported_kinds, named_kinds  # which need `Kind`
    from tests.fuzz.library_archives import library_kinds

    known = (*_documents(), *_bus_files(), *_logs(), *_shapes(), *_others())
    return (*known, *imported_kinds(), *named_kinds(), *_audited(), *library_kinds())


def _read(path: str) -> bytes:
    return (ROOT / path).read_bytes()


def _audited() -> tuple[Kind, ...]:
    """Returns the files of a robot of other programs."""
    folder = ROOT / "tests/tools/audit/robots/cart"
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
    changes = {".yaml": YAML, ".yml": YAML, ".py": TEXT, ".stl": BYTES}
    by_suffix: dict[str, list[tuple[str, Files]]] = {}
    for path in paths:
        by_suffix.setdefault(path.suffix, []).append((path.relative_to(folder).as_posix(), files))
    return tuple(
        Kind(f"audited {suffix}", ["audit ."], examples, changes.get(suffix, XML), weight=0.5)
        for suffix, examples in by_suffix.items()
    )


def _robots() -> list[tuple[str, Files]]:
    """Returns the robots of the examples, with the files beside them."""
    robots = []
    for path in sorted(EXAMPLES.glob("*/robot.yaml")):
        beside = {
            file.relative_to(path.parent).as_posix(): file.read_bytes()
            for file in path.parent.rglob("*")
            if file.suffix in (".xacro", ".stl")
        }
        if path.parent.name not in PACKAGES:  # its driver is another package
            robots.append(("robot.yaml", {"robot.yaml": path.read_bytes(), **beside}))
    return [*robots, ("robot.yaml", {"robot.yaml": (GOOD + FOREIGN).encode()})]


FOREIGN = """\
foreign_devices:
  sprayer:
    frames:
      go: {cob_id: 0x205, extended: true, direction: command, rate: 10 Hz}
      state: {cob_id: {priority: 6, pgn: 0xFF50, source: 1}, direction: report, rate: 10 Hz}
"""
DEVICE = """\
thorvaldc: 1
description: A device with 29-bit identifiers and big-endian signals.
can:
  protocol: mine
  frames:
    status:
      cob_id: "${0x900 + id}"
      extended: true
      kind: broadcast
      direction: report
      length: 8
      period: 100 ms
      signals:
        speed: {start: 7, length: 32, big_endian: true, signed: true, unit: rad/s, scale: 0.1}
        level: {start: 32, length: 12}
"""
PART = GOOD + "  part: {type: TYPE, mount: {parent: frame}}\nlibrary: [lib]\n"
SCENARIO = """\
thorvaldc: 1
scenario: trial
robots: {cart: {robot: robot.yaml}, other: {robot: robot.yaml, xyz: [0, 5 m, 0]}}
duration: 0.2 s
world:
  ground: {type: rough, amplitude: 10 mm, seed: 3, size: [20 m, 20 m]}
  obstacles: {post: {shape: cylinder, xyz: [4 m, 0, 0], radius: 50 mm, height: 1 m}}
  kerbs: [{from: [3 m, -4 m], to: [3 m, 4 m], height: 35 mm, width: 200 mm}]
script: [{at: 0, vx: 0.5 m/s, robot: cart}, {at: 0.1, vx: 0.3, wz: 0.4 rad/s}]
faults: [{type: ice, wheel: fl_wheel, friction: 0.05, at: 0.1 s, until: 0.2 s, robot: cart}]
noise: {seed: 1, wheel_speed: 0.01 rad/s}
expect: {end_error: {max: 5 m}}
"""
FLEET = """\
thorvaldc: 1
fleet: pair
robots:
  first: {robot: robot.yaml}
  second: {robot: robot.yaml, xyz: [0, 3 m, 0], yaw: 90 deg}
"""
CALIBRATION = """\
thorvaldc: 1
robot: good
wheels:
  fl_wheel: {radius: 201.5 mm, steering_offset: 1.0 deg}
  rr_wheel: {radius: 198.4 mm, steering_offset: 0.8 deg}
"""
STUDY = """\
thorvaldc: 1
study: track
robot: robot.yaml
variables:
  track: {paths: [modules.frame.params.width], min: 0.8 m, max: 1.2 m}
  drive: {paths: [modules.fl.type], values: [assembly/fixed_drive, assembly/steered_drive]}
constraints: {tip_over: {fact: stability.angles.left, at_least: 25 deg}}
scenarios: {drive_on: {scenario: drive.yaml}}
objectives: {energy: {metric: drive_on.energy, goal: minimise}, light: {fact: mass, goal: minimise}}
samples: {method: random, number: 4, seed: 1}
"""
STUDY_SCENARIO = """\
thorvaldc: 1
scenario: drive
robots: {good: {robot: robot.yaml}}
duration: 0.2 s
script: [{at: 0, vx: 0.5 m/s}]
"""
SCENARIO_COMMANDS = (
    "check scenario.yaml",
    "scenario scenario.yaml --set duration=0.1",
    "batch scenario.yaml --set duration=0.1 --jobs 1 --draws 1",
)


def _documents() -> list[Kind]:
    good = {"robot.yaml": GOOD.encode()}
    modules = []
    for path in sorted((ROOT / "modules").glob("*/*/module.yaml")):
        name = path.parent.relative_to(ROOT / "modules").as_posix()
        beside = {
            f"lib/{name}/{file.relative_to(path.parent).as_posix()}": file.read_bytes()
            for file in path.parent.rglob("*")
            if file.is_file()
        }
        robot = PART.replace("TYPE", name).encode()
        modules.append((f"lib/{name}/module.yaml", {"robot.yaml": robot, **beside}))
    name = "lib/my/device/module.yaml"
    robot = PART.replace("TYPE", "my/device").replace(", mount: {parent: frame}", ", can: 5")
    modules.append((name, {"robot.yaml": robot.encode(), name: DEVICE.encode()}))
    fleet_files = {**good, "fleet.yaml": FLEET.encode()}
    scenarios = [("scenario.yaml", {**good, "scenario.yaml": SCENARIO.encode()})]
    for path in sorted((EXAMPLES / "scenarios").glob("*.yaml")):
        text = path.read_text("utf-8").replace("../", f"{EXAMPLES}/")
        scenarios.append(("scenario.yaml", {"scenario.yaml": text.encode()}))
    calibrated = (GOOD + "calibration: wheels.yaml\n").encode()
    return [
        Kind(
            "robot",
            (
                *("check robot.yaml", "check robot.yaml --format json"),
                *("check robot.yaml --format sarif", "check robot.yaml --format github"),
                *("build robot.yaml -o out", "sim robot.yaml --ideal --duration 0.1 --json"),
                *(f"run robot.yaml {RUN}", "can plan robot.yaml --bus virtual"),
                *("view robot.yaml --html -o out.html", "check robot.yaml --strict"),
                *("info robot.yaml", "info robot.yaml --json", "why robot.yaml mass"),
                *("diff robot.yaml robot.yaml", "build robot.yaml --target datasheet -o out"),
                "upgrade --dry-run robot.yaml",
            ),
            _robots(),
            YAML,
            schema="robot",
            writes=("out", "robot.lock.yaml"),
            weight=4,
        ),
        Kind(
            "module",
            (
                *("check robot.yaml", "modules check lib", "modules list --library lib"),
                "upgrade --dry-run robot.yaml BROKEN",
            ),
            modules,
            YAML,
            schema="module",
            weight=3,
        ),
        Kind(
            "fleet",
            (
                *("check fleet.yaml", "build fleet.yaml -o out", "info fleet.yaml"),
                "sim fleet.yaml --ideal --duration 0.1",
            ),
            [("fleet.yaml", fleet_files), ("robot.yaml", fleet_files)],
            YAML,
            schema="fleet",
            writes=("out", "robot.lock.yaml"),
        ),
        Kind(
            "scenario",
            SCENARIO_COMMANDS,
            scenarios,
            YAML,
            schema="scenario",
            weight=2,
        ),
        Kind(
            "study",
            ("check study.yaml", "study best study.yaml -o best.yaml --by light"),
            [
                (
                    "study.yaml",
                    {
                        **good,
                        "drive.yaml": STUDY_SCENARIO.encode(),
                        "study.yaml": STUDY.encode(),
                    },
                )
            ],
            YAML,
            schema="study",
            writes=("best.yaml",),
        ),
        Kind(
            "calibration",
            ("check robot.yaml", "build robot.yaml -o out", "calibrate joints.csv robot.yaml"),
            [
                (
                    "wheels.yaml",
                    {
                        "robot.yaml": calibrated,
                        "wheels.yaml": CALIBRATION.encode(),
                        "joints.csv": products()["joints.csv"],
                    },
                )
            ],
            YAML,
            schema="calibration",
            writes=("out",),
        ),
    ]


FAULTS = """\
thorvaldc: 1
seed: 3
faults:
  - {fault: noise, share: 2 %, at: 0 s}
  - {fault: power_cut, node: fl_controller, at: 0.02 s, for: 20 ms}
  - {fault: frozen_encoder, node: fl_controller, channel: steering, at: 0.01 s, for: 3 s}
  - {fault: emcy, node: fl_controller, code: 0x3210, at: 0.05 s}
"""


def _bus_files() -> list[Kind]:
    made = products()
    one = {"robot.yaml": ONE.encode()}
    flashed = {**one, "store.json": made["flashed.json"], "j.jsonl": made["whole.jsonl"]}
    lines = made["whole.jsonl"].splitlines(True)
    stopped = {**one, "store.json": b"{}", "j.jsonl": b"".join(lines[: len(lines) // 2])}
    lock = {"robot.yaml": ONE.encode(), "robot.lock.yaml": made["one.lock.yaml"]}
    return [
        Kind(
            "injected faults",
            (f"run robot.yaml {RUN} --faults faults.yaml",),
            [
                ("faults.yaml", {**one, "faults.yaml": FAULTS.encode()}),
                (
                    "faults.yaml",
                    {
                        "robot.yaml": _read("examples/4wd4ws_wide/robot.yaml"),
                        "faults.yaml": _read("examples/bus_faults/bad_day.yaml"),
                    },
                ),
            ],
            YAML,
            schema="bus_faults",
        ),
        Kind(
            "device store",
            tuple(STORE.format(word) for word in ("plan", "scan", "scan", "verify", "flash")),
            [("store.json", flashed)],
            JSON,
            schema="device_memory",
            writes=("store.json",),
        ),
        Kind(
            "journal",
            tuple(JOURNAL.format("j.jsonl", word) for word in ("apply", "resume", "rollback")),
            [("j.jsonl", flashed), ("j.jsonl", stopped)],
            mutations.JOURNAL_MUTATIONS,
            writes=("j.jsonl", "store.json"),
            weight=1.5,
        ),
        Kind(
            "lock file",
            ("check robot.yaml", "build robot.yaml -o out", "can plan robot.yaml --bus virtual"),
            [("robot.lock.yaml", lock)],
            YAML,
            writes=("out", "robot.lock.yaml"),
        ),
        Kind(
            "model",
            (
                *(f"run model.json {RUN}", "can plan model.json --bus virtual"),
                *("can verify model.json --bus virtual", "can scan model.json --bus virtual"),
                *(f"run model.json {RUN} --json", "can plan model.json --bus virtual --json"),
                "faults model.json -j 1 --only killed",
            ),
            [("model.json", {"model.json": made["built/model.json"]})],
            JSON,
            weight=3,
        ),
        Kind(
            "manifest",
            ("build robot.yaml -o built --target can",),
            [("built/manifest.json", {**one, "built/manifest.json": made["built/manifest.json"]})],
            JSON,
            writes=("built", "robot.lock.yaml"),
            weight=0.5,
        ),
    ]


LOG_SCENARIO = """\
thorvaldc: 1
scenario: trial
robots: {{cart: {{robot: robot.yaml}}}}
duration: 0.1 s
script: {{log: {}}}
"""


def _logs() -> list[Kind]:
    made = products()
    good = {"robot.yaml": GOOD.encode()}
    table = b"time,vx,vy,wz\n0,0.5,0,0\n0.1,0.5,,0.1\n1.5,0.2,0,-1e-3\n2,0,0,0\n"
    bags = {
        f"log{Path(name).suffix}": made[name]
        for name in made
        if Path(name).suffix in (".mcap", ".db3", ".bag") and "record" not in name
    }
    records = {name: made[name] for name in ("record.csv", "record.mcap")}
    bag_folder = {name: made[name] for name in made if name.startswith("bag_db3/")}
    first = next(name for name in bag_folder if name.endswith(".db3"))
    return [
        Kind(
            "joint log",
            ("calibrate joints.csv robot.yaml", "calibrate joints.csv robot.yaml -o out.yaml"),
            [("joints.csv", {**good, "joints.csv": made["joints.csv"]})],
            CSV,
            writes=("out.yaml",),
        ),
        Kind(
            "bomb in a bag",
            ("check scenario.yaml",),
            [
                (
                    "record.mcap",
                    {
                        **good,
                        "record.mcap": data,
                        "scenario.yaml": LOG_SCENARIO.format("record.mcap").encode(),
                    },
                )
                for data in bombs()
            ],
            (mutations.unchanged, mutations.unchanged, mutations.set_number),
            weight=0.2,
        ),
        Kind(
            "twist log",
            SCENARIO_COMMANDS[:2],
            [
                (name, {**good, name: data, "scenario.yaml": LOG_SCENARIO.format(name).encode()})
                for name, data in {"log.csv": table, **records, **bags}.items()
            ],
            (*BYTES, *CSV),
            weight=1.5,
        ),
        Kind(
            "bag",
            SCENARIO_COMMANDS[:2],
            [
                (
                    name,
                    {
                        **good,
                        **bag_folder,
                        "scenario.yaml": LOG_SCENARIO.format("bag_db3").encode(),
                    },
                )
                for name in ("bag_db3/metadata.yaml", first)
            ],
            (*BYTES, *YAML),
        ),
    ]


EXTRA = GOOD + "extras: [{xacro: FILE, parent: frame}]\n"
URDF = """\
<?xml version="1.0"?>
<robot name="extra">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="top">
    <inertial><mass value="2.5"/><origin xyz="0 0 0.1" rpy="0 0 0"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
    <visual><geometry><mesh filename="{0}" scale="1 1 1"/></geometry></visual>
    <collision><origin xyz="0 0 0.1"/><geometry><mesh filename="{0}"/></geometry></collision>
  </link>
  <joint name="turn" type="revolute"><parent link="top"/><child link="tip"/>
    <origin xyz="0 0 0.4" rpy="0 0.1 0"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="10" velocity="2"/><dynamics damping="0.1"/></joint>
  <link name="tip"><inertial><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
    <collision><geometry><cylinder radius="0.05" length="0.3"/></geometry></collision></link>
  <ros2_control name="arm" type="system"><hardware><plugin>x/Y</plugin></hardware>
    <joint name="turn"><command_interface name="position"/></joint></ros2_control>
</robot>
"""
PACKAGE = b"""<?xml version="1.0"?>
<package format="3"><name>parts</name><version>1.0.0</version><description>x</description>
<maintainer email="a@b.c">a</maintainer><license>MIT</license></package>
"""


def _shapes() -> list[Kind]:
    commands = ("check robot.yaml", "check robot.yaml", "build robot.yaml -o out")
    by_suffix = {}
    for suffix, data in meshes().items():
        file = f"mesh.{suffix}"
        files = {
            "robot.yaml": EXTRA.replace("FILE", "extra.urdf").encode(),
            "extra.urdf": URDF.format(file).encode(),
            "texture.png": png_bomb(),
            file: data,
        }
        by_suffix[suffix] = (file, files)
    urdf = {**by_suffix["stl"][1]}
    xacro = {
        "robot.yaml": EXTRA.replace("FILE", "head.xacro").encode(),
        "head.xacro": _read("examples/4wd2ws_tall/sensor_head.xacro"),
        **{
            f"meshes/{name}.stl": _read(f"examples/4wd2ws_tall/meshes/{name}.stl")
            for name in ("hood", "lamp")
        },
    }
    found = {
        "robot.yaml": EXTRA.replace("FILE", "parts/urdf/extra.urdf").encode(),
        "parts/urdf/extra.urdf": URDF.format("package://parts/mesh.stl").encode(),
        "parts/mesh.stl": meshes()["stl"],
        "parts/package.xml": PACKAGE,
    }

    def of(suffixes: Sequence[str]) -> list[tuple[str, Files]]:
        return [by_suffix[suffix] for suffix in suffixes]

    return [
        Kind("URDF", commands, [("extra.urdf", urdf)], XML, writes=("out",), weight=1.5),
        Kind("xacro", commands, [("head.xacro", xacro)], XML, writes=("out",), weight=0.7),
        Kind(
            "package.xml",
            commands,
            [("parts/package.xml", found)],
            XML,
            writes=("out",),
            weight=0.3,
        ),
        Kind("binary mesh", commands, of(["stl"]), BYTES, writes=("out",), weight=1),
        Kind("text mesh", commands, of(["text.stl", "obj"]), TEXT, writes=("out",), weight=1),
        Kind(
            "converted mesh",
            commands,
            of(["ply", "off", "glb", "ply", "off", "glb"]),
            (*BYTES, *TEXT),
            writes=("out",),
            weight=0.6,
        ),
        Kind("glb", commands, of(["glb"]), (mutations.change_glb,), writes=("out",), weight=0.3),
        Kind("glTF", commands, of(["gltf"]), JSON, writes=("out",), weight=0.3),
        Kind("Collada", commands, of(["dae"]), XML, writes=("out",), weight=0.4),
    ]


def _others() -> list[Kind]:
    plugin = {
        "robot.yaml": GOOD.replace("modules:", "base_calculator: other\nmodules:", 1).encode(),
        "plugins/other-1.dist-info/METADATA": b"Metadata-Version: 2.1\nName: other\nVersion: 1\n",
        "plugins/other-1.dist-info/entry_points.txt": (
            b"[thorvaldc.backends]\nother = other_part:Other\n\n"
            b"[thorvaldc.base_calculators]\nother = other_part:Other\n"
        ),
        "plugins/other_part.py": b"class Other:\n    name = 'other'\n",
    }
    return [
        Kind(
            "plug-in",
            ("targets", "check robot.yaml", "build robot.yaml -o out -t urdf,other"),
            [
                (f"plugins/other-1.dist-info/{name}", plugin)
                for name in ("METADATA", "entry_points.txt")
            ]
            + [("plugins/other_part.py", plugin)],
            TEXT,
            writes=("out", "plugins/__pycache__"),
            weight=0.5,
        ),
    ]
