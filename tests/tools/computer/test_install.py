"""Installation of a robot in the file system of a computer."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.child_process import ChildProcess, before_other_processes
from tests.cli.conftest import GOOD, Command
from tests.tools.computer.conftest import tree
from thorvaldc.tools.computer.installed_versions import Computer

NAME = "/etc/thorvaldc/good"
TOP = "  top: {type: tool/plate, mount: {parent: frame, xyz: [0, 0, 0.3]}}\n"
UNIT = "/etc/systemd/system/thorvaldc-good.service"


def read(root: Path, path: str) -> str:
    """Reads a file of a computer through its links."""
    place = Computer(root).path(path)
    for _ in range(9):
        if not place.is_symlink():
            for parent in place.parents:
                if parent.is_symlink():
                    link = os.readlink(parent)
                    place = parent.parent / link / place.relative_to(parent)
                    break
            else:
                return place.read_text(encoding="utf-8")
            continue
        place = Computer(root).path(os.readlink(place))
    raise AssertionError(path)


def test_what_an_installation_makes_and_a_removal_removes(root: Path, thorvaldc: Command) -> None:
    before = tree(root)
    planned = thorvaldc("install", "good.yaml", "--root", str(root), "--dry-run")
    assert planned.status == 0
    assert tree(root) == before
    outcome = thorvaldc("install", "good.yaml", "--root", str(root))
    assert (outcome.status, outcome.out) == (0, planned.out)
    assert f"link {UNIT}" in outcome.out
    assert "ExecStart=/opt/thorvaldc-env/bin/thorvaldc run /var/lib/thorvaldc/good/" in read(
        root, UNIT
    )
    assert "BitRate=500000" in read(root, "/etc/systemd/network/50-good-can_main.network")
    assert read(root, f"{NAME}/current/robot/good.yaml") == GOOD
    again = thorvaldc("install", "good.yaml", "--root", str(root))
    assert "nothing has changed" in again.err
    assert thorvaldc("uninstall", "good", "--root", str(root)).status == 0
    assert tree(root) == before


def test_versions_lie_side_by_side_and_edits_are_kept(root: Path, thorvaldc: Command) -> None:
    thorvaldc("install", "good.yaml", "--root", str(root))
    first = root / "etc/thorvaldc/good/versions/1/files/good.yaml"
    first.write_text(GOOD + "# edited\n", encoding="utf-8")
    Path("good.yaml").write_text(GOOD + "computer: {user: other}\n", encoding="utf-8")
    outcome = thorvaldc("install", "good.yaml", "--root", str(root))
    assert "note: files/good.yaml was edited on this computer; it stays in" in outcome.err
    assert first.read_text(encoding="utf-8").endswith("# edited\n")
    assert "User=other" in read(root, UNIT)
    assert os.readlink(root / "etc/thorvaldc/good/current") == "versions/2"


@pytest.mark.parametrize("is_absolute", [False, True])
def test_libraries_above_the_robot_file_come_along(
    root: Path, thorvaldc: Command, is_absolute: bool
) -> None:
    thorvaldc("modules", "new", "tool/plate", "--library", "../shelf")
    Path("../.hidden").write_text("x", encoding="utf-8")
    Path("good.yaml").write_text(
        GOOD.replace(
            "modules:",
            "library: [../shelf]\nmodules:\n" + TOP,
            1,
        ),
        encoding="utf-8",
    )
    file = os.path.abspath("good.yaml") if is_absolute else "good.yaml"
    outcome = thorvaldc("install", file, "--root", str(root))
    assert outcome.status == 0, outcome.err
    assert read(root, f"{NAME}/current/robot/good.yaml")
    assert not any("hidden" in path for path in tree(root))


def test_libraries_of_archives_come_along(
    root: Path, thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The user of the service has no cache: the version contains one."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    thorvaldc("modules", "new", "tool/plate", "--library", "shelf")
    shutil.make_archive("shelf", "gztar", "shelf")
    shutil.rmtree("shelf")
    text = GOOD.replace("modules:", "library: [{archive: shelf.tar.gz}]\nmodules:\n" + TOP, 1)
    Path("good.yaml").write_text(text, encoding="utf-8")
    assert thorvaldc("modules", "fetch", "good.yaml").status == 0
    outcome = thorvaldc("install", "good.yaml", "--root", str(root))
    assert outcome.status == 0, outcome.err
    version = root / "etc/thorvaldc/good/versions/1"
    assert f"XDG_CACHE_HOME={NAME}/current/cache\n" in read(root, UNIT)
    monkeypatch.setenv("XDG_CACHE_HOME", str(version / "cache"))
    monkeypatch.chdir(version / "robot")
    (tmp_path / "cache").rename(tmp_path / "away")
    checked = thorvaldc("check", "good.yaml")
    assert checked.status == 0, checked.err


@pytest.mark.slow
def test_a_process_that_is_killed_leaves_the_old_or_the_new_version(
    root: Path, thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The process ends at each change of a file: what the computer reads is one of the two."""
    thorvaldc("install", "good.yaml", "--root", str(root))
    old_unit = read(root, UNIT)
    changed = "computer: {user: other, can: {main: {interface: can7}}}\n"
    Path("good.yaml").write_text(GOOD + changed, encoding="utf-8")
    steps = 0

    class Killed(BaseException):
        pass

    for number in range(60):
        copy = root.parent / f"root{number}"
        shutil.copytree(root, copy, symlinks=True)
        steps = 0

        def counted(function: object, number: int = number) -> object:
            def step(*arguments: object, **named: object) -> object:
                nonlocal steps
                steps += 1
                if steps > number:
                    raise Killed
                return function(*arguments, **named)  # type: ignore[operator]

            return step

        with monkeypatch.context() as patch:
            for name in ("mkdir", "rename", "replace", "symlink", "unlink"):
                patch.setattr(os, name, counted(getattr(os, name)))
            with contextlib.suppress(Killed):
                thorvaldc("install", "good.yaml", "--root", str(copy))
        unit, robot = read(copy, UNIT), read(copy, f"{NAME}/current/robot/good.yaml")
        assert (robot == GOOD) == (unit == old_unit)
        assert ("User=other" in unit) == (unit != old_unit)
        # The next installation brings what is left to an end.
        assert thorvaldc("install", "good.yaml", "--root", str(copy)).status == 0
        assert "can7" in read(copy, "/etc/systemd/network/50-good-can7.network")
        assert not (copy / "etc/systemd/network/50-good-can_main.network").is_symlink()
        if steps <= number:
            break
    assert 12 < number < 59


def test_refusals(root: Path, thorvaldc: Command) -> None:
    missing = thorvaldc("install", "good.yaml", "--root", "nowhere")
    assert (missing.status, "there is no folder nowhere" in missing.err) == (2, True)
    wrong = thorvaldc("uninstall", "goood", "--root", str(root))
    assert (wrong.status, "installed are: none" in wrong.err) == (2, True)
    Path("bad.yaml").write_text("thorvaldc: 1\nname: bad\n", encoding="utf-8")
    assert thorvaldc("install", "bad.yaml", "--root", str(root)).status == 1
    place = root / UNIT.lstrip("/")
    place.parent.mkdir(parents=True)
    place.write_text("of somebody", encoding="utf-8")
    taken = thorvaldc("install", "good.yaml", "--root", str(root))
    assert (taken.status, "was not made by thorvaldc install" in taken.err) == (3, True)
    place.unlink()
    folder = root / "etc/thorvaldc"
    folder.write_text("no folder", encoding="utf-8")
    refused = thorvaldc("install", "good.yaml", "--root", str(root))
    assert (refused.status, "cannot write" in refused.err) == (3, True)
    assert not place.is_symlink()


def test_links_out_of_the_folder_are_not_copied(
    root: Path, thorvaldc: Command, tmp_path: Path
) -> None:
    """Root reads files that the owner of a robot file cannot read."""
    (tmp_path / "secret").write_text("x", encoding="utf-8")
    Path("notes.txt").symlink_to(tmp_path / "secret")
    Path("same.yaml").symlink_to("good.yaml")
    assert thorvaldc("install", "good.yaml", "--root", str(root)).status == 0
    files = root / "etc/thorvaldc/good/versions/1/files"
    assert sorted(path.name for path in files.iterdir()) == ["good.yaml", "same.yaml"]


def test_what_moves_at_the_start_is_named(root: Path, thorvaldc: Command) -> None:
    text = GOOD.replace("name: good", "name: good\ndriver: {homing: at_start, arming: automatic}")
    Path("good.yaml").write_text(text, encoding="utf-8")
    planned = thorvaldc("install", "good.yaml", "--root", str(root), "--dry-run")
    assert "the steering turns whenever the service starts" in planned.err
    assert "the robot arms itself after each start" in planned.err


def test_the_status_of_a_robot_that_does_not_run(root: Path, thorvaldc: Command) -> None:
    assert "no robot is installed" in thorvaldc("status", "--root", str(root)).err
    thorvaldc("install", "good.yaml", "--root", str(root))
    shown = thorvaldc("status", "--root", str(root))
    assert shown.out == "good: version 1\n  the base driver does not run\n"
    assert shown.status == 1
    file = root / "etc/thorvaldc/good/versions/1/files/good.yaml"
    file.write_text(GOOD.replace("modules:", "modulse:", 1), encoding="utf-8")
    shown = thorvaldc("status", "--root", str(root), "--json")
    (values,) = json.loads(shown.out)
    assert values["edited"] == ["files/good.yaml"]
    assert "`modulse`" in values["errors"][0]


def test_the_status_of_a_robot_whose_file_has_an_odd_name(root: Path, thorvaldc: Command) -> None:
    name = 'mower "7" 50 %$HOME\\.yaml'
    Path("good.yaml").rename(name)
    assert thorvaldc("install", name, "--root", str(root)).status == 0
    shown = thorvaldc("status", "--root", str(root))
    assert shown.out == "good: version 1\n  the base driver does not run\n"


def test_the_status_of_a_robot_with_ros(root: Path, thorvaldc: Command) -> None:
    Path("good.yaml").write_text(GOOD + "computer: {ros: {workspace: /opt/ws}}\n", encoding="utf-8")
    thorvaldc("install", "good.yaml", "--root", str(root))
    shown = thorvaldc("status", "--root", str(root))
    assert "the base driver is a node of ROS 2" in shown.out
    assert shown.status == 1  # systemd does not say that it runs


def test_this_computer_is_not_changed_without_systemd(root: Path, thorvaldc: Command) -> None:
    if Path("/run/systemd/system").is_dir():
        pytest.skip("this computer runs systemd")
    outcome = thorvaldc("install", "good.yaml")
    assert (outcome.status, "does not run systemd" in outcome.err) == (3, True)
    assert not Path("/etc/thorvaldc/good").exists()


@pytest.mark.parametrize("more", ["", "computer: {ros: {workspace: /opt/ws, domain: 7}}\n"])
def test_systemd_reads_the_unit(root: Path, thorvaldc: Command, more: str) -> None:
    Path("good.yaml").write_text(GOOD + more, encoding="utf-8")
    thorvaldc("build", "good.yaml", "--target", "computer", "-o", "out")
    (unit,) = Path("out/computer/systemd").iterdir()
    text = unit.read_text(encoding="utf-8").replace("/opt/thorvaldc-env/bin/thorvaldc", "/bin/true")
    unit.write_text(text, encoding="utf-8")
    run = subprocess.run(
        ["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, check=False
    )
    own = [line for line in run.stderr.splitlines() if unit.name in line]
    assert (run.returncode, own) == (0, [])


@pytest.mark.slow
def test_the_start_line_drives_a_simulated_robot_disarmed(
    root: Path,
    thorvaldc: Command,
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The lines of the unit run as they are, but for the program, the bus and the folders.

    The process tells the service manager that it is ready, and feeds the watchdog; stopped by a
    signal, it is silent, so that systemd ends it.
    """
    thorvaldc("build", "good.yaml", "--target", "computer", "-o", "out")
    (unit,) = Path("out/computer/systemd").iterdir()
    text = unit.read_text(encoding="utf-8")
    lines = dict(re.findall(r"^(ExecStartPre|ExecStart)=-?(.*)$", text, re.MULTILINE))
    bus_socket, control = f"{tmp_path}/bus.sock", f"{tmp_path}/control"
    program = [sys.executable, "-m", "thorvaldc"]

    def command(line: str) -> list[str]:
        changes = {
            "/var/lib/thorvaldc/good": str(tmp_path / "state"),
            "/run/thorvaldc/good/control": control,
            "socketcan:can_main": f"sim:{bus_socket}",
        }
        for old, new in changes.items():
            line = line.replace(old, new)
        return [*program, *shlex.split(line)[1:]]

    subprocess.run(command(lines["ExecStartPre"]), check=True, capture_output=True)
    notified = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    notified.bind(str(tmp_path / "notify"))
    notified.settimeout(60.0)
    simulated = ChildProcess(
        [*program, "bus", "good.yaml", "--channel", bus_socket], preexec_fn=before_other_processes
    )
    environment = {**os.environ, "NOTIFY_SOCKET": f"{tmp_path}/notify", "WATCHDOG_USEC": "2000000"}
    try:
        while not Path(bus_socket).exists():
            assert simulated.poll() is None
        driver = ChildProcess(
            command(lines["ExecStart"]), env=environment, preexec_fn=before_other_processes
        )
        try:
            assert notified.recv(100).startswith(b"READY=1")
            assert notified.recv(100) == b"WATCHDOG=1"
            call = subprocess.run(
                [*program, "call", control, "state", "--json"],
                capture_output=True,
                text=True,
                check=True,
            )
            assert '"armed": false' in call.stdout
            thorvaldc("install", "good.yaml", "--root", str(root))
            (root / "run/thorvaldc/good").mkdir(parents=True)
            (root / "run/thorvaldc/good/control").symlink_to(control)
            (root / "var/lib/thorvaldc").mkdir(parents=True)
            (root / "var/lib/thorvaldc/good").symlink_to(tmp_path / "state")
            short = tmp_path_factory.mktemp("r") / "r"  # the path of a socket is short
            short.symlink_to(root)
            monkeypatch.chdir(short.parent)
            shown = thorvaldc("status", "--root", "r")
            assert "good: version 1\n  driver: " in shown.out
            assert ", not armed: " in shown.out
            assert shown.status == 0
            file = root / "etc/thorvaldc/good/versions/1/files/good.yaml"
            file.write_text(GOOD + "driver: {rate: 20 Hz}\n", encoding="utf-8")
            shown = thorvaldc("status", "good", "--root", "r")
            assert "it runs another robot than its file describes" in shown.out
            assert "edited on this computer: files/good.yaml" in shown.out
            assert shown.status == 1
            driver.send_signal(signal.SIGSTOP)
            while Path(f"/proc/{driver.pid}/stat").read_text().rpartition(")")[2].split()[0] != "T":
                pass
            notified.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                while True:  # what was sent before
                    notified.recv(100)
            time.sleep(1.0)
            with pytest.raises(BlockingIOError):
                notified.recv(100)
            driver.send_signal(signal.SIGCONT)
            driver.send_signal(signal.SIGINT)
            assert driver.wait(60) in (0, 130)
            assert "SuccessExitStatus=130" in text
        finally:
            driver.end()
    finally:
        simulated.end()
        notified.close()
