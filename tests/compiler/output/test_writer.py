"""A build is written completely or not at all, and never replaces files of the user."""

from __future__ import annotations

import errno
import json
import os
import signal
import stat
import subprocess
import sys
import time
from hashlib import sha256
from pathlib import Path

import pytest

from tests.child_process import ChildProcess
from tests.full_disk import full_disk
from thorvaldc.compiler.output import writer
from thorvaldc.compiler.output.writer import WriteError, write_build, write_locks
from thorvaldc.diagnostics import Report

ONE = {"model.json": b"1", "mjcf/robot.xml": b"<a/>", "meshes/a.stl": b"solid"}
TWO = {"model.json": b"2", "mjcf/robot.xml": b"<b/>", "urdf/robot.urdf": b"<c/>"}


def write(files: dict[str, bytes], folder: Path) -> None:
    write_build(files, folder, name="r", source_sha256="ab", version="1")


def contents(folder: Path) -> dict[str, bytes]:
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name != "manifest.json"
    }


def is_complete(folder: Path) -> bool:
    """Whether the files in the folder are those of the manifest."""
    manifest = json.loads((folder / "manifest.json").read_text())
    hashes = {path: sha256(data).hexdigest() for path, data in contents(folder).items()}
    return bool(manifest["complete"]) and hashes == manifest["files"]


def staging_folders(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir() if p.name.startswith("."))


def test_a_build_replaces_the_last_one(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    write(ONE, out)
    assert contents(out) == ONE
    write(TWO, out)
    assert contents(out) == TWO
    assert is_complete(out)
    assert not (out / "meshes").exists()
    assert staging_folders(tmp_path / "deep") == []


def test_manifest_lists_the_files(tmp_path: Path) -> None:
    write(ONE, tmp_path / "out")
    head = json.loads((tmp_path / "out/manifest.json").read_text())
    assert head["compiler"] == "thorvaldc 1"
    assert head["source_sha256"] == "ab"
    assert list(head["files"]) == sorted(ONE)
    assert head["files"]["model.json"] == sha256(b"1").hexdigest()


def test_permissions_follow_the_umask_and_stay(tmp_path: Path) -> None:
    out = tmp_path / "out"
    old_umask = os.umask(0o027)
    try:
        write(ONE, out)
    finally:
        os.umask(old_umask)
    assert stat.S_IMODE(out.stat().st_mode) == 0o750
    assert stat.S_IMODE((out / "model.json").stat().st_mode) == 0o640
    out.chmod(0o700)
    write(TWO, out)
    assert stat.S_IMODE(out.stat().st_mode) == 0o700


def test_files_of_the_user_in_a_build_folder_are_kept(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(ONE, out)
    (out / "mjcf/MUJOCO_LOG.TXT").write_text("mine")
    (out / "notes").mkdir()
    (out / "notes/a.txt").write_text("mine too")
    inode = (out / "notes/a.txt").stat().st_ino
    write(TWO, out)
    assert contents(out) == {**TWO, "mjcf/MUJOCO_LOG.TXT": b"mine", "notes/a.txt": b"mine too"}
    assert (out / "notes/a.txt").stat().st_ino == inode
    assert not (out / "meshes").exists()
    assert json.loads((out / "manifest.json").read_text())["complete"]
    assert staging_folders(out) == []


def test_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(WriteError, match=r"thesis\.tex.*-o"):
        write(ONE, tmp_path)
    assert contents(tmp_path) == {"thesis.tex": b"years of work"}


@pytest.mark.parametrize(
    "manifest", ['{"files": ["a"]}', '{"format": "thorvaldc-manifest"}', "[" * 100_000]
)
def test_folder_with_manifest_of_another_program_is_refused(tmp_path: Path, manifest: str) -> None:
    (tmp_path / "manifest.json").write_text(manifest)
    with pytest.raises(WriteError, match=r"manifest\.json"):
        write(ONE, tmp_path)


def test_file_of_the_user_with_the_name_of_an_output_is_kept(tmp_path: Path) -> None:
    write(ONE, tmp_path / "out")
    (tmp_path / "out/urdf").mkdir()
    (tmp_path / "out/urdf/robot.urdf").write_text("by hand")
    with pytest.raises(WriteError, match=r"urdf/robot\.urdf"):
        write(TWO, tmp_path / "out")
    assert contents(tmp_path / "out") == {**ONE, "urdf/robot.urdf": b"by hand"}


def test_manifest_with_paths_outside_the_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(ONE, out)
    (tmp_path / "precious").write_text("x")
    head = json.loads((out / "manifest.json").read_text())
    head["files"]["../precious"] = ""
    (out / "manifest.json").write_text(json.dumps(head))
    (out / "other.txt").write_text("")  # prevents the exchange: files are moved one by one
    write(TWO, out)
    assert (tmp_path / "precious").read_text() == "x"


@pytest.mark.parametrize(
    "path", ["../a", "/a", "a/../b", "", "a\\b", "./a", "a//b", "manifest.json"]
)
def test_output_outside_the_folder_is_refused(path: str, tmp_path: Path) -> None:
    with pytest.raises(WriteError, match="a build cannot contain"):
        write({path: b""}, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_build_path_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("x")
    with pytest.raises(WriteError, match="it is a file, not a folder"):
        write(ONE, tmp_path / "out")
    with pytest.raises(WriteError, match="out is a file, not a folder"):
        write(ONE, tmp_path / "out" / "deeper")
    assert (tmp_path / "out").read_text() == "x"


@pytest.mark.parametrize("deeper", ["", "deeper", "still/deeper"])
def test_read_only_folder_is_refused_and_unchanged(tmp_path: Path, deeper: str) -> None:
    locked = tmp_path / "locked"
    if deeper == "":
        write(ONE, locked)
    else:
        locked.mkdir()
    old_contents = contents(locked)
    locked.chmod(0o555)
    try:
        with pytest.raises(WriteError, match="is read-only"):
            write(TWO, locked / deeper)
    finally:
        locked.chmod(0o755)
    assert contents(locked) == old_contents


def test_a_link_to_a_folder_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    write(ONE, tmp_path / "link")
    write(TWO, tmp_path / "link")
    assert (tmp_path / "link").is_symlink()
    assert contents(tmp_path / "real") == TWO


def test_the_current_folder_stays_the_same_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(ONE, tmp_path)
    monkeypatch.chdir(tmp_path)
    inode = tmp_path.stat().st_ino
    write(TWO, Path("."))
    assert tmp_path.stat().st_ino == inode
    assert sorted(os.listdir(".")) == ["manifest.json", "mjcf", "model.json", "urdf"]


def disable_exchange(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "exchange", lambda a, b: False)


def test_without_the_exchange_call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disable_exchange(monkeypatch)
    write(ONE, tmp_path / "out")
    write(TWO, tmp_path / "out")
    assert contents(tmp_path / "out") == TWO
    assert is_complete(tmp_path / "out")
    assert staging_folders(tmp_path) == []


@pytest.mark.parametrize("at", range(1, 12))
def test_error_while_moving_files_rolls_back(
    at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disable_exchange(monkeypatch)
    out = tmp_path / "out"
    write(ONE, out)
    real, calls = os.rename, []

    def rename(a: Path, b: Path) -> None:
        calls.append(b)
        if len(calls) == at:
            raise OSError(errno.EIO, "Input/output error")
        real(a, b)

    monkeypatch.setattr(os, "rename", rename)
    try:
        write(TWO, out)
    except WriteError:
        assert contents(out) == ONE
    else:
        assert at > 8  # moving needs no more calls
        assert contents(out) == TWO
    assert is_complete(out)


def test_build_after_a_build_that_was_killed_while_moving(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    write(ONE, out)
    script = (
        "import os, sys, pathlib\n"
        "from thorvaldc.compiler.output import writer\n"
        "writer.exchange = lambda a, b: False\n"
        "real, n = os.rename, []\n"
        "def rename(a, b):\n"
        "    n.append(1)\n"
        "    if len(n) == 7: os.kill(os.getpid(), 9)\n"
        "    real(a, b)\n"
        "os.rename = rename\n"
        "writer.write_build({'model.json': b'2', 'x/y': b''}, pathlib.Path(sys.argv[1]),"
        " name='r', source_sha256='', version='1')\n"
    )
    done = subprocess.run([sys.executable, "-c", script, str(out)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert not json.loads((out / "manifest.json").read_text())["complete"]
    write(TWO, out)
    assert contents(out) == TWO
    assert is_complete(out)
    assert staging_folders(tmp_path) == []


WRITE_MANY = """
import sys, pathlib
from thorvaldc.compiler.output.writer import write_build
print("ready", flush=True)
n = 0
while True:
    n += 1
    files = {f"d{i % 7}/{i}": b"%d" % n * 1000 for i in range(40 + n % 3)}
    write_build(files, pathlib.Path(sys.argv[1]), name="r", source_sha256="", version="1")
"""


@pytest.mark.parametrize("round_", range(8))
def test_kill_9_at_any_moment_leaves_a_complete_build(round_: int, tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(ONE, out)
    with ChildProcess(
        [sys.executable, "-c", WRITE_MANY, str(out)], stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(0.05 + 0.0137 * round_)
        process.kill()
    assert is_complete(out)
    write(ONE, out)
    assert staging_folders(tmp_path) == []


def test_ctrl_c_leaves_only_a_complete_build(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with ChildProcess(
        [sys.executable, "-c", WRITE_MANY, str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
    assert is_complete(out)
    assert staging_folders(tmp_path) == []


def test_two_concurrent_builds(tmp_path: Path) -> None:
    out = tmp_path / "out"
    both = [
        ChildProcess(
            [sys.executable, "-c", WRITE_MANY, str(out)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        for _ in range(2)
    ]
    for process in both:
        assert process.stdout is not None
        process.stdout.readline()
    time.sleep(0.5)
    for process in both:
        assert process.poll() is None, process.stderr and process.stderr.read()
        process.kill()
        process.communicate()
    assert is_complete(out)


def test_full_disk_keeps_the_last_lock_file(tmp_path: Path) -> None:
    lock = tmp_path / "robot.lock.yaml"
    report = Report()
    assert write_locks({lock: "old"}, report) == [lock]
    with full_disk(100):
        assert write_locks({lock: "new " * 100}, report) == []
    assert lock.read_text() == "old"
    assert [d.message for d in report] == [f"cannot write {lock}: File too large"]
    assert os.listdir(tmp_path) == ["robot.lock.yaml"]


def test_full_disk_keeps_the_last_build(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(ONE, out)
    with full_disk(1000), pytest.raises(WriteError, match="File too large"):
        write({**TWO, "big": b"x" * 2000}, out)
    assert contents(out) == ONE
    assert is_complete(out)
    assert staging_folders(tmp_path) == []


@pytest.mark.parametrize("round_", range(4))
def test_kill_9_in_a_folder_with_files_of_the_user(round_: int, tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(ONE, out)
    (out / "notes/empty").mkdir(parents=True)
    (out / "notes/empty").chmod(0o700)
    (out / "notes/a.txt").write_text("mine")
    (out / "link").symlink_to("notes/a.txt")
    process = ChildProcess([sys.executable, "-c", WRITE_MANY, str(out)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(0.05 + 0.0137 * round_)
    process.end()
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["complete"]
    user_files = {"notes/a.txt", "link"}
    assert set(contents(out)) == {*manifest["files"], *user_files}
    write(ONE, out)
    assert (out / "link").readlink() == Path("notes/a.txt")
    assert (out / "link").read_text() == "mine"
    assert (out / "notes/empty").stat().st_mode & 0o777 == 0o700
    assert staging_folders(tmp_path) == []


def test_a_file_that_the_user_replaces_during_a_build_stays_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    write(ONE, out)
    (out / "notes.txt").write_text("old")
    real = writer.exchange

    def exchange(stage: Path, target: Path) -> bool:
        (tmp_path / "new").write_text("new")
        (tmp_path / "new").replace(target / "notes.txt")
        return real(stage, target)

    monkeypatch.setattr(writer, "exchange", exchange)
    write(TWO, out)
    assert contents(out) == {**TWO, "notes.txt": b"new"}


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to others")
def test_a_build_of_root_leaves_the_folder_to_its_owner(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(ONE, out)
    (out / "notes").mkdir()
    (out / "notes/a.txt").write_text("of root")
    for path in (out, *(out / name for name in ONE)):
        os.chown(path, 1234, 1234)
    write(TWO, out)
    owners = {path.name: path.stat().st_uid for path in (out, *out.rglob("*"))}
    assert {owners.pop("notes"), owners.pop("a.txt")} == {0}
    assert set(owners.values()) == {1234}
