"""Tables of runs with several seeds: the runs' folders, and the figures of all seeds in one cell."""

from collections.abc import Sequence
from statistics import fmean, stdev

METRICS = ("psnr", "ssim", "lpips")


def folder_name(title: str) -> str:
    """The title without characters that a path cannot hold."""
    return "".join(letter if letter.isalnum() else "-" for letter in title)


def cell(values: Sequence[float | None], form: str, spread: bool = True) -> str:
    """The mean of the known values and, where there are several, their standard deviation; form: as of `str.format`."""
    known = [value for value in values if value is not None]
    if not known:
        return "-"
    mean = form.format(fmean(known))
    return f"{mean} ± {form.replace('+', '').format(stdev(known))}" if spread and len(known) > 1 else mean
