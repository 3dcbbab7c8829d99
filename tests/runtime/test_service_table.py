"""A stop that several programs can set: who may release it."""

from __future__ import annotations

from thorvaldc.runtime.service_table import OwnedStop


def test_each_owner_releases_its_own_stop() -> None:
    stop = OwnedStop()
    assert not stop.engaged
    for owner in ("a", "b", "a"):
        stop.engage(owner)
    assert stop.owners == ("a", "b")
    assert "the stop was set by b; release it there, or with `force=true`" in stop.release("a")
    assert stop.engaged
    assert "the stop was set by b" in stop.release("c"), "not one of the owners"
    assert stop.release("b") == ""
    assert not stop.engaged


def test_force_releases_all_stops() -> None:
    stop = OwnedStop()
    stop.engage("a")
    stop.engage("b")
    assert stop.release("c", force=True) == ""
    assert not stop.engaged


def test_a_program_that_ends_keeps_its_stop() -> None:
    stop = OwnedStop()
    stop.engage("a")
    stop.engage("b")
    stop.note_end("a")
    stop.note_end("unknown")
    refusal = stop.release("b")
    assert refusal.startswith("the stop was set by a")
    assert "release it with `force=true`" in refusal, "nobody is there to release it"
    assert "a" in stop.release("a"), "a new program with the name is another one"
    assert stop.release("b", force=True) == ""
