"""The page of ``run --status-port``: its values, what it refuses, and its stop button.

The robot drives on a simulated bus in virtual time, so that no busy computer makes a drive silent;
the page is in its own process, and the browser in a thread.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import math
import re
import socket
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

import pytest

from tests.simulation.bus.robots import CIA402, compiled
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import RequestRefused
from thorvaldc.runtime.control_channel import ControlClient
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import DriverState
from thorvaldc.runtime.loopback import listen
from thorvaldc.runtime.run_session import RunSession
from thorvaldc.runtime.se2 import Twist
from thorvaldc.runtime.status_page import status_page
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

T = TypeVar("T")
WAIT = 120.0
"""Longest time (s) for what a busy computer does slowly."""


@dataclass
class Answer:
    status: int
    text: str

    @property
    def json(self) -> Any:
        return json.loads(self.text)


class Site:
    """A driven robot and its page.  ``speed``: fastest simulated wheel (rad/s)."""

    def __init__(self, robot: Robot, channel: str) -> None:
        self.simulated = SimulatedRobot(robot)
        self.simulated.power_on()
        interfaces = {bus.name: self.simulated.interface(bus.name) for bus in robot.buses}
        self.session = RunSession(robot, interfaces, channel=channel, threaded=False)
        actuators = (robot.actuator_of(wheel.spin_joint) for wheel in robot.wheels)
        self.motors = [self.simulated.motors[a.name] for a in actuators if a is not None]
        self.channel = channel
        self.listener = listen(0, "--status-port")
        self.port = self.listener.getsockname()[1]
        self.speed = math.nan

    def request(self, method: str, path: str, **headers: str) -> Answer:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=WAIT)
        with contextlib.closing(connection):
            connection.request(method, path, headers=headers)
            answer = connection.getresponse()
            return Answer(answer.status, answer.read().decode())

    def state(self) -> Any:
        with contextlib.closing(ControlClient(self.channel, WAIT)) as client:
            return client.call("state")

    def until(self, reached: Callable[[], bool]) -> None:
        """Waits for what stays true, in virtual time, of which a minute must be enough."""
        now = self.state()["time"]
        end = now + 60.0
        while not reached():
            assert now < end
            now = self.state()["time"]

    def token(self) -> str:
        page = self.request("GET", "/").text
        match = re.search(r'"X-Token": "([^"]{20,})"', page)
        assert match is not None
        return match[1]

    def while_it_runs(self, browser: Callable[[Site], T], *, drives: bool = True) -> T:
        """Calls ``browser`` in a thread while the robot runs, at 0.5 m/s or disarmed."""

        def watch(driven: DrivenRobot, state: DriverState) -> None:
            if drives and not driven.armed and driven.feed is None:
                with contextlib.suppress(RequestRefused):
                    driven.arm()
            elif drives and driven.feed is None:
                driven.feed = lambda driver, now: driver.command(Twist(0.5, 0.0, 0.0), now)
            now = self.simulated.timeline.seconds
            self.speed = max(abs(motor.read(now).velocity) for motor in self.motors)
            if future.done():
                self.session.request_stop()

        def browse() -> T:
            self.until(lambda: not drives or self.speed > 2.0)
            return browser(self)

        with ThreadPoolExecutor(1) as thread, status_page(self.listener, self.channel):
            future = thread.submit(browse)
            self.session.run(watch)
        return future.result()


@pytest.fixture(scope="module")
def robot() -> Robot:
    return compiled(CIA402)


@pytest.fixture
def site(robot: Robot) -> Iterator[Site]:
    with tempfile.TemporaryDirectory(prefix="tv") as folder:  # a socket's path is short
        yield Site(robot, f"{folder}/control")


@pytest.mark.slow
def test_the_stop_button_stops_the_wheels(site: Site) -> None:
    def press(site: Site) -> tuple[Answer, Any]:
        answer = site.request("POST", "/stop", **{"X-Token": site.token()})
        site.until(lambda: site.speed == 0.0)
        return answer, site.state()

    answer, state = site.while_it_runs(press)
    assert answer.status == 200
    assert "release_safety_stop" in answer.text
    assert (state["supervisor"], state["armed"]) == ("estop", False)


REFUSED: list[tuple[str, dict[str, str], int]] = [
    ("/stop", {}, 403),
    ("/stop", {"X-Token": "no token"}, 403),
    ("/stop", {"X-Token": "TOKEN", "Host": "robot.example:PORT"}, 403),
    ("/stop", {"X-Token": "TOKEN", "Host": "127.0.0.1:1"}, 403),
    ("/stop", {"X-Token": "TOKEN", "Origin": "http://robot.example"}, 403),
    ("/stop", {"X-Token": "TOKEN", "Origin": "null"}, 403),
    ("/state", {"X-Token": "TOKEN"}, 404),
    ("/arm", {"X-Token": "TOKEN"}, 404),
]
"""Path and headers of a POST, and the status of its answer."""


@pytest.mark.slow
def test_other_posts_are_refused_and_the_robot_goes_on(site: Site) -> None:
    def post(site: Site) -> tuple[list[int], Any, float]:
        token = site.token()

        def status(path: str, headers: dict[str, str]) -> int:
            values = {
                key: text.replace("TOKEN", token).replace("PORT", str(site.port))
                for key, text in headers.items()
            }
            return site.request("POST", path, **values).status

        statuses = [status(path, headers) for path, headers, _ in REFUSED]
        later = site.state()["time"] + 1.0
        site.until(lambda: site.state()["time"] > later)
        return statuses, site.state(), site.speed

    statuses, state, speed = site.while_it_runs(post)
    assert statuses == [status for *_, status in REFUSED]
    assert (state["armed"], state["stopped_by"]) == (True, [])
    assert speed > 2.0


def test_what_can_be_read(site: Site) -> None:
    def read(site: Site) -> tuple[list[int], str]:
        paths = ["/", "/state", "/explain/TV880", "/stop", "/index.html", "/explain/TV1", "//etc"]
        statuses = [site.request("GET", path).status for path in paths]
        for headers in ({"Host": "robot.example"}, {"Origin": "http://robot.example"}):
            statuses += [site.request("GET", path, **headers).status for path in ("/", "/state")]
        return statuses, site.request("GET", "/explain/TV880").text

    statuses, page = site.while_it_runs(read, drives=False)
    assert statuses == [200, 200, 200, 404, 404, 404, 404, 403, 403, 403, 403]
    assert "# TV880 bus-stopped" in page


@pytest.mark.slow
def test_a_client_that_hangs_stops_nothing(site: Site) -> None:
    def hang(site: Site) -> tuple[float, Answer, Any]:
        with contextlib.ExitStack() as stack:
            for request in (b"GET / HT", b"POST /stop HTTP/1.1\r\nHost: 127.0.0.1", b""):
                client = socket.create_connection(("127.0.0.1", site.port), WAIT)
                stack.enter_context(client).sendall(request)
            cycles = site.state()["cycles"]
            site.until(lambda: site.state()["cycles"] > cycles + 100)
            return site.speed, site.request("GET", "/state"), site.state()

    speed, answer, state = site.while_it_runs(hang)
    assert answer.status == 200
    assert state["armed"]
    assert speed > 2.0


def test_the_values_are_those_of_the_service_state(site: Site) -> None:
    def press_and_compare(site: Site) -> tuple[Any, Any]:
        site.request("POST", "/stop", **{"X-Token": site.token()})
        site.until(lambda: site.state()["supervisor"] == "estop" and site.speed == 0.0)
        return site.request("GET", "/state").json, site.state()

    shown, state = site.while_it_runs(press_and_compare)
    rows = dict(shown["rows"])
    assert (shown["robot"], shown["code"]) == (state["robot"], state["fault_code"])
    assert shown["code"] == "TV880"
    assert state["fault"] in rows["FAULT"]
    assert "TV880 bus-stopped" in rows["FAULT"]
    assert "not armed: estop" in rows["driver"]
    assert rows["stopped by"] == ", ".join(state["stopped_by"])
    for battery, values in state["batteries"].items():
        assert rows[battery] == f"{100.0 * values['charge']:.0f} %"
    hours, minutes, seconds = map(int, rows["time since start"].split(":"))
    assert 0.0 <= state["uptime"] - (3600 * hours + 60 * minutes + seconds) < 60.0
    for name, speed, angle in shown["wheels"]:
        joints = state["joints"][name]
        assert float(speed) == pytest.approx(joints["speed"], abs=0.006)
        assert float(angle) == pytest.approx(math.degrees(joints["angle"]), abs=0.006)
    assert len(shown["wheels"]) == 4


def test_without_a_driver_the_page_says_so(site: Site) -> None:
    site.session.driven.close()
    with status_page(site.listener, site.channel):
        assert "no driver" in site.request("GET", "/state").json["error"]
        answer = site.request("POST", "/stop", **{"X-Token": site.token()})
    assert answer.status == 503
    assert "no driver" in answer.text
