"""What a process is told before torch is loaded: with glibc, memory that was freed is at hand again,
or returned where gaps would grow; what the user set stays; who waits for the interpreter."""

import platform
import subprocess
import sys

import numpy as np
import pytest

from tests.programs import run_python

STEPS = """
import resource
import numpy as np

def page_faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        blocks = [np.ones(1 << 18, np.float32) for _ in range(20)]  # 20 MiB: 5,120 pages
        del blocks
    return (resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) / 20

page_faults()
before = page_faults()
from core.system.process import prepare
prepare()
page_faults()
print(before, page_faults())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc is told")
def test_freed_memory_is_not_asked_for_again():
    before, now = map(float, run_python(STEPS).stdout.split())
    assert before > 1000
    assert now < 10


@pytest.mark.parametrize("given", [None, "active"])
def test_threads_wait_without_spinning_unless_the_user_wants_it(given):
    program = "import os; from core.system.process import prepare; prepare(); print(os.environ['OMP_WAIT_POLICY'])"
    assert run_python(program, OMP_WAIT_POLICY=given).stdout.strip() == (given or "passive")


def test_torch_is_not_loaded():
    program = "import sys; from core.system.process import prepare; prepare(); print('torch' in sys.modules)"
    assert run_python(program).stdout.strip() == "False"


WAITS = """
import threading, time

def wait_for_the_interpreter(times=30):
    start = time.perf_counter()
    for _ in range(times):
        time.sleep(0)  # gives it up and wants it back
    return (time.perf_counter() - start) / times

def compute():
    while not done:
        sum(range(1000))

done = False
threading.Thread(target=compute).start()
before = wait_for_the_interpreter()
from core.system.process import prepare
prepare()
now = wait_for_the_interpreter()
done = True
print(before, now)
"""


def test_a_thread_beside_python_code_does_not_wait_long_for_the_interpreter():
    # Where all cores are busy, the other thread may not run at all, and nobody waits for it; or both wait for a core.
    for _ in range(5):
        before, now = map(
            float,
            subprocess.run([sys.executable, "-c", WAITS], capture_output=True, text=True, check=True).stdout.split(),
        )
        if before > 4e-3 and now < before / 2:
            break
    assert before > 4e-3
    assert now < before / 2


GAPS = """
import sys
from contextlib import nullcontext
from core.system.process import blocks_apart, prepare, return_freed
prepare()
import numpy as np

def megabytes(what):
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith(what)) / 1024

reserved, used = megabytes("VmData"), megabytes("VmRSS")
kept = []
with blocks_apart() if sys.argv[1] == "apart" else nullcontext():
    for number in range(300):  # much fits into no gap, and what is kept of it leaves a third of the last one
        much = np.ones(300_000 + 4096 * number, np.uint8)
        kept.append(np.ones(200_000 + 2048 * number, np.uint8))
        del much
own = sum(array.nbytes for array in kept) / 2**20
print(own, megabytes("VmData") - reserved - own, megabytes("VmRSS") - used - own)
return_freed()
print(megabytes("VmRSS") - used - own)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc is told")
def test_what_is_left_of_much_lies_without_gaps_apart_and_gaps_in_the_heap_are_returned():
    def gaps(where):
        own, *rest = map(float, run_python(GAPS, where).stdout.split())
        return np.array(rest) / own

    (reserved, used, returned), apart = gaps("heap"), gaps("apart")
    assert reserved > 0.2 and used > 0.2 and returned < 0.05
    assert (apart < 0.05).all()
