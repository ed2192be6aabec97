"""Photos -> scene -> trained run -> .ply: the whole story on one page. The command line is a thin skin over it."""

import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import core
import core.export
import core.rasterizer
from core import device
from core.atomic import check_apart, check_file, check_fillable, filling
from core.awake import cores_awake
from core.config import Settings
from core.data import load_collection, sfm, sfm_record
from core.data.collection import png_paths
from core.data.given_masks import check_masks, with_masks_in, with_same_masks
from core.data.load import check_cameras_unknown
from core.data.made import FADE
from core.data.photo_folder import SUFFIXES
from core.data.prepare import prepared
from core.errors import BadInput, BadSetting, WegsError, command
from core.evaluation import LOOKS, lpips
from core.evaluation.protocols import measure
from core.evaluation.results import PER_VIEW, PICTURES, RESULTS, SHEET, Results, file_of, measured_earlier
from core.evaluation.sheet import picture_sheet, pictures_kept, row_of, write_view
from core.export.pictures import contact_sheet, to_8_bit, write_png, write_video
from core.looks import saved_look
from core.looks.find_look import find_appearance, find_view
from core.looks.held_out_views import over_views
from core.looks.look_file import write_look
from core.looks.preview import write_preview
from core.looks.pruning import pruner_of
from core.looks.trained import bake, blend, load_run
from core.report import QUIET, Report
from core.training import checkpoint, run
from core.training.claim import held, new_run
from core.training.full_memory import saved_if_memory_runs_out
from core.training.interrupt import StopRequest
from core.training.masks import write_masks
from core.training.pictures import check_resolution
from core.training.tell import next_step, tell_collection, tell_how_to_look, tell_plan, tell_step
from core.training.trainer import Trainer
from core.words import counted, list_names

__all__ = [
    "bake",
    "evaluate",
    "export",
    "find_appearance",
    "find_cameras",
    "interpolate",
    "load_run",
    "resume",
    "train",
]
ONE_LOOK = "This run was trained without appearance: all its looks are one."


# --- photos -> scene


def find_cameras(photos: Path, output: Path, report: Report = QUIET) -> Path:
    """Put plain photos through structure from motion; `output` then is a scene that `train` reads."""
    check_cameras_unknown(photos)
    sfm.reconstruct(photos, output, report)
    if words := sfm_record.shortfall(output):
        report.warn(words)
    report.say(f"Next: {command('wegs', 'train', output)}")
    return output


# --- scene -> trained run


def train(
    scene: Path,
    settings: Settings,
    output: Path | None = None,
    report: Report = QUIET,
    *,
    force: bool = False,
    masks: Path | None = None,
) -> Path:
    """Train on the photos in `scene`; returns the run folder, which nothing is written into before the scene is read.

    Cameras or points that the scene lacks are made first (core.data.prepare), and kept beside the run for the next one.
    masks: a folder of pictures, white where the photo of that name is to be used (core.data.given_masks).
    """
    # Mistakes are refused before cameras are found, which may take minutes.
    check_resolution(settings.resolution)
    if masks is not None:
        check_masks(masks)
    core.rasterizer.create(settings.backend, device.chosen(settings.device, settings.backend).type)
    name = scene.resolve().name or "scene"
    with new_run(output, name, force) as folder:
        if run.is_run(folder):
            check_apart(folder, [scene] if masks is None else [scene, masks])
        collection = prepared(scene, folder.parent / f"{name}-scene", report, settings.all_photos)
        if settings.all_photos:
            collection = collection.undivided()
        if masks is not None:
            collection = with_masks_in(collection, masks)
        tell_collection(collection, report)
        trainer = Trainer(collection, settings, folder)
        run.create(folder, collection, trainer.settings, trainer.decisions)
        return _train(trainer, report)


def resume(folder: Path | None, report: Report = QUIET) -> Path:
    """Go on with a stopped run (default: the newest), as if it had never stopped."""
    folder = run.find_run(folder)
    with held(folder):
        return _go_on(folder, report)


def _go_on(folder: Path, report: Report) -> Path:
    _, settings, before = run.read_config(folder)
    path = checkpoint.newest(folder)
    saved = None if path is None else checkpoint.load(path)
    done = saved.facts["step"] if saved else 0
    if done >= settings.steps and any(folder.glob(run.CLOUDS)):  # else it was stopped just before its last file
        raise BadInput(
            f"{folder} is finished: {counted(settings.steps, 'step')}, over which its schedules are spread.",
            "For more, train a new run with --steps. To use this one, type: "
            f"{command('wegs', 'bake', '--run', folder, '--appearance', 'PHOTO', '-o', 'look.ply')}",
        )
    if settings.device == "cuda" and not device.can_use_gpu():
        raise BadInput(f"{folder} was begun on a GPU, and none can be used here.", "Go on with it on a machine that has one, or train a new run.")
    if not before.root.is_dir():
        raise BadInput(f"{folder} cannot go on: its scene {before.root} is gone.", "Move it back.")
    collection = with_same_masks(load_collection(before.root, settings.all_photos), before)
    collection = collection.undivided() if settings.all_photos else collection
    trainer = Trainer(collection, settings, folder)
    names = {picture.photo.name for picture in trainer.pictures}
    if changed := collection.changed_since(before) or (saved and sorted(names ^ set(saved.facts["photos"]))):
        what = f"The photos in {before.root} are not those that {folder} began with: {list_names(changed)} differ or are gone"
        raise BadInput(f"{what}.", "Put them back as they were, or train a new run.")
    why = "" if saved else ", with its own settings: it has no checkpoint yet"
    report.say(f"Going on with {folder} from step {done}{why}")
    run.rewind_history(folder, done)
    if saved:
        with checkpoint.fitting(path):
            trainer.resume(saved)
    return _train(trainer, report)


def _train(trainer: Trainer, report: Report) -> Path:
    folder, settings = trainer.folder, trainer.settings
    advice = command("wegs", "train", "--resume", "-o", folder)
    tell_plan(trainer, report)
    with StopRequest() as stop, saved_if_memory_runs_out(trainer):
        for step in trainer.train():
            try:
                tell_step(step, settings.steps, report)
            except OSError:  # such as a log on a full disk
                trainer.save()
                raise
            if stop.asked and step.step < settings.steps:
                trainer.save()
                raise KeyboardInterrupt(f"Step {step.step} is kept; go on with: {advice}")
    try:
        _write_results(trainer, report)
    except KeyboardInterrupt:
        if any(folder.glob(run.CLOUDS)):
            raise
        raise KeyboardInterrupt(f"All steps are kept; finish with: {advice}") from None
    return folder


def _write_results(trainer: Trainer, report: Report) -> None:
    """Write what a finished training leaves to look at. The neutral look comes last: it marks the run as finished."""
    folder = trainer.folder
    trained = load_run(folder)
    neutral = run.point_cloud_path(folder, trained.step)
    masks = write_masks(folder, trainer.model, trainer.pictures)
    preview = write_preview(trained, trainer.pictures)
    write_look(trained, find_appearance(trained, "neutral"), neutral, report, pruner_of(trained, report))
    rows = [
        ("run", str(folder)),
        ("steps", f"{trained.step} in {trainer.seconds:.0f} s"),
        ("Gaussians", f"{len(trained.splats)} (sky {trainer.gaussians.sky})"),
        ("neutral look", f"{neutral} ({neutral.stat().st_size / 1e6:.1f} MB)"),
    ]
    if masks:
        rows.append(("masks", str(folder / "masks")))
    rows.append(("to look at", str(preview)))
    report.table("Done", rows)
    if earlier := measured_earlier(folder, trained.step):
        report.say(f"Of an earlier step: {', '.join(earlier)}. To measure again, type: {command('wegs', 'eval', '--run', folder)}")
    report.say(f"Next: {next_step(folder, trainer.settings, neutral)}")


# --- trained run -> .ply and pictures


def export(
    folder: Path | None,
    word: str,
    output: Path,
    report: Report = QUIET,
    *,
    force: bool = False,
    save_as: str | None = None,
    prune: bool = True,
    mask: Path | None = None,
    sky: bool = True,
    refine: bool = True,
) -> Path:
    """Bake the look that `word` names and write it to `output`; `save_as` keeps the look in the run as well.

    prune: leave out what no training view shows. mask: of the photo that `word` names, white where it is to be used. sky: write the dome, too.
    refine: refine the look of a photo that was not trained on, if its camera is known or found.
    """
    core.export.check_format(output)
    check_file(output)
    if output.exists() and not force:
        raise BadInput(f"{output} exists.", "Add --force to replace it, or choose another -o.")
    trained = load_run(run.find_run(folder))
    if save_as is not None:
        saved_look.check_free(trained.folder, save_as, force, [photo.name for photo in trained.collection.photos])
    appearance = find_appearance(trained, word, mask, refine, report)
    report.say(f"{trained.folder}, step {trained.step}{trained.where}: look of {appearance.source}")
    for note in trained.collection.frame.offset_notes():
        report.warn(note)
    if trained.settings.appearance == "off":
        report.warn(ONE_LOOK)
    start = time.perf_counter()
    written = write_look(trained, appearance, output, report, pruner_of(trained, report) if prune else None, sky)
    if save_as is not None:
        kept = saved_look.save(trained.folder, replace(appearance, name=save_as), trained.identity, trained.step)
        report.say(f"Look kept as {kept}")
    report.say(f"{output}: {counted(written, 'Gaussian')}, {output.stat().st_size / 1e6:.1f} MB, {time.perf_counter() - start:.1f} s")
    tell_how_to_look(trained.folder, output, sky and trained.sky > 0, report)
    return output


def interpolate(
    folder: Path | None,
    first: str,
    last: str,
    steps: int = 10,
    output: Path | None = None,
    report: Report = QUIET,
    *,
    view: str | None = None,
    ply: bool = False,
    force: bool = False,
    refine: bool = True,
) -> Path:
    """Fade from one look to another in `steps` frames (2 or more), seen by the camera of photo `view`; returns their folder.

    The first and the last frame show the two looks themselves, bit for bit: their embeddings are not interpolated. refine: as in `export`.
    """
    if steps < 2:
        raise BadSetting(f"{steps} steps are too few for a fade from one look to another.", "Take 2 steps or more.")
    trained = load_run(run.find_run(folder))
    photo = find_view(trained, view)
    output = output or Path(f"{_short(first)}-to-{_short(last)}")
    check_apart(output, [Path(first), Path(last)])
    check_fillable(output, FADE, force)
    ends = [find_appearance(trained, word, refine=refine, report=report) for word in (first, last)]
    camera = trained.camera(photo)
    rasterizer = trained.rasterizer
    report.say(f"{trained.folder}{trained.where}: {steps} steps, seen from {photo.name}")
    for which, end in zip(("from", "to"), ends, strict=True):
        report.say(f"  {which} {end.source}")
    if trained.settings.appearance == "off":
        report.warn(ONE_LOOK)
    with filling(output, FADE, force) as work:
        pruner = pruner_of(trained, report) if ply else None
        frames = []
        for step in range(steps):
            appearance = blend(*ends, step / (steps - 1))
            if ply:
                write_look(trained, appearance, work / f"step_{step:03d}.ply", report if step == 0 else QUIET, pruner)
            frames.append(to_8_bit(rasterizer.render(bake(trained, appearance), camera, trained.backdrop).image))
            write_png(work / f"frame_{step:03d}.png", frames[-1])
            report.progress("Frames", step + 1, steps)
        write_png(work / "sheet.png", contact_sheet(frames))
        try:
            write_video(work / "video.mp4", frames)
        except WegsError as problem:  # the frames took the time: they are kept
            report.warn(str(problem).replace(str(work), str(output)))
    report.say(f"{output}: {steps} frames, sheet.png{', video.mp4' * (output / 'video.mp4').is_file()}")
    return output


def _short(word: str) -> str:
    """A look's name for a folder: without path and without a file's suffix."""
    path = Path(word)
    return path.stem if path.suffix.lower() in (*SUFFIXES, ".json") else path.name


# --- trained run -> figures


@cores_awake()
def evaluate(
    folder: Path | None, protocol: str = "half", report: Report = QUIET, *, refine: bool = True, keep_pictures: bool = False
) -> Results:
    """Measure the held-out photos at training size; writes results.json, per_view.json and sheet.png of the protocol into the run.

    keep_pictures: also every render and photo, as they were compared, into its pictures/.
    """
    trained = load_run(run.find_run(folder))
    run.check_writable(trained.folder)
    photos = trained.collection.split("test")
    if not photos:
        raise BadInput(f"{trained.folder} has no held-out photos.", "Train without --all-photos on a scene whose split has test photos.")
    report.say(f"{trained.folder}, step {trained.step}{trained.where}: {counted(len(photos), 'held-out photo')}, protocol {protocol}{', over white' * trained.is_cut_out}")
    distance = lpips.load()
    if distance is None:
        report.warn(f"LPIPS: {lpips.ABSENT}")
    else:
        distance = distance.to(trained.device)
    start = time.perf_counter()
    views, rows, scales = [], [], []
    paths = png_paths(photo.name for photo in photos)
    through = over_views(trained, photos, lambda view: measure(trained, view, protocol, refine, distance), "Photos", report)
    with pictures_kept(trained.folder / PICTURES / protocol, protocol) if keep_pictures else nullcontext() as work:
        for photo, (measured, pictures) in through:
            views.append(measured)
            scales.append(measured.width / photo.camera.width)
            figures = (f"{LOOKS[look]} {score.psnr:.2f} dB" for look, score in measured.scores["photo"].items())
            rows.append(row_of(pictures, ", ".join(figures)))
            if work is not None:
                write_view(work, paths[photo.name], pictures)
    results = Results(
        protocol=protocol,
        views=tuple(views),
        run=trained.identity,
        gaussians=len(trained.splats),
        train_photos=len(trained.collection.split("train")),
        test_photos=len(photos),
        scale=sum(scales) / len(scales),
        lpips_backbone=None if distance is None else distance.backbone,
        seed=trained.settings.seed,
        steps=trained.step,
        training_seconds=trained.seconds,
        evaluation_seconds=time.perf_counter() - start,
        over_white=trained.is_cut_out,
    )
    results.save(trained.folder)
    write_png(trained.folder / file_of(SHEET, protocol), picture_sheet(rows, protocol, trained.step))
    report.table(f"Held-out quality, protocol {protocol}", results.rows())
    names = (*(file_of(name, protocol) for name in (RESULTS, PER_VIEW, SHEET)), *[f"{PICTURES}/{protocol}/"] * keep_pictures)
    report.say(f"{trained.folder}: {', '.join(names)}")
    return results
