"""A trained run and its looks: what a word or a photo stands for, refined, kept, trimmed, and written for viewers; its held-out photos, for evaluation."""
