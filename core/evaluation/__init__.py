"""Compares renders with photos: metrics, protocols, result files and picture sheets."""

PROTOCOLS = {
    "half": "embedding from the left half of a test photo (W - W//2 columns), figures from the right half",
    "full": "embedding and figures from the whole test photo",
}
# How the look of a render was read: key in results.json -> words.
WAYS = {"zero_shot": "zero-shot", "refined": "refined"}
