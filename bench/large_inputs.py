"""Ten times as large: 1,000 robots, modules and files, a bus at 90 % load, a record of eight hours.

Every figure is information.  A growth is a processor time over ten times that of the tenth part, so
that 1 is linear.
"""

from __future__ import annotations

import gc
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from bench.bus_traffic import loaded_bus, reached
from bench.figure import EXAMPLE, ROOT, Figure, python
from bench.growth import robot
from thorvaldc.backends import DEFAULT_TARGETS
from thorvaldc.backends.mjcf import simulation_files
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.scenario import GROUPS
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.records.csv_record import CsvRecorder
from thorvaldc.simulation.records.recorder import record_ticks
from thorvaldc.simulation.simulation_run import Simulation

GROUP = "long"

MEASURE = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
print(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)
"""
HOURS, RATE, SEEDS = 8.0, 10.0, 10
DRIVE, TICKS = Twist(0.5, 0.0, 0.1), 10


def figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        yield from _fleets(folder)
        yield _modules(folder)
        yield from _repositories(folder)
        yield _record(folder)
    yield _bus()


def _growth(name: str, small: float, large: float, how: str) -> Figure:
    return Figure(name, large / small / 10.0, "", None, "lower", how)


def _time(function: Callable[..., object], *arguments: object) -> float:
    """Returns the processor time (s) of a call, without garbage collection as in a command."""
    gc.disable()
    start = time.process_time()
    function(*arguments)
    gc.enable()
    return time.process_time() - start


def _fleets(folder: Path) -> Iterator[Figure]:
    emits, loads, ticks = [], [], []
    for columns in (10, 100):
        path = folder / "fleet.yaml"
        path.write_text(
            f"thorvaldc: 1\nname: many\nrobots:\n  r: {{robot: {EXAMPLE},"
            f" grid: {{rows: 10, columns: {columns}, spacing: 3 m}}}}\n",
            encoding="utf-8",
        )
        fleet = compile_file(path).model
        if not isinstance(fleet, Fleet):
            raise SystemExit("the fleet does not compile")
        emits.append(_time(emit, fleet, DEFAULT_TARGETS))
        files = simulation_files(fleet)
        loads.append(_time(MujocoScene, files))
        simulation = Simulation(fleet, files)
        start = _time(simulation.run, 0.02, DRIVE)
        ticks.append((_time(simulation.run, 0.22, DRIVE) - start) / TICKS)
    yield _growth(
        "emit from 100 to 1,000 robots",
        *emits,
        f"default targets: {emits[0]:.1f} s, {emits[1]:.0f} s",
    )
    yield _growth(
        "load from 100 to 1,000 robots",
        *loads,
        f"MuJoCo reads and compiles the scene: {loads[0]:.1f} s, {loads[1]:.0f} s; it joins groups"
        " of robots in a time that grows with the square of their number",
    )
    yield _growth(
        "tick from 100 to 1,000 robots",
        *ticks,
        f"drivers and physics in one scene: {ticks[0] * 1e3:.0f} ms, {ticks[1] * 1e3:.0f} ms",
    )


def _modules(folder: Path) -> Figure:
    times = []
    numbers = []
    for rows, columns in ((4, 9), (15, 24)):
        path = folder / "grid.yaml"
        path.write_text(robot(rows, columns), encoding="utf-8")
        model = compile_file(path).model
        if not isinstance(model, Robot):
            raise SystemExit("the robot does not compile")
        numbers.append(len({link.module for link in model.links}))
        times.append(_time(compile_file, path) + _time(emit, model, DEFAULT_TARGETS))
    return _growth(
        "1,000 modules in one robot",
        *times,
        f"compile and emit of {numbers[0]} modules {times[0]:.2f} s,"
        f" of {numbers[1]} {times[1]:.1f} s",
    )


def _repositories(folder: Path) -> Iterator[Figure]:
    """Measures commands on git repositories of 100 and 1,000 robots, with their URDF files."""
    used: dict[str, list[tuple[float, float]]] = {"check": [], "audit": [], "diff": []}
    text = EXAMPLE.read_text(encoding="utf-8")
    model = compile_file(EXAMPLE).model
    if not isinstance(model, Robot):
        raise SystemExit("the example does not compile")
    for number in (0, 100, 1000):
        repository = folder / f"{number}"
        for k in range(max(number, 1)):
            robot_folder = repository / f"r{k}"
            for path, data in {**emit(model, ["urdf"]), "robot.yaml": text.encode()}.items():
                file = robot_folder / path
                file.parent.mkdir(parents=True, exist_ok=True)
                if file.suffix != ".stl":
                    file.write_bytes(data)
        git = [
            "git",
            "-C",
            str(repository),
            "-c",
            "user.name=bench",
            "-c",
            "user.email=bench@localhost",
        ]
        for arguments in (["init"], ["add", "."], ["commit", "-m", "all"]):
            subprocess.run([*git, *arguments], check=True, capture_output=True)
        files = [str(path) for path in sorted(repository.rglob("robot.yaml"))]
        commands = {
            "check": files,
            "audit": [str(repository)],
            "diff": ["HEAD:r0/robot.yaml", "r0/robot.yaml"],
        }
        for command, arguments in commands.items():
            used[command].append(_used(command, arguments, repository))
    for command, ((start, _), (small, small_memory), (large, memory)) in used.items():
        yield _growth(
            f"{command} of 1,000 robot files",
            small - start,
            large - start,
            f"{small:.1f} s and {small_memory:.0f} MB for 100 robots with their URDF in a git"
            f" repository, {large:.1f} s and {memory:.0f} MB for 1,000; without the {start:.2f} s"
            " of a single one",
        )


def _used(command: str, arguments: list[str], folder: Path) -> tuple[float, float]:
    """Returns the processor time (s) and the peak memory (MB) of a command."""
    run = python("-c", MEASURE, *python("-m", "thorvaldc", command, *arguments))
    environment = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"}
    process = subprocess.run(
        run, cwd=folder, env=environment, check=True, capture_output=True, text=True
    )
    seconds, memory = map(float, process.stdout.split())
    return seconds, memory


def _record(folder: Path) -> Figure:
    """Measures the ``check`` of a scenario whose script is a CSV record of one drive, repeated."""
    model = compile_file(EXAMPLE).model
    if not isinstance(model, Robot):
        raise SystemExit("the example does not compile")
    path = folder / "run.csv"
    recorder = CsvRecorder(path, [(model.name, model)], GROUPS)
    Simulation(model).run(20.0, DRIVE, on_tick=record_ticks([recorder]))
    recorder.close()
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    values = [line.partition(",")[2] for line in lines]
    number = round(HOURS * 3600 * RATE)
    with path.open("w", encoding="utf-8") as stream:
        stream.write(header + "\n")
        stream.writelines(f"{k / RATE:g},{values[k % len(values)]}\n" for k in range(number))
    scenario = folder / "scenario.yaml"
    scenario.write_text(
        f"thorvaldc: 1\nscenario: long\nrobots: {{robot: {{robot: {EXAMPLE}}}}}\n"
        "duration: 1 s\nscript: {log: run.csv}\n"
    )
    seconds, memory = _used("check", [str(scenario)], folder)
    return Figure(
        f"memory of a record of {HOURS:g} hours",
        memory,
        "MB",
        None,
        "lower",
        f"`check` of a scenario with a CSV record of all groups at {RATE:g} Hz: {number} samples of"
        f" {1 + values[0].count(',') + 1} numbers, {path.stat().st_size / 1e6:.0f} MB, in"
        f" {seconds:.0f} s",
    )


def _bus() -> Figure:
    bus = loaded_bus()
    start = time.process_time()
    result = reached(bus, SEEDS)
    seconds = time.process_time() - start
    late = [f for f in bus.frames if f.deadline and (f.response_time or 0.0) > f.deadline]
    return Figure(
        "a bus at 90 % load",
        max(result.of_sent.values()),
        "",
        None,
        "lower",
        f"longest response time over its bound, {len(bus.frames)} frames, load"
        f" {100 * bus.load:.1f} %, {SEEDS} seeds on a simulated wire in {seconds:.0f} s; the"
        f" compiler reports such a bus, on which {len(late)} frames can be late",
    )
