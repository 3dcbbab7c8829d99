"""The control channel: requests, refusals, and clients that misbehave."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import stat
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.runtime.control_channel import (
    LONGEST_LINE,
    LONGEST_POLL,
    MOST_CLIENTS,
    ControlClient,
    ControlServer,
    control_path,
)
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.pace import SimulatedTime
from thorvaldc.runtime.service_table import LOCAL, Caller, Service, ServiceError, Services
from thorvaldc.simulation.bus.bus_server import BusServer
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import Wire as CanWire
from thorvaldc.simulation.physics.sim_base import SimBase

PLAIN = make_robot(FOUR_STEERED)
ROBOT = replace(
    PLAIN, twist_sources=tuple(replace(s, first_command="any") for s in PLAIN.twist_sources)
)
"""A robot whose sources may begin with a motion, so that each test needs one request."""


class RunningDriver:
    """A driver with a control channel; the test runs its cycles."""

    def __init__(self) -> None:
        self.clock = SimulatedTime()
        base = SimBase(ROBOT)
        self.robot = DrivenRobot(ROBOT, base, self.clock, arming="automatic", channel="r")
        self.driver, self.multiplexer = self.robot.driver, self.robot.multiplexer
        self.services = self.robot.services
        self.robot.arm()
        assert self.robot.channel is not None
        self.server = self.robot.channel

    @property
    def now(self) -> float:
        return self.clock.now

    @now.setter
    def now(self, now: float) -> None:
        self.clock.now = now

    def cycles(self, count: int = 1) -> None:
        for _ in range(count):
            self.now += 0.02
            self.robot.cycle(self.now)


@pytest.fixture
def running(monkeypatch: pytest.MonkeyPatch) -> Iterator[RunningDriver]:
    with tempfile.TemporaryDirectory(prefix="tv") as folder:  # a socket's path is short
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        running = RunningDriver()
        yield running
        running.server.close()


class RawClient:
    """A client that sends raw bytes."""

    def __init__(self, running: RunningDriver) -> None:
        self.running = running
        self.stream = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.stream.connect(str(running.server.path))
        self.stream.settimeout(1.0)
        self.unread = b""

    def send(self, *lines: bytes) -> None:
        self.stream.sendall(b"".join(lines))

    def answer(self) -> dict[str, Any]:
        for _ in range(100):
            self.running.cycles()
            if b"\n" in self.unread or select_ready(self.stream):
                break
        while b"\n" not in self.unread:
            data = self.stream.recv(1 << 16)
            assert data, "the server has closed the connection"
            self.unread += data
        line, _, self.unread = self.unread.partition(b"\n")
        answer = json.loads(line)
        assert isinstance(answer, dict)
        return answer

    def ask(self, line: bytes) -> dict[str, Any]:
        self.send(line + b"\n")
        return self.answer()


def select_ready(stream: socket.socket) -> bool:
    import select

    return bool(select.select([stream], [], [], 0.0)[0])


@pytest.fixture
def client(running: RunningDriver) -> Iterator[RawClient]:
    client = RawClient(running)
    yield client
    client.stream.close()


# -- requests ----------------------------------------------------------------------------


def test_a_client_drives_and_reads_the_state(running: RunningDriver, client: RawClient) -> None:
    twist = b'{"call": "twist", "arguments": {"source": "auto_nav", "vx": 0.4}, "id": 7}'
    assert client.ask(twist) == {"ok": True, "result": None, "id": 7}
    running.cycles(23)
    state = client.ask(b'{"call": "state"}')["result"]
    assert state["source"] == "auto_nav"
    assert state["in_force"]["vx"] == pytest.approx(0.4)
    assert state["mode"] == "driving"
    assert state["pose"]["x"] > 0.0


TWIST = b'{"call": "twist", "arguments": {"source": "auto_nav", "vx": 0.4}}'


def test_the_twist_of_a_client_that_ends_is_void_at_once(
    running: RunningDriver, client: RawClient
) -> None:
    client.ask(TWIST)
    running.cycles(15)
    speed = running.driver.state.ramped.vx
    assert speed > 0.3
    client.send(b'{"call": "twist", "argum')  # the line is incomplete
    client.stream.close()
    running.cycles(1)
    assert running.multiplexer.select(running.now).source == ""
    assert running.driver.state.ramped.vx < speed
    running.cycles(23)
    assert running.driver.state.ramped.vx == 0.0


# -- requests that are too old -----------------------------------------------------------


def test_requests_that_waited_during_a_gap_do_not_count(
    running: RunningDriver, client: RawClient
) -> None:
    assert client.ask(TWIST)["ok"]
    client.send(TWIST + b"\n")
    running.now += 0.1  # the driver is late
    assert "may have waited for 120 ms" in client.answer()["error"]
    assert client.ask(TWIST)["ok"] is False  # a zero twist must come first
    zero = TWIST.replace(b"0.4", b"0.0")
    assert client.ask(zero)["ok"]
    assert client.ask(TWIST)["ok"]


def test_a_request_tells_when_it_was_sent(running: RunningDriver, client: RawClient) -> None:
    """A request that a client sends directly after a gap counts."""
    running.cycles()
    zero = b'{"call": "twist", "arguments": {"source": "auto_nav"}, "time": %f}\n'
    running.now += 0.1
    client.send(zero % running.now)
    assert client.answer() == {"ok": True, "result": None}
    client.send(zero % (running.now - 0.2))
    assert "may have waited for 220 ms" in client.answer()["error"]
    client.send(zero % (running.now + 9.0))
    assert "the driver's clock shows" in client.answer()["error"]
    running.now += 0.1
    client.send(zero % (running.now - 0.09))
    assert "may have waited" in client.answer()["error"]


def test_a_flood_of_requests_grows_old(running: RunningDriver, client: RawClient) -> None:
    """The requests of later cycles were sent in the first cycle."""
    SlowServices(running, LONGEST_POLL / 64)
    client.send((TWIST + b"\n") * 1000)
    answers = [client.answer()["ok"] for _ in range(1000)]
    assert answers[:100] == [True] * 100
    assert answers[400:] == [False] * 600


def test_a_stop_counts_however_old_it_is_and_its_release_does_not(
    running: RunningDriver, client: RawClient
) -> None:
    assert client.ask(b'{"call": "lock", "arguments": {"name": "auto_nav_pause"}}')["ok"]
    client.send(b'{"call": "safety_stop"}\n{"call": "release_safety_stop"}\n')
    client.send(b'{"call": "lock", "arguments": {"name": "auto_nav_pause", "locked": false}}\n')
    running.now += 0.7
    assert client.answer()["ok"]
    assert "may have waited" in client.answer()["error"]
    assert "may have waited" in client.answer()["error"]
    assert running.multiplexer.active_locks(running.now) == ("safety_stop", "auto_nav_pause")


def test_a_stop_of_a_client_that_has_ended_counts_and_its_twist_does_not(
    running: RunningDriver, client: RawClient
) -> None:
    limit = running.driver.settings.max_linear_velocity
    client.send(TWIST + b"\n")
    client.send(b'{"call": "safety_stop"}\n')
    client.send(b'{"call": "set_drive_parameters", "arguments": {"max_linear_velocity": 0.3}}\n')
    client.stream.close()
    running.cycles(3)
    assert running.driver.state.commanded_twist.vx == 0.0
    assert running.driver.settings.max_linear_velocity == limit
    assert running.multiplexer.active_locks(running.now) == ("safety_stop",)


# -- sources and stops belong to their connections ---------------------------------------


def test_a_source_is_bound_to_its_connection(running: RunningDriver, client: RawClient) -> None:
    other = RawClient(running)
    assert client.ask(TWIST)["ok"]
    refusal = other.ask(TWIST)["error"]
    assert refusal.startswith("`auto_nav` is published by connection 1")
    owners = client.ask(b'{"call": "state"}')["result"]["owners"]
    assert owners["auto_nav"].startswith("connection 1")
    running.cycles(30)  # the time-out of the source
    assert other.ask(TWIST)["ok"]
    assert not client.ask(TWIST)["ok"]
    other.stream.close()
    running.cycles(2)
    assert client.ask(TWIST)["ok"]


@pytest.mark.parametrize(
    ("stop", "release"),
    [
        (b'{"call": "safety_stop"}', b'{"call": "release_safety_stop", "arguments": {%s}}'),
        (
            b'{"call": "lock", "arguments": {"name": "safety_stop"}}',
            b'{"call": "lock", "arguments": {"name": "safety_stop", "locked": false, %s}}',
        ),
    ],
)
def test_a_stop_is_released_by_its_connection_or_by_force(
    running: RunningDriver, client: RawClient, stop: bytes, release: bytes
) -> None:
    def locks() -> tuple[str, ...]:
        return running.multiplexer.active_locks(running.now)

    plain, force = release % b'"force": false', release % b'"force": true'
    other = RawClient(running)
    assert client.ask(stop)["ok"]
    assert "connection 1" in other.ask(plain)["error"]
    assert locks() == ("safety_stop",)
    assert other.ask(stop)["ok"]
    assert "connection 2" in client.ask(plain)["result"]  # released here, not there
    assert "connection 2" in client.ask(plain)["error"]
    other.stream.close()
    running.cycles(3)
    assert locks() == ("safety_stop",)
    assert client.ask(force)["ok"]
    assert locks() == ()


def test_a_client_that_does_not_read_its_answers(running: RunningDriver, client: RawClient) -> None:
    client.send(b'{"call": "description"}\n' * 3)
    running.cycles()
    client.send(b'{"call": "description"}\n')
    client.stream.close()  # the server then reads "connection reset"
    running.cycles(3)
    second = RawClient(running)
    assert second.ask(b'{"call": "state"}')["ok"]
    second.stream.close()


def test_the_safety_stop_remains_until_its_release(
    running: RunningDriver, client: RawClient
) -> None:
    twist = b'{"call": "twist", "arguments": {"source": "teleop_joy", "vx": 0.4}}'
    assert client.ask(b'{"call": "safety-stop"}')["ok"]
    client.ask(twist)
    running.cycles(5)
    assert running.driver.state.ramped.vx == 0.0
    assert client.ask(b'{"call": "state"}')["result"]["locks"] == ["safety_stop"]
    assert client.ask(b'{"call": "release_safety_stop"}')["ok"]
    client.ask(twist)
    running.cycles(5)
    assert running.driver.state.ramped.vx == 0.0  # the stop has disarmed the robot
    assert client.ask(b'{"call": "twist", "arguments": {"source": "teleop_joy"}}')["ok"]
    running.cycles(1)
    client.ask(twist)
    running.cycles(5)
    assert running.driver.state.ramped.vx > 0.0


def test_parameters_and_odometry(running: RunningDriver, client: RawClient) -> None:
    call = b'{"call": "set_drive_parameters", "arguments": %s}'
    assert client.ask(call % b'{"max_linear_velocity": 0.3, "radii": {"w0": 0.19}}')["ok"]
    running.cycles(2)
    assert running.driver.settings.max_linear_velocity == 0.3
    assert running.driver.parameters.radii[0] == 0.19
    refusals = {
        b"{}": "needs `set`, `radii` or a limit",
        b'{"set": "rail"}': "has no parameter set `rail`",
        b'{"max_linear_velocity": -1}': "must be positive",
        b'{"radii": {"w9": 0.2}}': "no wheel `w9`",
        b'{"set": "", "radii": {"w0": 0.2}}': "`set` cannot be combined",
    }
    for arguments, reason in refusals.items():
        answer = client.ask(call % arguments)
        assert not answer["ok"]
        assert reason in answer["error"], answer
    client.ask(b'{"call": "twist", "arguments": {"source": "auto_nav", "vx": 0.4}}')
    running.cycles(20)
    assert running.driver.state.pose.x > 0.0
    assert client.ask(b'{"call": "reset_odometry"}')["ok"]
    assert running.driver.state.pose.x < 0.02


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"state", "the request is not JSON"),
        (b"[1]", "the request is not a mapping"),
        (b"\xff\xfe", "the request is not JSON"),
        (b"[" * 20000, "the request is not JSON"),
        (b"{}", "names no service"),
        (b'{"call": 5}', "names no service"),
        (b'{"call": "stat"}', "did you mean `state`?"),
        (b'{"call": "state", "arguments": []}', "is not a mapping"),
        (b'{"call": "state", "args": {}}', "a request has no key `args`"),
        (b'{"call": "state", "arguments": {"a": 1}}', "has no argument `a`"),
        (b'{"call": "twist"}', "needs the argument `source`"),
        (b'{"call": "twist", "arguments": {"source": 1}}', "`source` is 1; it must be text"),
        (b'{"call": "twist", "arguments": {"source": "x"}}', "no source of twists `x`"),
        (b'{"call": "twist", "arguments": {"source": "auto_nav", "vx": NaN}}', "must be finite"),
        (b'{"call": "twist", "arguments": {"source": "auto_nav", "vx": 1e400}}', "must be finite"),
        (b'{"call": "twist", "arguments": {"source": "auto_nav", "vx": 1e12}}', "too large"),
        (
            b'{"call": "twist", "arguments": {"source": "auto_nav", "vx": true}}',
            "it must be a number",
        ),
        (b'{"call": "lock", "arguments": {"name": "x"}}', "there is no lock `x`"),
    ],
)
def test_a_refusal_is_one_line(client: RawClient, line: bytes, reason: str) -> None:
    answer = client.ask(line)
    assert answer["ok"] is False
    assert reason in answer["error"]
    assert "\n" not in answer["error"]
    assert client.ask(b'{"call": "state"}')["ok"]  # the connection still works


def test_the_connection_of_an_endless_line_is_closed(
    running: RunningDriver, client: RawClient
) -> None:
    piece = b"x" * LONGEST_LINE
    client.send(piece)
    running.cycles()
    client.send(piece)
    answer = client.answer()
    assert "longer than" in answer["error"]
    running.cycles(3)
    assert client.stream.recv(1) == b""


def test_a_flood_of_requests_does_not_delay_the_cycle(
    running: RunningDriver, client: RawClient
) -> None:
    """Surplus requests wait for later cycles."""
    client.send(b'{"call": "description"}\n' * 1000)
    running.cycles()
    second = RawClient(running)
    assert second.ask(b'{"call": "state"}')["ok"]
    second.stream.close()
    for _ in range(1000):
        assert client.answer()["ok"]


class SlowServices(Services):
    """The services of a driver on a slow computer, with the number of calls of each connection."""

    def __init__(self, running: RunningDriver, duration: float) -> None:
        super().__init__(running.services._services.values())
        self.calls: Counter[str] = Counter()
        self._duration = duration
        self.time = 0.0
        running.server.services = self
        running.server.real_time = lambda: self.time

    def call(self, name: str, arguments: Any, now: float, caller: Caller = LOCAL) -> Any:
        self.calls[caller.name] += 1
        self.time += self._duration
        return super().call(name, arguments, now, caller)


def test_clients_that_flood_together_do_not_delay_the_cycle(running: RunningDriver) -> None:
    """All clients share the time of a cycle, in turns, and a stop is answered in the next one."""
    services = SlowServices(running, LONGEST_POLL / 9.5)
    flooding = [RawClient(running) for _ in range(MOST_CLIENTS - 1)]
    guard = RawClient(running)
    running.cycles(MOST_CLIENTS)
    for client in flooding:
        client.send(b'{"call": "state"}\n' * 300)
    for cycle in range(10):
        services.calls.clear()
        if cycle == 5:
            guard.send(b'{"call": "safety_stop"}\n')
        running.cycles()
        assert services.calls.total() == 10, cycle
        assert max(services.calls.values()) == 1
        assert ("safety_stop" in running.multiplexer.active_locks(running.now)) is (cycle >= 5)
    services.calls.clear()
    running.cycles(31)
    assert services.calls.total() == 310
    assert max(services.calls.values()) - min(services.calls.values()) <= 1, "fair over cycles"
    for client in [*flooding, guard]:
        client.stream.close()


def test_clients_that_send_long_requests_do_not_delay_the_cycle(running: RunningDriver) -> None:
    services = SlowServices(running, 0.6 * LONGEST_POLL)
    clients = [RawClient(running) for _ in range(10)]
    running.cycles(10)
    request = b'{"call": "state", "arguments": {}, "id": "' + b"x" * (LONGEST_LINE // 2) + b'"}\n'
    for client in clients:
        client.send(request)
    for _ in range(5):
        services.calls.clear()
        running.cycles()
        assert services.calls.total() == 2
    for client in clients:
        assert client.answer()["ok"]
        client.stream.close()


def test_too_many_clients_are_refused(running: RunningDriver) -> None:
    clients = [RawClient(running) for _ in range(MOST_CLIENTS)]
    running.cycles(MOST_CLIENTS)
    surplus = RawClient(running)
    running.cycles()
    assert surplus.stream.recv(1) == b""
    assert clients[-1].ask(b'{"call": "state"}')["ok"]
    for client in [*clients, surplus]:
        client.stream.close()


def test_only_the_user_can_connect(running: RunningDriver) -> None:
    assert stat.S_IMODE(running.server.path.stat().st_mode) == 0o600


def test_a_name_can_be_used_again_after_its_driver_has_ended(running: RunningDriver) -> None:
    with pytest.raises(OSError, match="a driver already runs at"):
        ControlServer("r", running.services)
    running.server.close()
    assert not control_path("r").exists()
    # A driver that was killed leaves its socket behind.
    killed = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    killed.bind(str(control_path("r")))
    killed.close()
    server = ControlServer("r", running.services)
    server.close()


def test_a_file_of_the_user_is_not_removed(running: RunningDriver, tmp_path: Path) -> None:
    """A user may name the robot file instead of a channel."""
    with tempfile.TemporaryDirectory(prefix="tv") as folder:
        file = Path(folder, "robot.yaml")
        file.write_text("mine")
        with pytest.raises(OSError, match="is not a socket; it was not removed"):
            ControlServer(str(file), running.services)
        with pytest.raises(OSError, match="is not a socket; it was not removed"):
            BusServer(Timeline(), {str(file): CanWire(Timeline(), 500_000)})
        assert file.read_text() == "mine"


def test_a_name_with_a_slash_is_a_path(running: RunningDriver, tmp_path: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="tv") as folder:
        server = ControlServer(f"{folder}/x", running.services)
        assert os.listdir(folder) == ["x"]
        server.close()


# -- the client ---------------------------------------------------------------------------------


def test_a_client_calls_from_another_thread(running: RunningDriver) -> None:
    robots: list[Any] = []

    def call_services() -> None:
        client = ControlClient("r")
        robots.append(client.call("description")["robot"])
        with pytest.raises(ServiceError, match="no lock `x`"):
            client.call("lock", name="x")
        robots.append(client.call("state")["robot"])
        client.close()

    thread = threading.Thread(target=call_services)
    thread.start()
    while thread.is_alive():
        running.cycles()
        thread.join(0.001)
    assert robots == ["test_robot", "test_robot"]


def test_a_driver_that_does_not_run_or_has_ended(running: RunningDriver) -> None:
    with pytest.raises(OSError, match=r"no driver `.*` runs: start one with `thorvaldc run`"):
        ControlClient("x")
    client = ControlClient("r", answer_time=0.05)
    with pytest.raises(ConnectionError, match="does not answer"):
        client.call("state")
    running.server.poll(0.0)
    running.server.close()
    with pytest.raises(ConnectionError, match="has ended"):
        client.call("state")
    client.close()


# -- services -----------------------------------------------------------------------------------


def test_services_are_listed_with_their_arguments() -> None:
    def add(now: float, n: int) -> float:
        return n + now

    services = Services([Service("a", "Does a.", add)])
    listed = services.call("services", {}, 0.0)
    assert listed[0] == {
        "name": "a",
        "summary": "Does a.",
        "arguments": [{"name": "n", "kind": "integer", "required": True}],
    }
    assert services.call("a", {"n": 2}, 0.5) == 2.5
    with pytest.raises(ServiceError, match="it must be a whole number"):
        services.call("a", {"n": 2.0}, 0.0)


# -- random requests ---------------------------------------------------------------------------

TEXTS = st.text('aé\ud800\n"\\', max_size=6)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner),
    max_leaves=8,
)
NAMES = st.sampled_from(["twist", "lock", "state", "set_drive_parameters", "services", "source"])
REQUESTS = st.fixed_dictionaries(
    {},
    optional={
        "call": NAMES | VALUES,
        "arguments": st.dictionaries(
            st.sampled_from(["source", "vx", "name", "locked", "set", "radii"]), VALUES
        )
        | VALUES,
        "id": VALUES,
        "more": VALUES,
    },
)
LINES = st.binary(max_size=60).filter(lambda line: b"\n" not in line) | REQUESTS.map(
    lambda request: json.dumps(request).encode()
)


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(LINES)
@example(b'{"call": "twist", "arguments": {"\\n": null}}')
def test_every_line_has_one_answer(running: RunningDriver, line: bytes) -> None:
    client = RawClient(running)
    with contextlib.closing(client.stream):
        answer = client.ask(line)
        assert answer["ok"] in (True, False)
        if not answer["ok"]:
            assert answer["error"]
            assert "\n" not in answer["error"]
        assert client.unread == b""
    running.cycles()
