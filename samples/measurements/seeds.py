"""Runs with several seeds: their folders, and the figures of all of them in one cell of a table."""

from collections.abc import Sequence
from statistics import fmean, stdev

METRICS = ("psnr", "ssim", "lpips")


def folder_name(title: str) -> str:
    """The title without characters that a path cannot hold."""
    return "".join(letter if letter.isalnum() else "-" for letter in title)


def results_of(runs: list[dict], protocol: str) -> list[dict]:
    """The results by one protocol. runs: of several seeds, each as of `finished.measured`."""
    return [run["results"][protocol] for run in runs]


def scores_of(results: list[dict], against: str, look: str, metric: str) -> list[float | None]:
    """A metric's mean over the photos, for each of the results; None where it was not measured."""
    return [result["means"].get(against, {}).get(look, {}).get(metric) for result in results]


def cell(values: Sequence[float | None], form: str, spread: bool = True) -> str:
    """The mean of the known values and, if there are several, their standard deviation; "-" if there are none.
    form: as of `str.format`."""
    known = [value for value in values if value is not None]
    if not known:
        return "-"
    mean = form.format(fmean(known))
    return f"{mean} ± {form.replace('+', '').format(stdev(known))}" if spread and len(known) > 1 else mean
