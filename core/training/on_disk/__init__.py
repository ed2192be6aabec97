"""A run on disk: its folder, settings, checkpoints, and files for viewers and for the user."""
