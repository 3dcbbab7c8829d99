"""Runs the pages of the tutorial and some how-tos as a reader does: files and commands.

A page is a sequence of blocks between triple backquotes:

- with a ``title`` that is a file name: the file is written;
- ``diff``: lines of the file of ``<!-- test: edit FILE -->`` are exchanged;
- ``console``: the lines after ``$`` are run, and what they print is compared with the lines below.
  A line ``...`` stands for any lines, and ``...`` at the end of a line for its rest.  With the
  title ``Terminal 2`` the last command keeps running, and the page continues when it has printed
  what the block shows.

A comment before a block changes this, with one or more of these parts, separated by ``;``:

- ``<!-- test: not run; REASON -->``
- ``<!-- test: in the container -->``: changes the computer, and is left out elsewhere
- ``<!-- test: keys iii q -->``: presses the keys, ten in a second; a space is a pause of a second
- ``<!-- test: fails -->``: the last command has an exit status that is not 0
- ``<!-- test: numbers differ by 20 % -->``; speeds and hashes by any amount
- ``<!-- test: stop Terminal 2 -->``: presses Ctrl-C there
- ``<!-- test: screenshot NAME.png -->``: opens the address that the block prints, in a browser

``python -m tests.docs.tutorial`` runs all pages, corrects the output that they show, and
stores the pictures that they show.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import time
from dataclasses import dataclass, field
from pathlib import Path

from tests.browser import WAIT, chromium
from tests.child_process import ChildProcess
from tests.ros.environments import python_of, variables

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs"
TUTORIAL = ("first-robot", "own-module", "simulation", "bus", "ros2", "computer")
HOW_TO = ("module", "scenario", "study")  # continue in the folder of the tutorial
PAGES = (*(f"tutorial/{name}" for name in TUTORIAL), *(f"how-to/{name}" for name in HOW_TO))
BLOCK = re.compile(
    r"(?:^<!-- test: (?P<marks>[^\n]*) -->\n)?"
    r'^```(?P<language>\w+)(?: title="(?P<title>[^"\n]*)")?\n(?P<text>.*?)^```$',
    re.M | re.S,
)
VARYING = re.compile(r"(?<![\w.])(?:\d+x|[0-9a-f]{8}(?:[0-9a-f]{8})?)(?!\w)")
"""Speeds, and hashes of results, which depend on the computer."""
AS_IN_A_TERMINAL = {"PYTHONUNBUFFERED": "1"}
"""Keeps the order of results and messages, as a person sees them."""
IN_REAL_TIME = "chrt --reset-on-fork --fifo 20"
LONGEST_COMMAND_S = 240.0  # `sim --plot` needs 45 s beside six other programs on two cores
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")


@dataclass
class Block:
    language: str
    title: str
    text: str
    marks: list[str]
    span: tuple[int, int]  # of the text, in the page

    def value(self, mark: str) -> str:
        """Returns what follows the words of a mark; an empty string without the mark."""
        return next((m[len(mark) :].strip() for m in self.marks if m.startswith(mark)), "")

    @property
    def tolerance(self) -> float:
        return float((self.value("numbers differ by") or "0").split()[0]) / 100

    def has(self, mark: str) -> bool:
        return any(m.startswith(mark) for m in self.marks)


def blocks_of(page: str) -> list[Block]:
    return [
        Block(
            match["language"],
            match["title"] or "",
            match["text"],
            [mark.strip() for mark in (match["marks"] or "").split(";")],
            match.span("text"),
        )
        for match in BLOCK.finditer(page)
    ]


def mismatch(shown: str, printed: str, tolerance: float = 0.0) -> str | None:
    """Returns the first line of ``shown`` that was not printed; ``None`` if all were.

    ``tolerance`` is the relative tolerance of numbers.  With one, speeds and hashes are not
    compared.
    """
    lines = [line.strip() for line in printed.strip().splitlines()]
    position, anywhere = 0, False
    for line in shown.strip().splitlines():
        if line.strip() == "...":
            anywhere = True
            continue
        end = len(lines) if anywhere else position + 1
        equal = [
            i for i in range(position, end) if i < len(lines) and alike(line, lines[i], tolerance)
        ]
        if not equal:
            return line
        position, anywhere = equal[0] + 1, False
    if position < len(lines) and not anywhere:
        return f"nothing, but it printed: {lines[position]}"
    return None


def alike(shown: str, printed: str, tolerance: float) -> bool:
    if shown.endswith(" ..."):
        return printed.startswith(shown.removesuffix("...").strip())
    if not tolerance:
        return shown.split() == printed.split()
    pair = [VARYING.sub("~", " ".join(text.split())) for text in (shown, printed)]
    if NUMBER.sub("", pair[0]) != NUMBER.sub("", pair[1]):
        return False
    numbers = [[float(number) for number in NUMBER.findall(text)] for text in pair]
    return len(numbers[0]) == len(numbers[1]) and all(
        abs(a - b) <= tolerance * max(abs(a), abs(b), 0.05) for a, b in zip(*numbers, strict=True)
    )


@dataclass
class Reader:
    """Somebody who follows the tutorial in ``folder``, with the environment ``variables``."""

    folder: Path
    variables: dict[str, str]
    is_in_container: bool = False
    terminals: dict[str, ChildProcess] = field(default_factory=dict)
    printed: dict[int, str] = field(default_factory=dict)
    """Output that differs from a console block of the page, by the beginning of the block."""

    def follow(self, page: str) -> list[str]:
        """Does what a page says; returns the differences."""
        try:
            return self._follow(page)
        except BaseException:  # a test is skipped where a browser is missing
            for process in self.terminals.values():
                process.end()
            self.terminals.clear()
            raise

    def _follow(self, page: str) -> list[str]:
        self.printed = {}
        differences: list[str] = []
        for block in blocks_of(page):
            if block.has("stop"):
                differences += self.stop(block.value("stop"))
            if block.has("not run") or (block.has("in the container") and not self.is_in_container):
                continue
            if block.language == "console":
                differences += self.type_in(block)
            elif block.language == "diff":
                self.edit(self.folder / block.value("edit"), block.text)
            elif block.title:
                path = self.folder / block.title
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(block.text, encoding="utf-8")
        for name in reversed(list(self.terminals)):
            differences += self.stop(name)
        return differences

    def follow_in_real_time(self, page: str, attempts: int = 5) -> list[str]:
        """Follows a page; again from its beginning if it has programs that run in real time.

        On a busy computer, a driver may also stop while the page drives.
        """
        with tempfile.TemporaryDirectory(dir=self.folder.parent) as name:
            before = Path(name) / "before"
            shutil.copytree(self.folder, before)
            differences = self.follow(page)
            while differences and "Terminal" in page and (attempts := attempts - 1):
                shutil.rmtree(self.folder)
                shutil.copytree(before, self.folder)
                differences = self.follow(page)
        return differences

    def edit(self, path: Path, change: str) -> None:
        text = path.read_text(encoding="utf-8")
        for group in re.findall(r"(?:^[- ].*\n)+(?:^\+.*\n)*", change, re.M):
            lines = group.splitlines(keepends=True)
            before = "".join(line[1:] for line in lines if line[0] != "+")
            assert text.count(before) == 1, before
            text = text.replace(before, "".join(line[1:] for line in lines if line[0] != "-"))
        path.write_text(text, encoding="utf-8")

    def type_in(self, block: Block) -> list[str]:
        parts = re.split(r"^\$ (.*)\n", block.text, flags=re.M)[1:]
        commands = list(zip(parts[::2], parts[1::2], strict=True))
        differences, result = [], ""
        for number, (command, shown) in enumerate(commands):
            last = number == len(commands) - 1
            if block.has("keys"):
                output, status = self.press(command, block.value("keys"))
            elif block.title and last:
                output, status = self.start(block, command, shown), 0
                if block.has("screenshot"):
                    take_screenshot(output, self.folder / block.value("screenshot"))
            else:
                output, status = self.run(command)
            result += f"$ {command}\n{output.rstrip()}\n" if output else f"$ {command}\n"
            if (status != 0) != (last and block.has("fails")):
                differences.append(f"{command}: exit status {status}\n{output}")
            elif not block.has("keys") and (line := mismatch(shown, output, block.tolerance)):
                differences.append(f"{command}: the page shows: {line}\n{output}")
        if differences:
            self.printed[block.span[0]] = result
        return differences

    def run(self, command: str) -> tuple[str, int]:
        with ChildProcess(
            ["sh", "-c", command],
            cwd=self.folder,
            env={**self.variables, **AS_IN_A_TERMINAL},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
        ) as process:
            try:
                return process.communicate(timeout=LONGEST_COMMAND_S)[0], process.returncode
            except subprocess.TimeoutExpired:
                process.end()
                return f"(did not end in {LONGEST_COMMAND_S:g} s)\n", 1

    def press(self, command: str, keys: str) -> tuple[str, int]:
        """Runs a command in a terminal of 80 columns and 24 lines, and presses keys."""
        master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        with ChildProcess(
            ["sh", "-c", f"exec {command}"],
            cwd=self.folder,
            env={**self.variables, **AS_IN_A_TERMINAL, "TERM": "xterm"},
            **dict.fromkeys(("stdin", "stdout", "stderr"), slave),
        ) as process:
            os.close(slave)
            output, waiting, end = b"", f"  {keys}", time.monotonic() + 60
            while process.poll() is None and time.monotonic() < end:
                key, waiting = waiting[:1], waiting[1:]
                if key.strip():
                    os.write(master, key.encode())
                pause = time.monotonic() + (0.1 if key.strip() else 1.0)
                while (rest := pause - time.monotonic()) > 0:
                    if select.select([master], [], [], rest)[0]:
                        with contextlib.suppress(OSError):  # the program has ended
                            output += os.read(master, 65536)
            process.end()
        os.close(master)
        return output.decode(errors="replace"), process.returncode

    def start(self, block: Block, command: str, shown: str) -> str:
        """Starts a command in a terminal of its own; waits until it has printed the lines.

        A driver stops with a fault where a busy computer holds up the simulated bus; then the
        command is started again, as the page says.
        """
        for _ in range(6):
            output = self.start_once(block, command, shown)
            if self.terminals[block.title].poll() is None:
                break
        return output

    def start_once(self, block: Block, command: str, shown: str) -> str:
        name = block.title
        log = self.folder / f".{name}"
        with log.open("w") as file:
            self.terminals[name] = ChildProcess(
                ["sh", "-c", f"exec {command}"],
                cwd=self.folder,
                env={**self.variables, **AS_IN_A_TERMINAL},
                stdout=file,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
            )
        end = time.monotonic() + 40
        while time.monotonic() < end and self.terminals[name].poll() is None:
            output = log.read_text(encoding="utf-8")
            if output and mismatch(shown, output, block.tolerance) is None:
                break
            time.sleep(0.1)
        return log.read_text(encoding="utf-8")

    def stop(self, name: str) -> list[str]:
        """Presses Ctrl-C in a terminal; returns what went wrong."""
        with self.terminals.pop(name) as process:
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=300)
            status = process.poll()
            process.end()
        log = (self.folder / f".{name}").read_text(encoding="utf-8")
        return [] if status == 0 else [f"{name}: exit status {status} after Ctrl-C\n{log}"]


def with_output(page: str, printed: dict[int, str]) -> str:
    """Returns the page with the output of its commands; blocks with ``...`` stay as they are."""
    for block in reversed(blocks_of(page)):
        start, end = block.span
        if (
            start in printed
            and not block.has("keys")
            and "\n...\n" not in f"\n{block.text}"
            and not block.title
        ):
            page = page[:start] + printed[start] + page[end:]
    return page


def programs_in(folder: Path) -> Path:
    """Writes ``python``, ``pip`` and ``thorvaldc`` of this environment; returns the folder.

    What runs in real time, a driver and its simulated bus, has the priority of the service on a
    robot where this computer permits it: then busy programs do not hold it up.
    """
    folder.mkdir()
    for name, arguments in (("python", ""), ("pip", "-m pip "), ("thorvaldc", "-m thorvaldc ")):
        command = f'{sys.executable} {arguments}"$@"\n'
        urgent = f"case $1 in bus|run) exec {IN_REAL_TIME} {command};; esac\n"
        is_urgent = name == "thorvaldc" and may_run_in_real_time()
        script = folder / name
        text = f"#!/bin/sh\n{urgent if is_urgent else ''}exec {command}"
        script.write_text(text, encoding="utf-8")
        script.chmod(0o755)
    return folder


def may_run_in_real_time() -> bool:
    try:
        command = [*IN_REAL_TIME.split(), "true"]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:  # no util-linux
        return False


def ros_programs_in(folder: Path) -> None:
    """Writes the programs ``colcon`` and ``ros2`` of an environment with the wheels of ROS 2."""
    python = Path(python_of("jazzy"))
    path = f'PATH="{python.parent}:$PATH" PYTHONPATH="$PYTHONPATH:{ROOT}"'
    for name, command in (
        ("colcon", python.with_name("colcon")),
        ("ros2", f"{python} -m tests.docs.ros2_command"),
    ):
        script = folder / name
        script.write_text(f'#!/bin/sh\n{path} exec {command} "$@"\n', encoding="utf-8")
        script.chmod(0o755)


def take_screenshot(output: str, picture: Path) -> None:
    """Stores what a browser shows of the address in ``output``, a page with a picture in 3D."""
    address = re.findall(r"http://\S+", output)[0]
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 1000, "height": 600})
        page.goto(address)
        page.wait_for_selector("html[data-version]", timeout=WAIT)
        page.wait_for_selector("#overview table", state="attached", timeout=WAIT)
        page.wait_for_timeout(1000)  # for the picture in 3D
        page.screenshot(path=picture)


def pictures_in(page: str) -> list[str]:
    return re.findall(r"\(pictures/(\S+)\)", page)


def picture_difference(first: Path, second: Path) -> float:
    """Returns the mean difference of two pictures per pixel, from 0 to 1 (black and white)."""
    from PIL import Image, ImageChops, ImageStat

    pictures = [Image.open(path).convert("RGBA").convert("RGB") for path in (first, second)]
    if pictures[0].size != pictures[1].size:
        return 1.0
    small = [picture.resize((160, 100)) for picture in pictures]  # edges and texts may move a bit
    return max(ImageStat.Stat(ImageChops.difference(*small)).mean) / 255.0


def store_pictures(source: Path, names: list[str]) -> None:
    from PIL import Image

    for name in names:
        if (source / name).exists():
            with Image.open(source / name) as image:
                small = image.convert("P", palette=Image.Palette.ADAPTIVE, colors=96)
                small.save(FOLDER / "tutorial" / "pictures" / name, optimize=True)


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        programs = programs_in(Path(name) / "bin")
        ros_programs_in(programs)
        path = f"{programs}{os.pathsep}{os.environ['PATH']}"
        environment = {**variables(Path(name)), "PATH": path, "BROWSER": "true"}
        reader = Reader(Path(name) / "scout", environment)
        reader.folder.mkdir()
        for page in PAGES:
            file = FOLDER / f"{page}.md"
            text = file.read_text(encoding="utf-8")
            for difference in reader.follow_in_real_time(text):
                print(f"{page}: {difference}")
            text = with_output(text, reader.printed)
            file.write_text(text, encoding="utf-8")
            store_pictures(reader.folder, pictures_in(text))


if __name__ == "__main__":
    main()
