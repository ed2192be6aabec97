"""Runs that differ in their seed alone: what their folders are called, and their figures in one cell of a table."""

from collections.abc import Sequence
from statistics import fmean, stdev

METRICS = ("psnr", "ssim", "lpips")


def folder_name(title: str) -> str:
    """The title without what a path could not hold."""
    return "".join(letter if letter.isalnum() else "-" for letter in title)


def cell(values: Sequence[float | None], form: str, spread: bool = True) -> str:
    """The mean of the known values and, where there are several, their standard deviation; form: as of `str.format`."""
    known = [value for value in values if value is not None]
    if not known:
        return "-"
    mean = form.format(fmean(known))
    return f"{mean} ± {form.replace('+', '').format(stdev(known))}" if spread and len(known) > 1 else mean
