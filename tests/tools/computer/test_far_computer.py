"""The computer of a robot over OpenSSH: a real client and a real server, without a network."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, Command
from tests.tools.computer.conftest import Programs, install_far_program, tree, write_program
from thorvaldc import __version__


@pytest.fixture
def robot(far: Path, root: Path, thorvaldc: Command) -> Path:
    """The folder of a computer with thorvaldc and an installed robot."""
    install_far_program(far, root)
    assert thorvaldc("install", "good.yaml", "--root", str(root)).status == 0
    return far


@pytest.mark.slow
def test_the_status_of_a_far_robot(robot: Path, thorvaldc: Command) -> None:
    write_program(robot / "bin/date", '#!/bin/sh\nexec /bin/date --date "3 seconds ago" "$@"\n')
    outcome = thorvaldc("status", "--host", "robot", "--json")
    assert outcome.status == 1, outcome.err  # the base driver does not run
    (values,) = json.loads(outcome.out)
    assert (values["name"], values["version"]) == ("good", "1")
    assert abs(values["clock"]["ahead"] + 3.0) <= values["clock"]["uncertainty"] + 1e-6
    shown = thorvaldc("status", "good", "--host", "robot")
    first, clock, last = shown.out.splitlines()
    assert (first, last) == ("good: version 1", "  the base driver does not run")
    assert " s behind the clock of this computer (± " in clock


def test_a_clock_without_fractions_is_not_compared(robot: Path, thorvaldc: Command) -> None:
    write_program(robot / "bin/date", "#!/bin/sh\necho 1700000000.N\n")
    (values,) = json.loads(thorvaldc("status", "--host", "robot", "--json").out)
    assert values["clock"] == {}


def test_what_the_login_shell_says_first_is_skipped(robot: Path, thorvaldc: Command) -> None:
    (robot / "home/.bashrc").write_text("echo welcome; echo thorvaldc 9\n", encoding="utf-8")
    shown = thorvaldc("status", "--host", "robot")
    assert shown.out.startswith("good: version 1\n"), shown.err


def test_the_log_of_a_far_robot(
    robot: Path, root: Path, thorvaldc: Command, capfd: pytest.CaptureFixture[str]
) -> None:
    write_program(robot / "bin/journalctl", '#!/bin/sh\necho "$*"\n')
    journal = root / "var/log/journal/machine/system.journal"
    refused = thorvaldc("logs", "--host", "robot")
    assert (refused.status, capfd.readouterr().err[:26]) == (3, "error: there is no journal")
    journal.parent.mkdir(parents=True)
    journal.touch()
    assert thorvaldc("logs", "good", "--follow", "--host", "robot").status == 0
    line = f"--no-pager --lines=200 --unit=thorvaldc-good.service --root={root} --follow\n"
    assert capfd.readouterr().out == line


@pytest.mark.parametrize("name", ["$(touch {0})'; touch {0}; '", "--json"])
def test_a_name_is_no_command_and_no_option(
    robot: Path,
    thorvaldc: Command,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    name: str,
) -> None:
    made = tmp_path / "made"
    for command in ("status", "logs"):
        outcome = thorvaldc(command, "--host", "robot", "--", name.format(made))
        assert outcome.status == 2
        assert f"`{name.format(made)}` is not installed" in capfd.readouterr().err
    assert not made.exists()


def test_hosts_that_do_not_answer(
    far: Path, root: Path, thorvaldc: Command, programs: Programs
) -> None:
    def refused(host: str) -> str:
        outcome = thorvaldc("status", "--host", host)
        assert (outcome.status, outcome.out) == (3, "")
        return outcome.err

    assert "robot has no thorvaldc in /opt/thorvaldc-env or ~/thorvaldc-env" in refused("robot")
    assert "`ssh nobody true` must work without a password" in refused("nobody")
    assert "(Host key verification failed.)" in refused("stranger")
    install_far_program(far, root, version="0.0.9")
    text = refused("robot")
    assert f"robot has thorvaldc 0.0.9, and this is thorvaldc {__version__}" in text
    assert f"there: {far}/home/thorvaldc-env/bin/pip install" in text
    write_program(far / "home/thorvaldc-env/bin/thorvaldc", "#!/bin/sh\nexec /no/python\n")
    text = refused("robot")
    assert f"robot has a broken {far}/home/thorvaldc-env/bin/thorvaldc (" in text
    assert "/no/python: not found)" in text


@pytest.mark.slow
def test_answers_of_another_build(far: Path, thorvaldc: Command) -> None:
    """A version that is not released has many builds."""
    program = far / "home/thorvaldc-env/bin/thorvaldc"
    version = f'#!/bin/sh\n[ "$1" = --version ] && echo thorvaldc {__version__} && exit\n'
    for answer in ("[{}]", '[{"clock": {}}]', '{"name": 1}', "welcome", ""):
        write_program(program, f"{version}echo '{answer}'\n")
        outcome = thorvaldc("status", "--host", "robot")
        assert (outcome.status, outcome.out) == (3, ""), answer
        assert "answers as another build of this version does" in outcome.err


def test_a_connection_that_ends(thorvaldc: Command, programs: Programs) -> None:
    answer = f"echo thorvaldc-at x; echo thorvaldc {__version__}"
    programs(ssh=f'case "$*" in *folder*) {answer};; *) exit 255;; esac')
    for command in ("status", "logs"):
        outcome = thorvaldc(command, "--host", "robot")
        assert outcome == (3, "", "error: the connection to robot has ended\n")


def test_without_ssh(thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    outcome = thorvaldc("logs", "--host", "robot")
    assert (outcome.status, "there is no ssh: install" in outcome.err) == (3, True)
    both = thorvaldc("status", "--host", "robot", "--root", str(tmp_path))
    assert (both.status, "--host is for the file system" in both.err) == (2, True)


def test_a_far_installation_is_as_a_local_one(
    far: Path, root: Path, thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a library above the robot file, and one from the cache of archives."""
    install_far_program(far, root)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    Path("project").mkdir()
    monkeypatch.chdir("project")
    for shelf in ("../shelf", "packed"):
        thorvaldc("modules", "new", f"tool/{shelf.strip('./')}", "--library", shelf)
    shutil.make_archive("packed", "gztar", "packed")
    shutil.rmtree("packed")
    mount = "mount: {parent: frame, xyz: [0, 0, 0.3]}"
    text = GOOD.replace(
        "modules:",
        f"library: [../shelf, {{archive: packed.tar.gz}}]\nmodules:\n"
        f"  one: {{type: tool/shelf, {mount}}}\n  two: {{type: tool/packed, {mount}}}\n",
        1,
    )
    Path("good.yaml").write_text(text, encoding="utf-8")
    assert thorvaldc("modules", "fetch", "good.yaml").status == 0
    (tmp_path / "local/etc").mkdir(parents=True)
    local = thorvaldc("install", "good.yaml", "--root", str(tmp_path / "local"))
    assert local.status == 0, local.err
    planned = thorvaldc("install", "good.yaml", "--host", "robot", "--dry-run")
    assert (planned.status, tree(root)) == (0, {})
    outcome = thorvaldc("install", "good.yaml", "--host", "robot")
    assert outcome.status == 0, outcome.err
    assert tree(root) == tree(tmp_path / "local")
    assert any(path.endswith("packed.tar.gz") for path in tree(root))
    assert any("/libraries/" in path for path in tree(root))
    assert list((far / "tmp").iterdir()) == []


def test_a_model_is_installed_as_it_is(far: Path, root: Path, thorvaldc: Command) -> None:
    """There, too, and without the other files of its build."""
    install_far_program(far, root)
    assert thorvaldc("build", "good.yaml", "--target", "can", "-o", "out").status == 0
    outcome = thorvaldc("install", "out/model.json", "--host", "robot")
    assert outcome.status == 0, outcome.err
    version = root / "etc/thorvaldc/good/versions/1"
    assert (version / "robot/model.json").read_bytes() == Path("out/model.json").read_bytes()
    assert [path.name for path in (version / "files").iterdir()] == ["model.json"]
    (unit,) = (version / "computer/systemd").iterdir()
    text = unit.read_text(encoding="utf-8")
    assert "/thorvaldc run /etc/thorvaldc/good/current/robot/model.json --bus" in text
    assert "ExecStartPre" not in text
    shown = thorvaldc("status", "--root", str(root))
    assert shown.out == "good: version 1\n  the base driver does not run\n"


@pytest.mark.slow
def test_a_far_installation_that_is_refused(far: Path, root: Path, thorvaldc: Command) -> None:
    """Nothing is installed of files of which some are missing, or without rights."""
    install_far_program(far, root)
    write_program(far / "bin/id", "#!/bin/sh\necho 1000\n")
    write_program(far / "bin/sudo", "#!/bin/sh\nexit 1\n")
    refused = thorvaldc("install", "good.yaml", "--host", "robot")
    assert (refused.status, "sudo asks for a password on robot" in refused.err) == (3, True)
    write_program(far / "bin/sudo", '#!/bin/sh\nshift; exec "$@"\n')
    # tar(1) says nothing of an archive that ends between two files.
    first = 512 * (1 + -(-len(GOOD) // 512))
    write_program(far / "bin/tar", f'#!/bin/sh\nhead --bytes {first} | /bin/tar "$@"\n')
    cut = thorvaldc("install", "good.yaml", "--host", "robot")
    assert (cut.status, "not all files came to robot" in cut.err) == (3, True)
    assert tree(root) == {}
    assert list((far / "tmp").iterdir()) == []
    (far / "bin/tar").unlink()
    assert thorvaldc("install", "good.yaml", "--host", "robot").status == 0
    assert "etc/thorvaldc/good/current" in tree(root)
