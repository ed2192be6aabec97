"""The Gaussians that are learned: how they begin, move, grow in number and are removed."""
