"""The computer of a robot, reached by OpenSSH's client from another computer.

A first connection finds the program ``thorvaldc`` there, checks that it is of the same version, and
may compare the clocks.  Each command is run over a connection of its own, with its own streams.
"""

from __future__ import annotations

import io
import re
import shlex
import subprocess
import tarfile
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import IO

import typer

from thorvaldc.diagnostics import OutsideError
from thorvaldc.diagnostics.installation import program_version

SSH = (
    *("ssh", "-o", "BatchMode=yes", "-o", "ConnectTimeout=10"),
    *("-o", "ServerAliveInterval=5"),  # a command ends 15 s after the network is lost
)
NO_CONNECTION, NO_PROGRAM = 255, 127
"""Exit status of ssh(1) without a connection, and of a shell without the program."""
CLOCK_READINGS = 5
_HOST = r"(?:[A-Za-z0-9_][A-Za-z0-9_.+-]*@)?[A-Za-z0-9_:][A-Za-z0-9_.:%-]*"
"""What may be taken neither for an option nor for the syntax of a shell."""
_MARK = "thorvaldc-at "
# The login shell of the user may be any: the script is one word in single quotes, on one line.
# The files of that shell may write something before the mark.
# `%N` are nanoseconds in GNU's date(1).
_FIND = (
    'for folder in /opt/thorvaldc-env "$HOME/thorvaldc-env"; do program="$folder/bin/thorvaldc"; '
    f'if [ -x "$program" ]; then echo "{_MARK}$program"; '
    'echo "$("$program" --version </dev/null)"; '  # an empty line of a broken program
    f"while read -r line; do date +%s.%N; done; exit 0; fi; done; exit {NO_PROGRAM}"
)
NO_RIGHTS, INCOMPLETE = 126, 125
"""Exit status of a far installation without root, and without all files."""
_COMPLETE = "complete"
# Without its last file, the archive was cut off: tar(1) may take that for the end.
_INSTALL = (
    'program="$1"; place="$2"; file="$3"; shift 3; folder="$(mktemp -d)" || '
    f'exit {INCOMPLETE}; trap "rm -rf $folder" EXIT; trap "exit {INCOMPLETE}" HUP INT TERM; '
    f'tar -x -f - -C "$folder" && [ -f "$folder/{_COMPLETE}" ] && cd "$folder/$place" || '
    f"exit {INCOMPLETE}; "
    'set -- env XDG_CACHE_HOME="$folder/cache" "$program" install "$@" -- "$file"; '
    'if [ "$(id -u)" = 0 ]; then "$@"; '
    f'else sudo -n true || exit {NO_RIGHTS}; sudo -n "$@"; fi'
)


def check_host(host: str) -> None:
    """Raises ``typer.BadParameter`` if a text cannot name a computer."""
    if not re.fullmatch(_HOST, host):
        raise typer.BadParameter(
            f"{host!r} is not a computer as in robot, ubuntu@10.0.0.2 or a Host of ~/.ssh/config",
            param_hint="'--host'",
        )


@dataclass(frozen=True)
class ClockDifference:
    """Time (s) by which a far clock is ahead of the clock of this computer, and its uncertainty."""

    ahead: float
    uncertainty: float


@dataclass(frozen=True)
class FarComputer:
    """A computer that answers, with the same version of thorvaldc.

    - ``program``: path of the program `thorvaldc` there.
    - ``clock``: how far its clock is ahead, or ``None`` if it was not asked.
    """

    host: str
    program: str
    clock: ClockDifference | None

    def show(self, *words: str) -> int:
        """Calls `thorvaldc` there with the standard streams of this one, and returns its status."""
        return self._checked(_ssh(self.host, self.program, *words).returncode)

    def read(self, *words: str) -> tuple[int, str]:
        """Calls `thorvaldc` there, and returns its exit status and what it wrote on stdout."""
        script = f'echo "{_MARK}"; exec "$@"'
        run = _ssh(
            *(self.host, "sh", "-c", script, "sh", self.program, *words), stdout=subprocess.PIPE
        )
        text = run.stdout.decode(errors="replace")
        return self._checked(run.returncode), text.partition(f"{_MARK}\n")[2]

    def install(self, files: Mapping[str, bytes], folder: str, robot_file: str, *words: str) -> int:
        """Copies files to a fresh folder there, calls `thorvaldc install` there as root with the
        robot file, which is in a folder of the files, and words, and returns its exit status.

        Raises ``OutsideError`` if a part of the files came there, or if root does not permit it.
        """
        packed = io.BytesIO()
        with tarfile.open(fileobj=packed, mode="w") as archive:
            for name, data in {**files, _COMPLETE: b""}.items():
                entry = tarfile.TarInfo(name)
                entry.size = len(data)
                archive.addfile(entry, io.BytesIO(data))
        script = ("sh", "-c", _INSTALL, "sh", self.program, folder, robot_file, *words)
        status = self._checked(_ssh(self.host, *script, stdin=packed.getvalue()).returncode)
        if status == INCOMPLETE:
            raise OutsideError(f"not all files came to {self.host}; nothing was installed")
        if status == NO_RIGHTS:
            raise OutsideError(
                f"only root may install, and sudo asks for a password on {self.host}: use"
                " --host root@..., or let sudo need no password there"
            )
        return status

    def _checked(self, status: int) -> int:
        if status == NO_CONNECTION or status < 0:
            raise OutsideError(f"the connection to {self.host} has ended")
        return status


def reach(host: str, *, compare_clocks: bool = False) -> FarComputer:
    """Returns the computer with a name of ssh(1).

    Raises ``OutsideError`` if it does not answer, or has no thorvaldc of this version.
    """
    clock = None
    with tempfile.TemporaryFile() as messages:
        try:
            process = subprocess.Popen(
                [*SSH, "--", host, shlex.join(["sh", "-c", _FIND])],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=messages,
                bufsize=0,  # nothing is left to be written to a process that has ended
            )
        except FileNotFoundError:
            raise OutsideError(
                "there is no ssh: install OpenSSH's client (Debian: openssh-client)"
            ) from None
        with process:
            assert process.stdin is not None
            assert process.stdout is not None
            lines = (line.decode(errors="replace").strip() for line in process.stdout)
            marked = next((line for line in lines if line.startswith(_MARK)), "")
            version = next(lines, "")
            if compare_clocks and version:
                clock = _clock_difference(process.stdin, process.stdout)
        messages.seek(0)
        reasons = messages.read().decode(errors="replace").strip().splitlines()
    reason = f" ({reasons[-1]})" if reasons else ""
    if not marked and process.returncode == NO_PROGRAM:
        raise OutsideError(
            f"{host} has no thorvaldc in /opt/thorvaldc-env or ~/thorvaldc-env; there, as root:"
            " python3 -m venv --system-site-packages /opt/thorvaldc-env &&"
            " /opt/thorvaldc-env/bin/pip install thorvaldc-*.whl"
        )
    if not marked:
        raise OutsideError(
            f"cannot reach {host}{reason}: `ssh {host} true` must work without a password and"
            " without a question"
        )
    program = marked.removeprefix(_MARK)
    if version != f"thorvaldc {program_version()}":
        raise OutsideError(
            f"{host} has {version or f'a broken {program}{reason}'}, and this is thorvaldc"
            f" {program_version()}; there: {program.removesuffix('thorvaldc')}pip install"
            " thorvaldc-*.whl"
        )
    return FarComputer(host, program, clock)


def _ssh(
    host: str, *words: str, stdin: bytes = b"", stdout: int | None = None
) -> subprocess.CompletedProcess[bytes]:
    """Runs a program there with words, which no shell changes."""
    command = [*SSH, "--", host, shlex.join(words)]
    return subprocess.run(command, input=stdin, stdout=stdout, check=False)


def _clock_difference(requests: IO[bytes], answers: IO[bytes]) -> ClockDifference | None:
    """Returns the difference of the clocks by the fastest of some readings, or ``None``.

    A reading of the far clock happens at an unknown instant between a request and its answer:

        here   before ------------------------- after
        there             far clock is read

    so the difference is at most half the time between them from that of the middle.
    """
    differences = []
    for _ in range(CLOCK_READINGS):
        try:
            before = time.time()
            requests.write(b"\n")
            reading = float(answers.readline())
            after = time.time()
        except (OSError, ValueError):  # the connection has ended, or date(1) is not GNU's
            break
        if after >= before:  # or the clock of this computer was set
            middle, half = 0.5 * (before + after), 0.5 * (after - before)
            differences.append(ClockDifference(reading - middle, half))
    return min(differences, key=lambda difference: difference.uncertainty, default=None)
