"""The page of ``thorvaldc preview`` in a browser, and the requests that its server refuses."""

from __future__ import annotations

import asyncio
import http.client
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import aiohttp
import pytest
from playwright.sync_api import Browser, Page

from tests.accessibility import axe_script, violations
from tests.browser import WAIT, chromium, wait_until
from tests.child_process import ChildProcess
from tests.commissioning import test_commission_page
from tests.examples import example_robot
from tests.slow import mostly_exhaustive
from thorvaldc.commissioning.commission_page import page_of
from thorvaldc.comparison.robot_comparison import compare_robots
from thorvaldc.compiler.pipeline import emit
from thorvaldc.simulation.web_viewer import view_page
from thorvaldc.tools.comparison.comparison_output import difference_page

ROOT = Path(__file__).parents[3]
GOOD = (ROOT / "examples" / "4wd4ws_wide" / "robot.yaml").read_text(encoding="utf-8")
BAD = GOOD + "\nfoo: 3\n"
SIZES, IDS = ((1280, 800), (390, 844)), ("desk", "phone")

pytestmark = pytest.mark.xdist_group("preview")


class Preview:
    def __init__(self, file: Path, **options: int) -> None:
        self.file = file
        self.process = ChildProcess(
            [
                sys.executable,
                "-m",
                "thorvaldc",
                "preview",
                str(self.file),
                "--no-browser",
            ],
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            **options,
        )
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()
        self.port = urlsplit(self.url).port or 0

    def save(self, text: str) -> None:
        new = self.file.with_suffix(".new")
        new.write_text(text, encoding="utf-8")
        os.replace(new, self.file)  # as most editors do

    def status(self, path: str, **headers: str) -> int:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=WAIT / 1000)
        try:
            connection.request("GET", path, headers=headers)
            return connection.getresponse().status
        finally:
            connection.close()

    def end(self) -> int:
        self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(WAIT / 1000)
        finally:
            self.process.end()


@pytest.fixture(scope="module")
def preview(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Preview]:
    file = tmp_path_factory.mktemp("preview") / "robot.yaml"
    file.write_text(GOOD, encoding="utf-8")
    server = Preview(file)
    yield server
    assert server.end() == 0


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    return axe_script(tmp_path_factory.mktemp("axe"))


@pytest.fixture
def page(request: pytest.FixtureRequest, preview: Preview, browser: Browser) -> Iterator[Page]:
    width, height = getattr(request, "param", SIZES[0])
    page = browser.new_page(viewport={"width": width, "height": height})
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(preview.url)
    page.wait_for_selector("html[data-version]", timeout=WAIT)
    page.wait_for_selector("#overview table", state="attached", timeout=WAIT)
    yield page
    page.close()
    assert errors == []


def version(page: Page) -> int:
    return int(page.evaluate("document.documentElement.dataset.version"))


def wait_for_change(page: Page, before: int) -> None:
    wait_until(page, lambda: version(page) > before)


def position(page: Page) -> Any:
    return page.evaluate("Number((document.documentElement.dataset.position || '0').split(' ')[0])")


@pytest.mark.slow
@pytest.mark.parametrize("page", SIZES, ids=IDS, indirect=True)
def test_a_change_an_error_and_the_way_back(preview: Preview, page: Page) -> None:
    assert "190.6 kg" in page.inner_text("#facts")
    assert page.evaluate("Number(document.documentElement.dataset.triangles)") > 1000
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    before = version(page)
    preview.save(BAD)
    page.wait_for_selector(".diagnostic.error", timeout=WAIT)
    excerpt = page.locator(".diagnostic pre")
    line, caret = excerpt.inner_text().splitlines()[1:3]
    assert line.index("foo") == caret.index("^^^")
    assert excerpt.evaluate("pre => getComputedStyle(pre).whiteSpace") == "pre"  # one row per line
    assert excerpt.evaluate("pre => pre.scrollWidth == pre.clientWidth")
    assert "hint: known keys are `thorvaldc`" in page.inner_text(".diagnostic")
    wait_for_change(page, before)
    assert page.evaluate("viewer.isGrey && viewer.robots.length") == 1
    assert "1 error; more checks follow" in page.inner_text("#status")
    before = version(page)
    preview.save(GOOD.replace("thorvald_4wd4ws_wide", "renamed"))
    wait_for_change(page, before)
    assert page.inner_text("h1") == "renamed"
    assert page.locator(".diagnostic").count() == 0
    assert not page.evaluate("viewer.isGrey")
    page.wait_for_selector("#difference:not([hidden])", timeout=WAIT)
    before = version(page)
    preview.save(GOOD)
    wait_for_change(page, before)


@pytest.mark.slow
def test_joints_move_and_keep_their_positions(preview: Preview, page: Page) -> None:
    page.click("summary:has-text('Joints')")
    slider = page.locator("input[data-joint=fl_steering_joint]")
    slider.focus()
    page.keyboard.press("ArrowRight")
    value = page.evaluate("viewer.robots[0].positions.fl_steering_joint")
    assert value > 0
    before = version(page)
    preview.save(GOOD + "\n# a comment\n")
    wait_for_change(page, before)
    assert page.evaluate("viewer.robots[0].positions.fl_steering_joint") == value
    for switch, frame in (("frames", "base_link"), ("sensors", "imu"), ("ports", "frame.center")):
        shown = f"viewer.robots[0].frames.find((f) => f.userData.name === '{frame}').visible"
        assert not page.evaluate(shown)
        page.click(f"#{switch}")
        assert page.evaluate(shown)
    page.click("#names")
    labels = page.locator("#labels .free")
    wait_until(page, lambda: "frame.center" in labels.all_inner_texts())
    assert "frame.front_left" not in labels.all_inner_texts()
    # All at once: the page may place its labels again between two requests.
    boxes = page.locator("#labels span:visible").evaluate_all(
        "spans => spans.map((span) => span.getBoundingClientRect().toJSON())"
    )
    assert len(boxes) > 10
    for a, b in itertools.combinations(boxes, 2):
        beside = abs(a["x"] + a["width"] / 2 - b["x"] - b["width"] / 2)
        below = abs(a["y"] - b["y"])
        assert beside > (a["width"] + b["width"]) / 2 - 0.1 or below > a["height"] - 0.1
    row = page.locator("#port-rows tr", has_text="frame.front_left")
    assert row.locator("td").all_text_contents() == ["frame.front_left", "frame_clamp", "fl"]


@pytest.mark.slow
def test_each_control_is_reached_with_the_keyboard(page: Page) -> None:
    page.eval_on_selector("details:has(#joints)", "joints => { joints.open = true; }")
    page.evaluate("document.activeElement.blur()")
    seen = set()
    for _ in range(16):
        page.keyboard.press("Tab")
        seen.add(page.evaluate("document.activeElement.id"))
    assert {"canvas", "drive", "names", "frames", "sensors", "zero"} <= seen
    page.focus("#canvas")
    before = page.evaluate("viewer.camera.position.x")
    page.keyboard.press("ArrowLeft")
    assert page.evaluate("viewer.camera.position.x") != before


@pytest.mark.slow
def test_the_ground_has_no_end(page: Page) -> None:
    moved = (
        "viewer.controls.target.set(40.4, -7.6, 0); viewer.draw(); viewer.grid.position.toArray()"
    )
    assert page.evaluate(moved) == [40, -8, 0]
    assert page.evaluate("viewer.grid.visible")


@pytest.mark.slow
def test_the_robot_drives_while_a_key_is_held(page: Page) -> None:
    page.click("#drive")
    page.wait_for_selector("#drive[aria-pressed=true]", timeout=WAIT)
    wait_until(page, lambda: page.evaluate("'position' in document.documentElement.dataset"))
    page.wait_for_timeout(500)
    start = position(page)
    assert abs(start) < 0.01  # it does not move unasked
    assert "W ↑ forward" in page.inner_text("#drive-keys")
    page.keyboard.down("w")
    wait_until(page, lambda: position(page) > start + 0.2)
    page.keyboard.up("w")
    assert page.evaluate("viewer.way.length") > 1  # drawn on the ground
    page.wait_for_timeout(2500)
    stopped = position(page)
    page.wait_for_timeout(500)
    assert position(page) == pytest.approx(stopped, abs=0.01)
    page.focus("#canvas")  # where arrows else turn the picture
    page.keyboard.down("ArrowDown")
    wait_until(page, lambda: position(page) < stopped - 0.1)
    page.keyboard.up("ArrowDown")
    page.keyboard.press("Escape")
    page.wait_for_selector("#drive[aria-pressed=false]", timeout=WAIT)


@pytest.mark.slow
def test_a_robot_drives_in_the_world_of_a_scenario(browser: Browser) -> None:
    server = Preview(ROOT / "examples" / "scenarios" / "field_edge.yaml")
    page = browser.new_page()
    page.goto(server.url)
    page.wait_for_selector("html[data-version]", timeout=WAIT)
    assert "slope 4 deg" in page.inner_text("#world")
    name = "viewer.surroundings.meshes.map((mesh) => mesh.userData.name)"
    assert "crate" in page.evaluate(name)
    page.click("#drive")
    page.wait_for_selector("#drive[aria-pressed=true]", timeout=WAIT)
    page.keyboard.down("w")
    wait_until(page, lambda: position(page) > 0.1)
    page.close()
    assert server.end() == 0


@pytest.mark.slow
@pytest.mark.parametrize("size", mostly_exhaustive(SIZES), ids=IDS)
def test_the_page_is_accessible(
    preview: Preview, browser: Browser, axe: str, size: tuple[int, int]
) -> None:
    width, height = size
    page = browser.new_page(viewport={"width": width, "height": height}, bypass_csp=True)
    found = []

    def check(state: str) -> None:
        for colours in ("light", "dark"):
            page.emulate_media(color_scheme=colours)
            found.extend(violations(page, axe, f"{state} {colours}"))

    page.goto(preview.url)
    page.wait_for_selector("#overview table", state="attached", timeout=WAIT)
    page.click("#names")
    page.click("#ports")
    check("robot")
    preview.save(BAD)
    page.wait_for_selector(".diagnostic.error", timeout=WAIT)
    page.wait_for_timeout(200)  # the picture fades
    check("error")
    preview.save(GOOD)
    page.wait_for_selector(".diagnostic.error", state="detached", timeout=WAIT)
    page.click("#drive")
    page.wait_for_selector("#drive[aria-pressed=true]", timeout=WAIT)
    check("driving")
    page.close()
    assert found == []


@pytest.mark.slow
def test_exported_pages_are_accessible(browser: Browser, axe: str, tmp_path: Path) -> None:
    robot, before = example_robot("4wd4ws_wide"), example_robot("4wd4ws_slim")
    texts = {
        "view": view_page(robot).encode(),
        "diff": difference_page(compare_robots(before, robot), before, robot).encode(),
        "datasheet": emit(robot, ["datasheet"])["datasheet/datasheet.html"],
        "first motion": page_of(test_commission_page.ROBOT, test_commission_page.report()).encode(),
    }
    found = []
    for name, text in texts.items():
        path = tmp_path / f"{name}.html"
        path.write_bytes(text)
        for (width, height), colours in zip(SIZES, ("light", "dark"), strict=True):
            page = browser.new_page(
                viewport={"width": width, "height": height}, color_scheme=colours, bypass_csp=True
            )
            page.goto(path.as_uri())
            found += violations(page, axe, f"{name} {width} {colours}")
            assert page.evaluate("document.documentElement.scrollWidth") <= width, name
            page.close()
    assert found == []


def test_requests_that_are_refused(preview: Preview) -> None:
    path = urlsplit(preview.url).path
    assert preview.status(path) == 200
    assert preview.status("/") == 403
    assert preview.status("/wrong/") == 403
    assert preview.status(path, Host="evil.example") == 403
    assert preview.status(path, Host=f"evil.example:{preview.port}") == 403
    assert preview.status(path, Origin="http://evil.example") == 403
    assert preview.status(path, Origin="null") == 403
    assert preview.status(f"{path}socket") == 403  # without an origin
    for name in ("robot.yaml", "../robot.yaml", "..%2f..%2fetc/passwd", "//etc/passwd"):
        assert preview.status(path + name) in (403, 404)


NO_MESSAGES = (
    "[" * 4000,  # nested deeper than Python reads
    '{"kind": ' + "[" * 4000,
    '{"kind": "drawn", "times": {"page": 1' + "0" * 400 + "}}",
    '{"kind": "drawn", "times": [1]}',
    "[]",
    "nonsense",
)


@pytest.mark.slow
def test_a_message_that_is_none_of_the_page_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(GOOD, encoding="utf-8")
    with (tmp_path / "messages").open("w") as messages:
        server = Preview(tmp_path / "robot.yaml", stderr=messages.fileno())

    async def talk() -> None:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(
                f"{server.url}socket", origin=f"http://127.0.0.1:{server.port}"
            ) as connection,
        ):
            await connection.receive(timeout=WAIT / 1000)
            for message in NO_MESSAGES:
                await connection.send_str(message)
            await connection.send_str('{"kind": "drive", "on": true}')
            while True:  # the connection still serves
                answer = await connection.receive(timeout=WAIT / 1000)
                assert answer.type is aiohttp.WSMsgType.TEXT
                if json.loads(answer.data)["kind"] == "drive":
                    return

    # The browser of other tests keeps an event loop of its own in this thread.
    with ThreadPoolExecutor(1) as other_thread:
        other_thread.submit(lambda: asyncio.run(talk())).result()
    assert server.end() == 0
    assert "Traceback" not in (tmp_path / "messages").read_text()


def test_a_port_in_use(tmp_path: Path) -> None:
    """In a process of its own: the browser of other tests keeps an event loop in this one."""
    (tmp_path / "robot.yaml").write_text(GOOD, encoding="utf-8")
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        command = [sys.executable, "-m", "thorvaldc", "preview", "robot.yaml", "--no-browser"]
        result = subprocess.run(
            [*command, "--port", port], cwd=tmp_path, capture_output=True, text=True, check=False
        )
    assert result.returncode == 3
    assert port in result.stderr
    assert "--port" in result.stderr
