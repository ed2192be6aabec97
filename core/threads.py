"""Work in blocks on a few Python threads; the kernels release the GIL.

Blocks are cut by size, never by the number of threads, so results do not depend on it.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import torch


@lru_cache(maxsize=4)
def pool(threads: int) -> ThreadPoolExecutor:
    """The process-wide pool for this number of threads."""
    return ThreadPoolExecutor(threads, thread_name_prefix="wegs")


def in_parallel(work: Callable[[int, int], None], total: int, block: int) -> None:
    """Call work(begin, end) for every block of range(total) on torch.get_num_threads() threads; wait for all."""
    threads = torch.get_num_threads()
    spans = [(begin, min(begin + block, total)) for begin in range(0, total, block)]
    if threads == 1 or len(spans) <= 1:
        for begin, end in spans:
            work(begin, end)
        return
    for future in [pool(threads).submit(work, begin, end) for begin, end in spans]:
        future.result()
