"""Runs pip and shows how far it is: ``python workshop/show_installation.py COMMAND...``.

On a terminal it is one line that is written anew; elsewhere, such as in CI, it is a line every ten
seconds.  The output of pip appears only if pip fails.  The script needs no package.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time

LAST_LINES = 25
"""Number of lines of pip that are shown after a failure."""
ERASE = "\r\x1b[K"


class Progress:
    """The line with the present step of pip and the time since the start."""

    def __init__(self) -> None:
        self.is_terminal = sys.stderr.isatty()
        self.start = time.monotonic()
        self.step = "starting pip"
        self.packages = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def take(self, line: str) -> None:
        """Takes a line of pip's output."""
        words = line.split()
        if words[:1] == ["Collecting"]:
            self.packages += 1
            self.step = f"package {self.packages}: {words[1].split('=')[0].split('>')[0]}"
        elif words[:1] == ["Downloading"] and len(words) > 2:
            name = words[1].rpartition("/")[2].split("-")[0]
            self.step = f"package {self.packages}: {name} {' '.join(words[2:4])}"
        elif line.startswith("Installing collected packages"):
            self.packages = line.count(",") + 1
            self.step = f"installing {self.packages} packages"

    def end(self, text: str) -> None:
        self._ended.set()
        self._thread.join()
        erase = ERASE if self.is_terminal else ""
        print(f"{erase}  {text}", file=sys.stderr, flush=True)

    def _run(self) -> None:
        while not self._ended.wait(0.2 if self.is_terminal else 10.0):
            seconds = time.monotonic() - self.start
            begin, end = (ERASE, "") if self.is_terminal else ("", "\n")
            line = f"{begin}  {seconds:3.0f} s  {self.step}"[:79]
            print(line, end=end, file=sys.stderr, flush=True)


def main(command: list[str]) -> int:
    progress = Progress()
    lines: list[str] = []
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    )
    assert process.stdout is not None
    try:
        for line in process.stdout:
            lines.append(line)
            progress.take(line)
    except KeyboardInterrupt:
        process.wait()
        progress.end("interrupted")
        return 130
    status = process.wait()
    seconds = time.monotonic() - progress.start
    if status:
        progress.end("pip failed:")
        print("".join(lines[-LAST_LINES:]), end="", file=sys.stderr)
    else:
        progress.end(f"{progress.packages} packages in {seconds:.0f} s")
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
