"""What the user reads of a training: what was found, what is decided, how it goes."""

from pathlib import Path

from core.config import Settings
from core.data.collection import Collection
from core.errors import command
from core.report import Report
from core.run import run_folders
from core.system import device
from core.training.gaussians.initialisation import most_points
from core.training.progress import tell_progress
from core.training.trainer import StepReport, Trainer
from core.words import counted

# Steps times Gaussians beyond which a CPU needs hours. Those of 592 photos, 41,440 and 275,280, took two cores 48
# minutes at 320x240.
LONG = 2e10
# Divides both, if it is to take less time: 592 photos lost 0.1 dB of zero-shot looks and 0.5 of refined ones (README).
SHORTENED = 4


def tell_collection(collection: Collection, report: Report) -> None:
    """What was found, and what of it is not used."""
    splits = ", ".join(f"{len(collection.split(name))} {name}" for name in ("train", "test"))
    photos, points = len(collection.photos), len(collection.points)
    report.say(
        f"{collection.name} ({collection.kind}): {counted(photos, 'photo')} ({splits}), {counted(points, 'point')}"
    )
    for note in collection.notes:
        (report.say if note.harmless else report.warn)(note.text)


def tell_plan(trainer: Trainer, report: Report) -> None:
    """What the training will do, and why."""
    for line in trainer.photos.notes + trainer.held_out.notes:
        report.warn(line)
    sizes = sorted({(sized.camera.width, sized.camera.height) for sized in trainer.photos})
    spread = " to ".join(f"{width}x{height}" for width, height in dict.fromkeys((sizes[0], sizes[-1])))
    settings = trainer.settings
    on_gpu = f" on {device.named(trainer.device)}" if trainer.device.type == "cuda" else ""
    report.say(
        f"Training {counted(settings.steps, 'step')}{on_gpu} at {spread} px, "
        f"at most {counted(settings.max_gaussians, 'Gaussian')}"
    )
    is_new = not trainer.state.done  # a resumed one keeps its settings
    if is_new and trainer.device.type == "cpu" and settings.steps * settings.max_gaussians > LONG:
        shorter = f"--steps {settings.steps // SHORTENED} --max-gaussians {settings.max_gaussians // SHORTENED}"
        report.say(
            f"That takes a CPU hours; a quarter of both costs little quality: {shorter} "
            "(for a first look: --preset quick)"
        )
    points = len(trainer.collection.points)
    if points > (most := most_points(settings)):
        report.say(
            f"It starts from {most:,} of the {counted(points, 'point')}, as half of the Gaussians are for growth"
        )
    if settings.transparent_is_empty:
        report.say("Transparent pixels are learned as empty space, without a sky, and scored over white")
    for decision in trainer.decisions:
        report.say(f"{decision.setting}={decision.value}: {decision.because}")
    looks = {"off": "one look", "exposure": "an affine colour map per look", "full": "looks (SH transfer)"}
    parts = [looks[settings.appearance]]
    if settings.has_masks:
        parts.append("masks of passers-by")
    if settings.sky == "dome":
        parts.append("a sky dome")
    report.say(f"Learning: {', '.join(parts)}; SH degree {settings.sh_degree}")


def tell_step(step: StepReport, settings: Settings, report: Report) -> None:
    """The warnings of a step, its held-out quality if measured, and the progress bar."""
    for message in step.messages:
        report.warn(message)
    if step.held_out_psnr is not None:
        report.say(f"Step {step.step}: held-out PSNR {step.held_out_psnr:.2f} dB")
    tell_progress(step.step, settings, f"loss {step.loss:.3f}, {counted(step.gaussians, 'Gaussian')}", report)


def next_step(folder: Path, settings: Settings, neutral: Path) -> str:
    """What to type, or to do, once a run is trained. neutral: its neutral look."""
    if not settings.has_looks:
        return f"open {neutral} in a 3DGS viewer   (all looks of this run are one)"
    which: list[str | Path] = [] if run_folders.is_default(folder) else ["--run", folder]
    advice = command("wegs", "bake", *which, "--appearance", "PHOTO", "-o", "look.ply")
    photos = "any photo" if settings.encodes_photos else "the name of a training photo"
    return f"{advice}   ({photos}; then open look.ply in a 3DGS viewer)"
