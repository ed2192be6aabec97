"""Compares renders with photos: metrics, protocols, result files and picture sheets."""

from typing import NamedTuple


class ResultFiles(NamedTuple):
    """What an evaluation leaves in a run."""

    means: str
    per_view: str
    sheet: str


PROTOCOLS = {
    "half": "embedding from the left half of a test photo (W - W//2 columns), figures from the right half",
    "full": "embedding and figures from the whole test photo",
}
RESULT_FILES = {
    "half": ResultFiles("results.json", "per_view.json", "sheet.png"),
    "full": ResultFiles("results_full.json", "per_view_full.json", "sheet_full.png"),
}
# How the look of a render was read: key in results.json -> words.
WAYS = {"zero_shot": "zero-shot", "refined": "refined"}
