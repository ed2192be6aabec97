"""Threads that keep cores awake: only where they serve, of the lowest class, and gone afterwards, come what may."""

import os
import threading
import time

import pytest

from core import awake

linux = pytest.mark.skipif(not hasattr(os, "SCHED_IDLE"), reason="SCHED_IDLE is Linux's")
NAME = "wegs-awake"


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """Two virtual cores, all for us, in a container without a limit."""
    monkeypatch.setattr(awake, "PROCESSOR", tmp_path / "cpuinfo")
    monkeypatch.setattr(awake, "CONTROL_GROUPS", tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    (tmp_path / "cpuinfo").write_text("flags : fpu sse2 hypervisor lahf_lm\n")
    return tmp_path


def watchers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == NAME]


def come_true(condition) -> bool:
    end = time.monotonic() + 20
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


@linux
def test_on_few_virtual_cores_of_our_own(machine):
    assert awake.worthwhile(2)
    assert not awake.worthwhile(1), "nobody waits for a thread"
    assert not awake.worthwhile(3), "more threads than cores"


@linux
def test_not_where_they_would_be_many(machine, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(16)))
    assert not awake.worthwhile(2) and not awake.worthwhile(16)


@linux
@pytest.mark.parametrize("flags", ["flags : fpu sse2\n", None])
def test_not_on_a_real_machine_and_not_where_nobody_tells(machine, flags):
    if flags is None:
        (machine / "cpuinfo").unlink()
    else:
        (machine / "cpuinfo").write_text(flags)
    assert not awake.worthwhile(2)


@linux
@pytest.mark.parametrize("limit, expected", [("max 100000", True), ("200000 100000", True), ("150000 100000", False)])
def test_not_in_a_container_that_is_allowed_less(machine, limit, expected):
    (machine / "cpu.max").write_text(limit + "\n")
    assert awake.worthwhile(2) == expected


@linux
@pytest.mark.parametrize("quota, expected", [(-1, True), (200000, True), (150000, False)])
def test_nor_under_the_first_version_of_control_groups(machine, quota, expected):
    (machine / "cpu").mkdir()
    (machine / "cpu" / "cpu.cfs_quota_us").write_text(f"{quota}\n")
    (machine / "cpu" / "cpu.cfs_period_us").write_text("100000\n")
    assert awake.worthwhile(2) == expected


@linux
def test_of_the_lowest_class_and_gone_after_a_failure(monkeypatch):
    monkeypatch.setattr(awake, "worthwhile", lambda wanted: True)
    monkeypatch.setattr(awake, "threads", lambda: 2)
    with pytest.raises(KeyError), awake.cores_awake():
        assert len(watchers()) == 2
        assert come_true(lambda: all(os.sched_getscheduler(t.native_id) == os.SCHED_IDLE for t in watchers()))
        raise KeyError
    assert come_true(lambda: not watchers())


def test_none_where_they_do_not_serve(monkeypatch):
    monkeypatch.setattr(awake, "worthwhile", lambda wanted: False)
    with awake.cores_awake():
        assert not watchers()
