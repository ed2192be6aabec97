"""Renders against photos: metrics, protocols, result files and picture sheets."""

PROTOCOLS = {
    "half": "embedding from the left half of a test photo (W - W//2 columns), figures from the right half",
    "full": "embedding and figures from the whole test photo",
}
# Whose look a render shows, as in the keys of results.json and in words.
LOOKS = {"zero_shot": "zero-shot", "refined": "refined"}
