"""A robot, the file system of its computer, and a computer that ssh reaches."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, Command
from tests.outside_tools import SSHD, require
from thorvaldc import __version__


def tree(root: Path) -> dict[str, str]:
    """Returns each file and link of a folder with its content or target."""
    return {
        path.relative_to(root).as_posix(): os.readlink(path)
        if path.is_symlink()
        else path.read_text(encoding="utf-8", errors="replace")
        for path in sorted(root.rglob("*"))
        if path.is_symlink() or path.is_file()
    }


@pytest.fixture
def root(tmp_path: Path, thorvaldc: Command) -> Path:
    """The file system of a computer, and a folder with a robot of its own."""
    Path("own").mkdir()
    Path("own/good.yaml").write_text(GOOD, encoding="utf-8")
    os.chdir("own")
    (tmp_path / "root/etc").mkdir(parents=True)
    return tmp_path / "root"


Programs = Callable[..., None]
"""``programs(name="lines of a shell script")`` writes the first programs of ``PATH``."""
SSH_CONFIG = """\
Host robot
  ProxyCommand {sshd} -i -f {folder}/sshd_config -E {folder}/log
  HostKeyAlias robot
Host stranger
  ProxyCommand {sshd} -i -f {folder}/sshd_config -E {folder}/log
Host nobody
  ProxyCommand false
Host *
  IdentityFile {folder}/key
  IdentitiesOnly yes
  UserKnownHostsFile {folder}/known_hosts
"""
SSHD_CONFIG = """\
HostKey {folder}/host_key
AuthorizedKeysFile {folder}/key.pub
StrictModes no
UsePAM no
PidFile none
SetEnv HOME={folder}/home TMPDIR={folder}/tmp PATH={folder}/bin:{path}
"""
FAR_PROGRAM = """\
#!/bin/sh
if [ "$1" = --version ]; then echo thorvaldc {version}; exit; fi
command=$1; shift
PYTHONPATH={source} exec {python} -m thorvaldc "$command" --root {root} "$@"
"""


def write_program(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    path.chmod(0o755)


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Programs:
    monkeypatch.setenv("PATH", str(tmp_path / "programs"), prepend=os.pathsep)

    def write(**texts: str) -> None:
        for name, text in texts.items():
            write_program(tmp_path / "programs" / name, f"#!/bin/sh\n{text}\n")

    return write


@pytest.fixture
def far(tmp_path: Path, root: Path, programs: Programs) -> Path:
    """The folder of a computer `robot`, which OpenSSH's client reaches by a process of sshd.

    Its files are those of ``root``, its home folder is `home`, and `bin` is the first folder of its
    ``PATH``.  It has no thorvaldc yet: ``install_far_program`` installs it.
    """
    require("ssh-keygen")
    folder = tmp_path / "far"
    (folder / "home").mkdir(parents=True)
    (folder / "tmp").mkdir()
    for name in ("host_key", "key"):
        command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / name)]
        subprocess.run(command, check=True)
    public = (folder / "host_key.pub").read_text(encoding="utf-8")
    (folder / "known_hosts").write_text(f"robot {public}", encoding="utf-8")
    names = {"folder": folder, "sshd": SSHD, "path": os.environ["PATH"]}
    for name, text in (("ssh_config", SSH_CONFIG), ("sshd_config", SSHD_CONFIG)):
        (folder / name).write_text(text.format(**names), encoding="utf-8")
    if os.geteuid() == 0:
        Path("/run/sshd").mkdir(mode=0o755, exist_ok=True)  # as its service does
    programs(ssh=f'exec {shutil.which("ssh")} -F {folder}/ssh_config "$@"')
    return folder


def install_far_program(far: Path, root: Path, version: str = __version__) -> None:
    source = Path(__file__).parents[3]
    names = {"source": source, "python": sys.executable, "root": root, "version": version}
    text = FAR_PROGRAM.format(**{k: shlex.quote(str(v)) for k, v in names.items()})
    write_program(far / "home/thorvaldc-env/bin/thorvaldc", text)
