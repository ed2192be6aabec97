"""Training: a Collection and Settings become Gaussians and an AppearanceModel, in a checkpoint.

the loop         trainer, step, schedule, guards, held_out
what is decided  decisions, evidence, sightings
photos           sized_photos, transparency, background, jitter
losses           objective, photometric (_cpu, _cuda), mask_weights, mask_loss, regularisers, gauge, backward
Gaussians        initialisation, gaussians, densify, adam (_cuda)
networks         networks
on disk          run_folders, run_config, viewer_files, checkpoint, claim, mask_files
for the user     tell, interrupt, full_memory
"""
