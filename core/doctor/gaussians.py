"""Checks of the Gaussians of one look: which are broken, wasted, misshapen or misplaced."""

import numpy as np
import torch

from core.doctor.finding import Finding, counting, part
from core.rasterizer.contract import ALPHA_MAX, ALPHA_MIN, LOG_SCALE_RANGE
from core.scene.frame import SceneFrame
from core.scene.harmonics import SH_0, coefficient_count
from core.scene.splats import QUATERNION_MIN_NORM2, Splats

NEEDLE = 10.0  # longest axis over the middle one
# Of all; a third do no harm where no photo was taken (core/TRIED.md, "Learning rates"), more was not measured.
NEEDLES_SHARE = 0.5
# Longest axis over the shortest. Above, a c - b^2 in float32 (half a step is 6e-8) is wrong by 1 %: 6e-8 * 400^2.
STIFF = 400.0
GIANT = 0.5  # longest axis, in radii of the scene
FAR = 3.0  # radii of the scene; giants farther away are a background
# Radii of the scene; with Gaussians farther away, a viewer that fits the whole file into its window shows a dot.
STRAY = 1000.0
WASTE = 0.02  # share of Gaussians that do nothing
COLOURS = (-0.5, 1.5)  # of the DC term; [0, 1] can be shown, and view dependence adds or subtracts something
BURNT_SHARE = 0.02
ROUNDED = 1e-4  # rounding error of logarithms that were converted into the scene's frame
SH_RANGE = 8.0  # a coefficient of 4 already changes a colour by more than 1


def examine_gaussians(splats: Splats, frame: SceneFrame, sky_count: int) -> list[Finding]:
    """Findings about Gaussians in the scene frame.
    sky_count: how many of the last ones are the dome, which is large and far on purpose."""
    total = len(splats)
    finite, turned = splats.finite_rows(), splats.quaternions.double().square().sum(dim=1) >= QUATERNION_MIN_NORM2
    findings = [
        _count("not finite", ~finite, "rows with NaN or Inf, which viewers drop, draw as garbage or crash on"),
        _count("zero quaternions", finite & ~turned, "rows without a rotation, which viewers draw in different ways"),
    ]
    good = finite & turned
    if not good.any():
        return [*findings, Finding("drawable", "0", "the file shows nothing", "Train or export it again.")]
    body = splats[good & (torch.arange(total) < total - sky_count)]
    if len(body):
        findings += [*_opacities(body), *_shapes(body), _sizes(body, frame), _extent(body, frame)]
    return [*findings, *_colours(splats[good])]


def _count(name: str, flags: torch.Tensor, meaning: str) -> Finding:
    advice = "Export the file again; `wegs bake` leaves them out."
    return counting(name, int(flags.sum()), len(flags), meaning, advice, "Remove those rows, or export the file again.")


def _unconverted(values: torch.Tensor, share: float = 1.0) -> bool:
    """Whether numbers that 3DGS stores as logits, logarithms or SH look unconverted:
    none is below 0, and this share of them is at most 1."""
    low, most, high = np.quantile(values.numpy(), [0.0, share, 1.0])
    return bool(-ROUNDED <= low < high and most <= 1 + ROUNDED)


def _opacities(splats: Splats) -> list[Finding]:
    logits = splats.logit_opacities.double()
    if _unconverted(logits):
        fix = "Write their logits, log(o / (1 - o)), as 3DGS does."
        return [
            Finding(
                "opacities", "all from 0 to 1", "stored as they are, so viewers draw them all between 0.5 and 0.73", fix
            )
        ]
    opacities = torch.sigmoid(logits)
    faint, full = int((opacities < ALPHA_MIN).sum()), int((opacities > ALPHA_MAX).sum())
    advice = "Train with a higher prune_opacity, which removes them." if faint > WASTE * len(splats) else ""
    return [
        counting("invisible", faint, len(splats), "opacity below 1/255: never drawn", advice, "Remove them."),
        counting(
            "saturated",
            full,
            len(splats),
            f"opacity above {ALPHA_MAX:.2f}: drawn as that, without a gradient; opaque surfaces are like this",
        ),
    ]


def _shapes(splats: Splats) -> list[Finding]:
    axes = np.sort(splats.log_scales.double().clamp(*LOG_SCALE_RANGE).numpy(), axis=1)
    ratios, stretches = np.exp(axes[:, 2] - axes[:, 0]), np.exp(axes[:, 2] - axes[:, 1])
    middle, high, most = np.quantile(ratios, [0.5, 0.99, 1.0])
    stiff, needles = int((ratios > STIFF).sum()), int((stretches > NEEDLE).sum())
    thicken = "Make their thinnest axis thicker, or take a viewer with a safe determinant."
    more = "Add photos from other sides, or train with a lower scale_rate."
    return [
        Finding(
            "axis ratios",
            f"longest to shortest {middle:.3g} (median), {high:.3g} (99 %), {most:.3g} (most)",
            f"condition numbers of covariances are the squares, up to {most**2:.3g}",
        ),
        counting(
            "stiff",
            stiff,
            len(splats),
            f"ratio above {STIFF:.0f}: viewers that form a c - b^2 in float32 draw them wrong from near",
            thicken if stiff > WASTE * len(splats) else "",
        ),
        counting(
            "needles",
            needles,
            len(splats),
            f"longest axis over {NEEDLE:.0f} times the middle one: spikes from new places, if most are like this",
            more if needles > NEEDLES_SHARE * len(splats) else "",
            "Add photos from other sides, or train with a lower learning rate of scales.",
        ),
    ]


def _sizes(splats: Splats, frame: SceneFrame) -> Finding:
    if _unconverted(splats.log_scales + np.log(frame.radius), 0.9):  # the rest may be a background
        fix = "Write their natural logarithms, as 3DGS does."
        return Finding(
            "scales",
            "none below 0, nearly all up to 1",
            "stored as they are, so viewers draw them all 1 to 3 units long",
            fix,
        )
    largest = splats.log_scales.amax(dim=1).exp()
    distances = splats.means.norm(dim=1)
    giants = largest > GIANT
    near = int((giants & (distances < FAR)).sum())
    beyond = int(giants.sum()) - near
    if not near + beyond:
        return Finding("giants", "none", "")
    figure = f"{part(near, len(splats))} in the scene, {part(beyond, len(splats))} beyond {FAR:.0f} radii"
    advice = "Train with a smaller largest_scale, which removes them." if near > WASTE * len(splats) else ""
    if near + beyond > len(splats) / 2:
        fix = "Check that they are natural logarithms, in the units of the centres, and export it again."
        return Finding("scales", figure, "longer than half the scene's radius, most of all: nothing but haze", fix)
    return Finding(
        "giants", figure, "longer than half the scene's radius: haze inside, background outside", advice, "Remove them."
    )


def _extent(splats: Splats, frame: SceneFrame) -> Finding:
    distances = splats.means.double().norm(dim=1).numpy()
    half, most, farthest = np.quantile(distances, [0.5, 0.97, 1.0]) * frame.radius
    x, y, z = frame.centre
    figure = f"50, 97, 100 % within {half:.3g}, {most:.3g}, {farthest:.3g} units of ({x:.6g}, {y:.6g}, {z:.6g})"
    stray = int((distances > STRAY).sum())
    remove = f"the {stray:,} beyond {STRAY * frame.radius:.3g} units."
    advice = f"Train with a smaller reach above 0, which removes {remove}" if stray else ""
    return Finding("extent", figure, "the centres, which viewers fit into their window", advice, f"Remove {remove}")


def _colours(splats: Splats) -> list[Finding]:
    if _unconverted(splats.sh[:, 0]):
        fix = "Write (c - 0.5) / 0.2821 for a colour c, as 3DGS does."
        return [
            Finding(
                "colours",
                "f_dc all from 0 to 1",
                "stored as they are, so viewers draw them all between 0.5 and 0.78",
                fix,
            )
        ]
    dc = (0.5 + SH_0 * splats.sh[:, 0].double()).numpy()
    low, high = np.quantile(dc, [0.01, 0.99])
    burnt = int(((dc < COLOURS[0]) | (dc > COLOURS[1])).any(axis=1).sum())
    used = splats.degree
    while used and not splats.sh[:, coefficient_count(used - 1) : coefficient_count(used)].any():
        used -= 1
    higher = splats.sh[:, 1:].abs().flatten(1)
    wild = int((higher > SH_RANGE).any(dim=1).sum())
    most = float(higher.max()) if higher.numel() else 0.0
    return [
        Finding(
            "colours",
            f"{low:z.2f} to {high:z.2f} (1 to 99 %); {part(burnt, len(dc))} beyond {COLOURS[0]} to {COLOURS[1]}",
            "without view dependence; what lies outside 0 to 1 is clipped",
            "Train with a lower sh_rate." if burnt > BURNT_SHARE * len(dc) else "",
            "Train with a lower learning rate of colours.",
        ),
        Finding(
            "harmonics",
            f"degree {used} used of {splats.degree}, coefficients up to {most:.3g}",
            f"how colours follow the view; {part(wild, len(dc))} above {SH_RANGE:g} flash as one moves",
            "Train with a lower sh_rate, or a lower --sh-degree." if wild else "",
            "Train with a lower learning rate of colours, or a lower SH degree.",
        ),
    ]
