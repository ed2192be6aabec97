"""What keeps cores awake: only where it serves, of the lowest class, and gone afterwards, come what may."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from core.system import awake

linux = pytest.mark.skipif(not hasattr(os, "SCHED_IDLE"), reason="SCHED_IDLE is Linux's")
ROOT = Path(__file__).parents[2]
KILLED = """
import os, signal, subprocess
from core.system import awake

awake.worthwhile, awake.threads = lambda wanted: True, lambda: 1
started = subprocess.Popen

def popen(*command, **ways):
    loop = started(*command, **ways)
    print(loop.pid, flush=True)
    return loop

subprocess.Popen = popen
with awake.cores_awake():
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """Two virtual cores, all for us, in a container without a limit."""
    monkeypatch.setattr(awake, "PROCESSOR", tmp_path / "cpuinfo")
    monkeypatch.setattr(awake, "CONTROL_GROUPS", tmp_path)
    monkeypatch.setattr(awake, "MEMBERSHIP", tmp_path / "membership")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    (tmp_path / "cpuinfo").write_text("flags : fpu sse2 hypervisor lahf_lm\n")
    return tmp_path


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
@pytest.mark.parametrize("group", ["user.slice/work.service", "user.slice", "."])
def test_not_in_a_control_group_that_is_allowed_less(machine, group):
    (machine / "membership").write_text("0::/user.slice/work.service\n")
    (machine / "user.slice" / "work.service").mkdir(parents=True)
    (machine / "user.slice" / "cpu.max").write_text("max 100000\n")
    assert awake.worthwhile(2)
    (machine / group / "cpu.max").write_text("150000 100000\n")
    assert not awake.worthwhile(2)


@linux
def test_not_in_a_group_of_the_first_version_that_is_allowed_less(machine):
    (machine / "membership").write_text("9:memory:/m\n4:cpu,cpuacct:/docker/ab\n")
    group = machine / "cpu" / "docker" / "ab"
    group.mkdir(parents=True)
    (group / "cpu.cfs_quota_us").write_text("150000\n")
    (group / "cpu.cfs_period_us").write_text("100000\n")
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
    begun = []

    def popen(*command, **ways):
        begun.append(started(*command, **ways))
        return begun[-1]

    started = subprocess.Popen
    monkeypatch.setattr(awake, "worthwhile", lambda wanted: True)
    monkeypatch.setattr(awake, "threads", lambda: 2)
    monkeypatch.setattr(subprocess, "Popen", popen)
    with pytest.raises(KeyError), awake.cores_awake():
        assert len(begun) == 2
        assert come_true(lambda: all(os.sched_getscheduler(loop.pid) == os.SCHED_IDLE for loop in begun))
        assert not any(os.getpgid(loop.pid) == os.getpgid(0) for loop in begun), "Ctrl-C is not for them"
        raise KeyError
    assert all(loop.returncode is not None for loop in begun)


@linux
def test_they_do_not_outlive_a_process_that_was_killed():
    process = subprocess.Popen([sys.executable, "-c", KILLED], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    said, _ = process.communicate(timeout=60)
    loop = Path("/proc") / said.strip()
    assert process.returncode == -signal.SIGKILL and loop.name.isdigit()
    assert come_true(lambda: not loop.exists())


def test_where_no_more_processes_are_allowed_the_work_is_done_all_the_same(monkeypatch):
    def refused(*_, **__):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(awake, "worthwhile", lambda wanted: True)
    monkeypatch.setattr(subprocess, "Popen", refused)
    with awake.cores_awake():
        done = True
    assert done


def test_none_where_they_do_not_serve(monkeypatch):
    monkeypatch.setattr(awake, "worthwhile", lambda wanted: False)
    monkeypatch.setattr(subprocess, "Popen", None)
    with awake.cores_awake():
        pass
