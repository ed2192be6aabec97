"""As many threads as cores that may be used, in a container, too."""

import os

import pytest

from core.system import control_groups, cores
from tests.programs import run_python

QUOTA_2 = "cpu.max"  # the files of version 2, and of version 1: controllers are mounted together or linked
QUOTA_1, QUOTA_1_LINKED = "cpu,cpuacct/job/cpu.cfs_quota_us", "cpu/job/cpu.cfs_quota_us"
OF_PROCESS = {
    QUOTA_2: "0::/\n",
    QUOTA_1: "4:memory:/\n3:cpu,cpuacct:/job/step\n1:cpuset:/\n",
    QUOTA_1_LINKED: "3:cpuacct,cpu:/job/step\n",
}


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system has no affinity")
def test_only_the_cores_that_the_process_may_use_count():
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(before)})
        assert cores.cores() == 1
    finally:
        os.sched_setaffinity(0, before)


@pytest.fixture(params=list(OF_PROCESS))
def set_quota(request, tmp_path, monkeypatch):
    """Writes a quota, or that there is none, into a control group of the process."""
    monkeypatch.setattr(control_groups, "GROUPS", tmp_path)
    monkeypatch.setattr(control_groups, "OF_PROCESS", tmp_path / "cgroup")
    file = tmp_path / request.param
    file.parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / "cgroup").write_text(OF_PROCESS[request.param])
    if request.param == QUOTA_2:
        return lambda quota: file.write_text(f"{'max' if quota is None else quota} 100000\n")
    file.with_name("cpu.cfs_period_us").write_text("100000\n")
    return lambda quota: file.write_text(f"{-1 if quota is None else quota}\n")


@pytest.mark.parametrize("quota, allowed", [(50_000, 1), (300_000, 3), (250_000, 3), (900_000, 8)])
def test_no_more_cores_than_a_container_allows(set_quota, monkeypatch, quota, allowed):
    monkeypatch.setattr(cores, "scheduled", lambda: 8)
    assert cores.cores() == 8
    set_quota(quota)
    assert cores.cores() == allowed


def test_a_container_without_a_quota_allows_all(set_quota, monkeypatch):
    monkeypatch.setattr(cores, "scheduled", lambda: 8)
    for quota, allowed in ((100_000, 1), (None, 8)):
        set_quota(quota)
        assert cores.cores() == allowed


@pytest.mark.parametrize("period", [0, -1, "x", ""])
@pytest.mark.parametrize("line", ["", "0::/\n", "\n", "no colon\n", "0:\n", "0::/\udcff\n", "::\n"])
def test_files_that_say_nothing_sensible_limit_nothing(tmp_path, monkeypatch, line, period):
    monkeypatch.setattr(control_groups, "GROUPS", tmp_path)
    monkeypatch.setattr(control_groups, "OF_PROCESS", tmp_path / "cgroup")
    (tmp_path / "cgroup").write_text(line, errors="surrogateescape")
    (tmp_path / "cpu.max").write_text(f"100000 {period}\n")
    assert cores.cores() == cores.scheduled() and list(control_groups.memory_limits()) == []


@pytest.mark.parametrize("given, threads", [(None, 1), ("2", 2)])
def test_torch_takes_as_many_threads_as_that_unless_the_user_wants_others(given, threads):
    program = (
        "from core.system import process; process.cores, process.scheduled = lambda: 1, lambda: 2; "
        "process.prepare(); import torch; print(torch.get_num_threads())"
    )
    assert run_python(program, OMP_NUM_THREADS=given).stdout.strip() == str(threads)
