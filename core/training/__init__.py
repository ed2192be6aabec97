"""Training: a Collection and Settings become Gaussians and an AppearanceModel, in a checkpoint.

the loop         trainer, step, step_cuda, step_context, density, schedule, guards, held_out, compiling
what is decided  decisions, evidence, sightings
photos           sized_photos, jitter
networks         network_updates, network_adam
for the user     tell, progress, interrupt, rescue, mask_files

losses/          what a step minimises: objective, and the losses it weighs
gaussians/       how they begin, move, grow in number and are removed
"""
