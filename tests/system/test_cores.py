"""As many threads as cores that may be used, in a container, too."""

import os

import pytest

from core.system import control_groups, cores
from tests.programs import run_python

QUOTA_2, QUOTA_1 = "cpu.max", "cpu,cpuacct/job/cpu.cfs_quota_us"  # the files of versions 2 and 1
OF_PROCESS = {QUOTA_2: "0::/\n", QUOTA_1: "4:memory:/\n3:cpu,cpuacct:/job/step\n1:cpuset:/\n"}


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system has no affinity")
def test_only_the_cores_that_the_process_may_use_count():
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(before)})
        assert cores.cores() == 1
    finally:
        os.sched_setaffinity(0, before)


@pytest.fixture(params=[QUOTA_2, QUOTA_1])
def set_quota(request, tmp_path, monkeypatch):
    """Writes a quota into a control group of the process."""
    monkeypatch.setattr(control_groups, "GROUPS", tmp_path)
    monkeypatch.setattr(control_groups, "OF_PROCESS", tmp_path / "cgroup")
    file = tmp_path / request.param
    file.parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / "cgroup").write_text(OF_PROCESS[request.param])
    if request.param == QUOTA_1:
        file.with_name("cpu.cfs_period_us").write_text("100000\n")
    return lambda quota: file.write_text(f"{quota}\n" if request.param == QUOTA_1 else f"{quota} 100000\n")


@pytest.mark.parametrize("quota, allowed", [(50_000, 1), (300_000, 3), (250_000, 3), (900_000, 8)])
def test_no_more_cores_than_a_container_allows(set_quota, monkeypatch, quota, allowed):
    monkeypatch.setattr(cores, "scheduled", lambda: 8)
    assert cores.cores() == 8
    set_quota(quota)
    assert cores.cores() == allowed


@pytest.mark.parametrize("none", [-1, "max"])
def test_a_container_without_a_quota_allows_all(set_quota, monkeypatch, none):
    monkeypatch.setattr(cores, "scheduled", lambda: 8)
    set_quota(none)
    assert cores.cores() == 8


@pytest.mark.parametrize("given, threads", [(None, 1), ("2", 2)])
def test_torch_takes_as_many_threads_as_that_unless_the_user_wants_others(given, threads):
    program = (
        "from core.system import process; process.cores, process.scheduled = lambda: 1, lambda: 2; "
        "process.prepare(); import torch; print(torch.get_num_threads())"
    )
    assert run_python(program, OMP_NUM_THREADS=given).stdout.strip() == str(threads)
