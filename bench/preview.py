"""Time from the save of a robot file to its picture in `thorvaldc preview`, by stage.

The browser draws with software OpenGL (SwiftShader) on the same cores, as test machines have no
graphics card.  The time that OpenGL needs for one picture is therefore printed apart.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bench.figure import EXAMPLE, ROOT, Figure, python

ROUNDS = 11
OPTIONS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
SIZE = {"width": 1280, "height": 800}
WAIT = 30_000  # ms
PAUSE = 1500  # ms, in which the facts and the smooth picture of the last version become ready
STAGES = {  # of the time from the save to the picture
    "notice": "until the server sees the change, and the way to the page",
    "compile": "compilation",
    "describe": "data of the page",
    "build": "scene and tables in the page",
    "draw": "calls of OpenGL",
    "show": "until the frame after that of the picture begins",
}
OPENGL = """() => {
  const start = performance.now(), gl = viewer.renderer.getContext();
  viewer.draw();
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));  // waits for the picture
  return performance.now() - start;
}"""

Times = dict[str, float]
"""Times in ms by stage; ``total`` is from the save to the picture."""


def figures() -> Iterator[Figure]:
    program = shutil.which("chromium")
    if program is None:
        return
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.yaml"
        file.write_text(EXAMPLE.read_text(encoding="utf-8"), encoding="utf-8")
        command = python("-m", "thorvaldc", "preview", str(file), "--no-browser")
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, env=environment
        ) as server:
            try:
                assert server.stdout is not None
                rounds, opengl = _measured(file, server.stdout.readline().strip(), program)
            finally:
                server.terminate()
    middle = {stage: statistics.median(times[stage] for times in rounds) for stage in rounds[0]}
    stages = ", ".join(f"{stage} {middle[stage]:.0f}" for stage in STAGES)
    yield Figure(
        "save to picture",
        middle["total"],
        "ms",
        150.0,
        "lower",
        f"4WD4WS, window of 1280 x 800, medians of {ROUNDS} in ms: {stages};"
        f" one picture in software OpenGL {opengl:.0f};"
        f" load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
        timed=True,
    )


def _measured(file: Path, url: str, program: str) -> tuple[list[Times], float]:
    """Returns the times of each saved version, and the time (ms) of a picture in OpenGL."""
    from playwright.sync_api import sync_playwright

    text = file.read_text(encoding="utf-8")
    rounds = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(OPTIONS))
        page = browser.new_page(viewport=SIZE, bypass_csp=True)
        page.goto(url)
        page.wait_for_selector("html[data-version='1']", timeout=WAIT)
        for turn in range(1, ROUNDS + 1):
            page.wait_for_timeout(PAUSE)
            new = file.with_suffix(".new")
            new.write_text(text.replace("width: 1.60 m", f"width: 1.{60 + turn} m"), "utf-8")
            start = 1e3 * time.time()
            os.replace(new, file)
            page.wait_for_selector(f"html[data-version='{turn + 1}']", timeout=WAIT)
            times = json.loads(page.evaluate("document.documentElement.dataset.times"))
            received, shown = times.pop("received"), times.pop("shown")
            times["notice"] = received - start - times["compile"] - times["describe"]
            times["show"] = shown - received - times["build"] - times["draw"]
            times["total"] = shown - start
            rounds.append(times)
        opengl = statistics.median(page.evaluate(OPENGL) for _ in range(ROUNDS))
        browser.close()
    return rounds, opengl
