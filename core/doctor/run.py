"""Checks of a run: its Gaussians in the neutral look, its looks, its masks, and how its training went."""

import math
from dataclasses import fields
from pathlib import Path

import torch

from core.config import Settings
from core.data.collection import spread_over
from core.data.photos.file import named_with_fault
from core.doctor import views
from core.doctor.finding import Finding, counting
from core.doctor.gaussians import examine_gaussians
from core.doctor.scene import odd_focal_lengths, placed_photos
from core.errors import BadInput, command
from core.export.ply import BYTES_PER_GAUSSIAN
from core.looks.trained import TrainedRun, bake, load_run, neutral_look
from core.report import Report
from core.run import checkpoint, history, run_folders
from core.training import schedule
from core.training.gaussians import densify
from core.training.losses.mask_weights import LEAST_STATIC
from core.words import counted

MOST_PHOTOS = 64  # whose looks are checked, evenly spread
NEAR_BOUND = 0.95  # of the residual's bound: beyond, the transfer has hardly any gradient
AT_BOUND_SHARE = 0.01
SAME_LOOK = 0.007  # spread of DC residuals; times SH_0 = 0.28, this is half an 8-bit step of colour
FELL_DB = 0.5  # by how much held-out quality may fall below its best
OFTEN = 0.01  # share of steps that were skipped


def examine_run(folder: Path, report: Report) -> list[Finding]:
    """Findings about the newest checkpoint of a run. BadInput if it has none, or none that can be read."""
    trained = load_run(folder, on_gpu=False)
    sky_count, frame = trained.sky_count, trained.collection.frame
    neutral = bake(trained, neutral_look(trained))
    size = f"{counted(len(neutral), 'Gaussian')} ({sky_count:,} of them sky) of SH degree {neutral.degree}"
    findings = [
        Finding(
            "file",
            size,
            f"{len(neutral) * BYTES_PER_GAUSSIAN / 1e6:.1f} MB per look as .ply",
            "" if len(neutral) > sky_count else densify.ALL_GONE,
        ),
        *_progress(trained),
        _settings(trained.settings),
        *placed_photos(trained.collection.root),
        odd_focal_lengths(trained.collection.photos),
    ]
    findings += examine_gaussians(neutral, frame, sky_count)
    photos = trained.collection.split("train")
    cameras = [trained.camera(photo) for photo in photos]
    centres = views.centres_of(neutral, sky_count)
    if len(centres):
        findings.append(views.float32_error(frame.for_files(), centres, cameras))
    findings.append(views.never_seen(neutral, cameras, sky_count, report))
    return [*findings, *_looks(trained, report)]


def _progress(trained: TrainedRun) -> list[Finding]:
    """How far the run got, how many steps were skipped, and how quality went."""
    steps, wanted = trained.step, trained.settings.steps
    advice, meaning = "", "what was asked for"
    if run_folders.is_at_work(trained.folder):
        meaning += "; it is still being trained"
    # Without Gaussians there is no file.
    elif steps < wanted or (len(trained.splats) and not any(trained.folder.glob(run_folders.CLOUDS))):
        advice = f"Type: {checkpoint.how_to_go_on(trained.folder)}"
        if steps == wanted:
            meaning += "; the results were not written"
    skipped = trained.state.skipped
    slower = "Lower the learning rates, or look for bad photos with `wegs doctor SCENE`."
    return [
        Finding("steps", f"{steps:,} of {wanted:,} in {trained.seconds:.0f} s", meaning, advice),
        counting(
            "skipped steps",
            skipped,
            steps,
            "a loss or gradient that was not finite, or a spike",
            slower if skipped > OFTEN * steps else "",
        ),
        *_course(trained),
    ]


def _course(trained: TrainedRun) -> list[Finding]:
    """Whether held-out quality fell, as recorded in training;
    nothing before the first check, and for a run without checks."""
    name, settings = "held-out quality", trained.settings
    course = [row[history.HELD_OUT] for row in history.checks(trained.folder)]
    if course:
        best, last = max(course), course[-1]
        overfits = "The run overfits its photos: train for fewer steps or with fewer Gaussians."
        advice = overfits if last < best - FELL_DB else ""
        return [Finding(name, f"{last:.2f} dB, {best:.2f} at best", "of a few test photos, by history.csv", advice)]
    if trained.collection.split("test") and any(
        step <= trained.step for step in schedule.evenly(settings.held_out_checks, settings.steps)
    ):
        meaning = f"{history.FILE} was removed or damaged after the training, or no test photo could be read"
        return [
            Finding(name, "not recorded", meaning, f"Measure it: {command('wegs', 'eval', '--run', trained.folder)}")
        ]
    return []


def _settings(settings: Settings) -> Finding:
    changed = [
        f"{item.name}={value}" for item in fields(settings) if (value := getattr(settings, item.name)) != item.default
    ]
    return Finding(
        "settings",
        ", ".join(changed) or "all defaults",
        "what differs from this version's defaults: chosen, or decided by the photos",
    )


def _looks(trained: TrainedRun, report: Report) -> list[Finding]:
    """How much the looks of the training photos add to the base, and how much their masks hide."""
    photos = spread_over(trained.collection.split("train"), MOST_PHOTOS)
    masks: dict[str, float] = {}
    unusable: dict[str, str] = {}  # with what to do about each
    base = trained.base(trained.splats.finite_rows())
    added = _Residuals(trained.settings)
    for done, photo in enumerate(photos, 1):
        try:
            sized = trained.sized_photo(photo)
        except BadInput as problem:  # of the photo or of its mask
            unusable[named_with_fault(photo.name, photo.path, problem)] = problem.fix
        else:
            with torch.no_grad():
                reading = trained.model.read(sized.encoder_input, trained.model.row_of(photo.name))
                residual = trained.model.transfer(base, reading.embedding)[1]
            if reading.mask is not None:
                masks[photo.name] = float(reading.mask.mean())
            if residual is not None and residual.numel():
                added.add(residual)
        report.progress("Looks", done, len(photos), photo.name)
    findings = []
    if unusable:
        example, fix = next(iter(unusable.items()))
        figure = f"{len(unusable)} of {len(photos)}, such as {example}"
        findings.append(Finding("photos", figure, "cannot be used now, so their looks cannot be refined", fix))
    if added.looks:
        findings += added.findings()
    if masks:
        findings.append(_masks(masks, trained))
    return findings


class _Residuals:
    """Statistics of what looks add to SH coefficients, summed look by look:
    a million Gaussians in 64 looks would not fit into memory."""

    def __init__(self, settings: Settings):
        """settings: of the run."""
        self.settings = settings
        self.looks, self.most, self.near_bound, self.numbers = 0, 0.0, 0, 0
        self.total = self.squares = torch.zeros((), dtype=torch.float64)

    def add(self, residual: torch.Tensor) -> None:
        """residual: (N, C, 3) of one look."""
        size = residual.abs()
        self.looks += 1
        self.most = max(self.most, float(size.max()))
        self.near_bound += int((size > NEAR_BOUND * self.settings.residual_bound).sum())
        self.numbers += size.numel()
        dc = residual[:, 0].double()
        self.total, self.squares = self.total + dc, self.squares + dc**2

    def findings(self) -> list[Finding]:
        """The findings, once at least one look has been added."""
        bounded = self.settings.appearance == "full"  # the affine transfer has no bound
        share = self.near_bound / self.numbers if bounded else 0.0
        near = f", {100 * share:.3g} % of them near the bound of {self.settings.residual_bound:g}" if bounded else ""
        advice = "Train with a larger residual_bound, or a lower network_rate." if share > AT_BOUND_SHARE else ""
        figure = f"up to {self.most:.3g}{near}, over {counted(self.looks, 'look')}"
        findings = [Finding("residuals", figure, "what looks add to SH coefficients", advice)]
        if self.looks > 1:
            variance = self.squares / self.looks - (self.total / self.looks) ** 2
            spread = float(variance.clamp_min(0).sqrt().mean())
            advice = _if_all_look_alike(self.settings) if spread < SAME_LOOK else ""
            figure = f"DC coefficients vary by {spread:.3g}"
            findings.append(Finding("looks", figure, "spread between photos, mean over Gaussians", advice))
        return findings


def _if_all_look_alike(settings: Settings) -> str:
    usual = Settings().sh_regularisation
    if settings.sh_regularisation > usual:  # such as the paper's, under which looks never leave the base
        return (
            f"sh_regularisation={settings.sh_regularisation:g} holds looks at the base: "
            f"train with less, such as {usual:g}."
        )
    return "Train with --set appearance=off: plain Gaussians do as well."


def _masks(masks: dict[str, float], trained: TrainedRun) -> Finding:
    collapsed, hide_from = trained.state.collapse_told, trained.settings.mask_apply * trained.settings.steps
    if trained.step < hide_from and not collapsed:
        return Finding("masks", "none yet", f"they hide nothing before step {math.ceil(hide_from):,}")
    name, least = min(masks.items(), key=lambda item: item[1])
    mean = sum(masks.values()) / len(masks)
    collapsed = collapsed or mean < LEAST_STATIC
    advice = "Raise mask_regularisation if they hide the place itself; a finished run shows them in masks/."
    figure = f"{mean:.2f} (mean), {least:.2f} (least: {name})"
    meaning = (
        "share of a photo that counts as static; "
        f"with a mean below {LEAST_STATIC} masks have collapsed and are held there"
    )
    return Finding("masks", figure, meaning, advice if collapsed else "")
