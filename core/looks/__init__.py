"""A trained run and its looks: found by a photo or a name, refined, saved, pruned and written for viewers;
its held-out photos, for evaluation."""
