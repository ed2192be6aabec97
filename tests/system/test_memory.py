"""The memory limit is kept, and its failure is the one line that the command line knows."""

import resource
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner

from core.data.sfm import features
from core.errors import BadSetting
from core.system import control_groups, memory
from core.training import sized_photos
from wegs_cli.main import wegs

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux limits a process")
ROOT = Path(__file__).parents[2]
TAKE = """
import sys
from core.system.memory import hold_to
hold_to(float(sys.argv[1]))
import torch
from wegs_cli.main import explain
kept = []
try:
    while True:
        kept.append(torch.ones(16 << 20, dtype=torch.uint8))
except Exception as problem:
    print(explain(problem))
status = open("/proc/self/status").read()
print([int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")][0])
"""


@pytest.fixture
def soft_limit_put_back():
    before = resource.getrlimit(resource.RLIMIT_DATA)
    yield
    resource.setrlimit(resource.RLIMIT_DATA, before)


def test_no_more_memory_is_taken_than_allowed():
    allowed = 1.5 if torch.version.cuda is None else 2.5  # GiB: the CUDA build claims much that it does not touch
    result = subprocess.run(
        [sys.executable, "-c", TAKE, str(allowed)], cwd=ROOT, capture_output=True, text=True, check=True
    )
    line, peak = result.stdout.splitlines()
    assert "not enough memory" in line
    assert 800_000 < int(peak) <= allowed * (1 << 20)  # kB: more than torch itself, and no more than allowed


def test_the_command_line_sets_the_limit(soft_limit_put_back):
    assert CliRunner().invoke(wegs, ["--memory", "50", "train", "--help"]).exit_code == 0
    assert memory.limit() == 50 * memory.GIB - memory.LIBRARIES
    assert CliRunner().invoke(wegs, ["--memory", "1.9", "train", "--help"]).exit_code == 2


def test_cached_targets_take_a_share_of_the_memory_that_there_is(monkeypatch):
    for gib, most in ((None, 3_000_000_000), (50, 3_000_000_000), (8, 2 * memory.GIB)):  # as the README says
        monkeypatch.setattr(memory, "room", lambda gib=gib: gib and gib * memory.GIB)
        assert sized_photos.SizedPhotos((), sized_photos.Sizes(1, 64))._most_bytes == most


@pytest.mark.parametrize("gib", [float("inf"), float("nan"), 16e9, 1e300, 0.2, 0, -1])
def test_limits_that_are_no_numbers_are_refused(gib):
    with pytest.raises(BadSetting, match="is no number of GiB"):
        memory.hold_to(gib)


def test_a_lower_limit_of_the_shell_is_reported(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (memory.GIB, 2 * memory.GIB))
    with pytest.raises(BadSetting, match="this shell allows 2.0 GiB"):
        memory.hold_to(4)


@pytest.mark.parametrize(
    "of_process, group",
    [
        ("0::/job/step\n", "job/memory.max"),  # of the job that the process is a step of
        ("0::/\n", "memory.max"),  # a container's
        ("4:memory:/docker/ab\n0::/\n", "memory/memory.limit_in_bytes"),  # one's that is told of its place outside
        ("4:memory:/job\n1:cpu:/\n", "memory/job/memory.limit_in_bytes"),
    ],
)
def test_room_is_that_of_the_machine_the_control_group_or_the_limit(
    soft_limit_put_back, tmp_path, monkeypatch, of_process, group
):
    monkeypatch.setattr(memory.os, "sysconf", {"SC_PHYS_PAGES": 1 << 21, "SC_PAGE_SIZE": 1 << 12}.__getitem__)
    monkeypatch.setattr(control_groups, "GROUPS", tmp_path)
    monkeypatch.setattr(control_groups, "OF_PROCESS", tmp_path / "none")
    assert memory.room() == 8 * memory.GIB
    monkeypatch.setattr(control_groups, "OF_PROCESS", tmp_path / "cgroup")
    (tmp_path / "cgroup").write_text(of_process)
    (tmp_path / group).parent.mkdir(parents=True, exist_ok=True)
    for written, room in (("max", 8), (1 << 63, 8), (4 * memory.GIB, 4)):
        (tmp_path / group).write_text(f"{written}\n")
        assert memory.room() == room * memory.GIB
    memory.hold_to(3)
    assert memory.room() == memory.limit() < 3 * memory.GIB


def test_features_are_found_and_matched_on_as_many_threads_as_fit(monkeypatch):
    monkeypatch.setattr(features, "cores", lambda: 16)
    for gib, fitting in ((None, 16), (1, 1), (2, 1), (4, 3), (50, 16)):
        monkeypatch.setattr(features.memory, "room", lambda gib=gib: gib and gib * memory.GIB)
        assert features.threads_within_room() == fitting
