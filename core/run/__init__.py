"""What a run is, while it is trained and afterwards.

its folder        run_folders; claim, by a training; viewer_files; history, of the training
what made it      run_config: settings, scene and photos; decision, of what the photos decided
where it stands   checkpoint; run_state
its photos        sized_photo; background, what is behind everything
"""
