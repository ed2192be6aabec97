"""The Gaussians that are learnt: how they begin, move, grow in number and are removed."""
