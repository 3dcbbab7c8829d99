"""A fixed sample of random missions, all scripts of earlier violations, and the tester itself."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.chaos.mission_generator import MissionGenerator
from tests.chaos.schedule import READY, ChaosEvent, Schedule
from tests.chaos.seed_runner import Outcome, in_copy, prepared_world, run_here, run_schedule
from tests.chaos.shrinker import Shrinker
from tests.chaos.taken_out import TAKEN_OUT
from tests.slow import mostly_slow, one_quick_of

PAGE = Path(__file__).parents[2] / "docs" / "chaos.md"
FOLDER = Path(__file__).parent / "scripts"
SCRIPTS = sorted(FOLDER.glob("*.json"))
GROUPS, SEEDS = 5, 8
"""The sample has ``SEEDS`` missions in each group, one robot per group."""


@pytest.mark.parametrize("script", one_quick_of(5, SCRIPTS), ids=lambda path: path.stem)
def test_no_script_violates_an_invariant(script: Path) -> None:
    outcome = run_schedule(Schedule.from_json(script.read_text(encoding="utf-8")))
    assert outcome.holds, f"{outcome.invariant} at {outcome.time:.2f} s: {outcome.text}"


@pytest.mark.parametrize("fix", one_quick_of(5, TAKEN_OUT))
def test_the_script_of_each_fix_violates_an_invariant_without_it(fix: str) -> None:
    script = Schedule.from_json((FOLDER / f"{fix}.json").read_text(encoding="utf-8"))

    def run_without() -> Outcome:
        TAKEN_OUT[fix]()
        return run_here(script)

    assert not in_copy(run_without).holds


@pytest.mark.slow
def test_the_table_names_a_seed_that_finds_the_absence_of_each_protection() -> None:
    """The rows of docs/chaos.md: within 400 seeds, and the mission holds with the protection."""
    rows = dict(re.findall(r"^\| `(\w+)` \|.*\| (\d+) \|$", PAGE.read_text(encoding="utf-8"), re.M))
    assert rows.keys() == TAKEN_OUT.keys()
    for fix, seed in rows.items():
        mission = MissionGenerator(int(seed)).schedule()

        def run_without(fix: str = fix, mission: Schedule = mission) -> Outcome:
            TAKEN_OUT[fix]()
            return run_here(
                mission, None if mission.start != READY else prepared_world(mission.robot)
            )

        assert int(seed) < 400
        assert run_schedule(mission).holds, fix
        assert not in_copy(run_without).holds, fix


@pytest.mark.parametrize("group", mostly_slow(range(GROUPS)))
def test_no_mission_of_the_sample_violates_an_invariant(group: int) -> None:
    violations = {}
    for seed in range(group, GROUPS * SEEDS, GROUPS):
        outcome = run_schedule(MissionGenerator(seed).schedule())
        if not outcome.holds:
            violations[seed] = f"{outcome.invariant} at {outcome.time:.2f} s: {outcome.text}"
    assert violations == {}


def test_a_schedule_runs_the_same_in_a_copy_and_in_this_process() -> None:
    schedule = MissionGenerator(2).schedule()
    assert run_here(schedule) == run_schedule(schedule)


def test_a_schedule_reads_back_equal() -> None:
    schedule = MissionGenerator(3).schedule()
    assert Schedule.from_json(schedule.to_json()) == schedule


def test_the_shrinker_keeps_only_what_violates_the_invariant() -> None:
    schedule = MissionGenerator(1).schedule()
    cause = ChaosEvent(1.234, "stall", {"seconds": 0.8, "sending": True})
    schedule = schedule.with_events((*schedule.events, cause))

    def fails(candidate: Schedule) -> bool:
        return any(e.act == "stall" and e.values["seconds"] > 0.3 for e in candidate.events)

    script = Shrinker(fails).shrink(schedule)
    assert len(script.events) == 1
    assert script.events[0].values == {"seconds": 0.4, "sending": False}
