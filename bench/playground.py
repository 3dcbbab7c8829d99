"""The playground in headless Chromium on a static server on this computer, without compression.

The browser draws with software OpenGL (SwiftShader) on the same cores.
"""

from __future__ import annotations

import functools
import http.server
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bench.figure import EXAMPLE, ROOT, Figure

ROUNDS = 3
EDITS = 15
DRIVE_TIME = 10.0
"""Time in s of the drive during which another part of the file is typed."""
OPTIONS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WAIT = 60_000  # ms
# Types a text and waits until the page shows what the compiler says about it: time in ms.
EDIT = """text => new Promise((done) => {
  const start = performance.now();
  const observer = new MutationObserver(() => {
    observer.disconnect();
    done(performance.now() - start);
  });
  observer.observe(document.getElementById("diagnostics"), {childList: true, attributes: true});
  const {length} = editor.view.state.doc;
  editor.view.dispatch({changes: {from: 0, to: length, insert: text}, userEvent: "input"});
})"""
WATCH = """() => {
  window.seen = [];
  const {state} = receivers;
  receivers.state = (message) => {
    seen.push([message.time, performance.now() / 1000]);
    state(message);
  };
}"""


class _Handler(http.server.SimpleHTTPRequestHandler):
    sent = 0

    def log_message(self, *arguments: Any) -> None:
        """Prints nothing."""

    def copyfile(self, source: Any, outputfile: Any) -> None:
        data = source.read()
        type(self).sent += len(data)
        outputfile.write(data)


def figures() -> Iterator[Figure]:
    program = shutil.which("chromium")
    if program is None or shutil.which("npm") is None:
        return
    with tempfile.TemporaryDirectory() as folder:
        site = Path(folder, "site")
        build = [sys.executable, str(ROOT / "playground" / "build.py"), str(site)]
        subprocess.run(build, check=True, cwd=ROOT)
        handler = functools.partial(_Handler, directory=str(site))
        with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            yield from _figures(program, f"http://127.0.0.1:{server.server_address[1]}/", folder)
            server.shutdown()


def _figures(program: str, address: str, folder: str) -> Iterator[Figure]:
    from playwright.sync_api import sync_playwright

    cold, cached, size = [], [], 0
    with sync_playwright() as playwright:
        for number in range(ROUNDS):
            context = playwright.chromium.launch_persistent_context(
                f"{folder}/profile{number}", executable_path=program, args=OPTIONS
            )
            _Handler.sent = 0
            cold.append(_first_robot(context, address))
            size = _Handler.sent
            cached.append(_first_robot(context, address))
            if number + 1 < ROUNDS:
                context.close()
        page = context.pages[-1]
        page.wait_for_selector("#overview table", state="attached", timeout=WAIT)
        edits = _edits(page)
        ratio = _drive(page)
        context.close()
    how = f"median of {ROUNDS}, until it is on the screen"
    yield Figure(
        "playground, first visit", statistics.median(cold), "s", 5.0, "lower", how, timed=True
    )
    yield Figure(
        "playground, cached", statistics.median(cached), "s", 3.0, "lower", how, timed=True
    )
    yield Figure("playground, size", size / 1e6, "MB", 10.0, "lower", "sent until the first robot")
    yield Figure(
        "playground, a key",
        statistics.median(edits),
        "ms",
        150.0,
        "lower",
        f"until its diagnostics, median of {EDITS}, longest {max(edits):.0f} ms",
        timed=True,
    )
    yield Figure(
        "playground, driving",
        ratio,
        "",
        0.97,
        "higher",
        "simulated time by real time while another part of the file is typed",
        timed=True,
    )


def _first_robot(context: Any, address: str) -> float:
    page = context.new_page()
    start = time.perf_counter()
    page.goto(address)
    page.wait_for_selector("html[data-version]", timeout=WAIT)
    return time.perf_counter() - start


def _edits(page: Any) -> list[float]:
    text = EXAMPLE.read_text(encoding="utf-8")
    times = []
    for number in range(EDITS):
        # Wrong values, and every third time an unknown key, which jsonschema reports.
        wrong = (
            f"{text}x{number}: 1\n" if number % 3 == 0 else text.replace("1.60 m", f"{number} kg")
        )
        times.append(page.evaluate(EDIT, wrong))
        page.wait_for_timeout(200)
    page.evaluate(EDIT, text)
    return times


def _drive(page: Any) -> float:
    page.evaluate(WATCH)
    page.click("#drive")
    page.wait_for_selector("#drive[aria-pressed=true]", timeout=WAIT)
    page.wait_for_timeout(1000)
    page.click(".cm-content")
    page.keyboard.press("Control+End")
    page.evaluate("setInterval(() => send({kind: 'motion', x: 1, y: 0, yaw: 0.2}), 50)")
    page.evaluate("seen.length = 0")
    end = time.monotonic() + DRIVE_TIME
    page.keyboard.type("# ")
    while time.monotonic() < end:
        page.keyboard.type("x")
        page.wait_for_timeout(180)
    (first, start), (last, stop) = page.evaluate("[seen[0], seen.at(-1)]")
    return float((last - first) / (stop - start))
