"""What numbers become that are left open (`auto`), and the measurements that chose them.

Imports no torch, like core.config, whose settings these are.
"""

AUTO_PIXELS = {"cpu": 200_000, "cuda": 1_920_000}  # mean pixels per photo at -r auto: what a step can afford there
# However few the photos. For 6 to 16 of them, 1,200 steps and 20,000 Gaussians (`quick`) score as much zero-shot, but
# are less sharp (core/TRIED.md, "Few photos").
LEAST = {"steps": 3000, "max_gaussians": 40_000}
# 6,000 steps and 40,000 Gaussians instead of 3,000 and 30,000 gained, on held-out training photos of plaza (43 left)
# and Liberty (65 left), 0.0 / 0.3 dB zero-shot, 0.2 / 0.5 refined and 0.03 / 0.02 LPIPS. 9,000 and 60,000 gained only
# 0.02 / 0.00 LPIPS more and lost 0.2 / 0.8 dB zero-shot: the encoder then knows its photos by heart, as where
# Sacre-Coeur's 8 are seen 750 times each instead of 375 (- 0.2 / - 0.6 dB).
STEPS_PER_PHOTO, STEPS_FOR_FEW = 120, 6000
# 76 steps and 506 Gaussians per photo instead of 38 and 253, with twice the embedding and the transfer's width, gained
# on held-out ones of 158 photos of plaza 0.2 dB zero-shot, 0.7 refined and 0.04 / 0.06 LPIPS. 592 photos gain 0 / 0.5 /
# 0.04 over a third of both (README). 2.6 times as many Gaussians per pixel gained nothing on 65 photos of Liberty at
# full size.
STEPS_PER_PHOTO_OF_MANY, GAUSSIANS_PER_PHOTO, PIXELS_PER_GAUSSIAN = 70, 465, 500
# Where there are looks, they are learned first: otherwise dark or bright Gaussians before single cameras explain the
# light.
WITH_LOOKS = {"geometry_from": 0.1, "densify_from": 0.12, "prune_contribution": 0.2}
WITHOUT_LOOKS = {"geometry_from": 0.0, "densify_from": 0.02, "prune_contribution": 0.0}
# Gaussians begin as large as SfM points are apart; to become as small as they should be in fewer steps, they have to
# shrink faster (core/TRIED.md, "Learning rates").
SCALE_TRAVEL, SCALE_RATES = 48.0, (8e-3, 2.4e-2)


def budget(photos: int, pixels: int) -> dict[str, int]:
    """Steps and max_gaussians for so many photos, of so many pixels together."""
    steps = max(min(STEPS_PER_PHOTO * photos, STEPS_FOR_FEW), STEPS_PER_PHOTO_OF_MANY * photos)
    wanted = {"steps": steps, "max_gaussians": max(pixels // PIXELS_PER_GAUSSIAN, GAUSSIANS_PER_PHOTO * photos)}
    return {name: max(least, wanted[name]) for name, least in LEAST.items()}


def scale_rate_for(steps: int) -> float:
    """The learning rate of log scales in a run of so many steps."""
    least, most = SCALE_RATES
    return min(max(SCALE_TRAVEL / steps, least), most)
