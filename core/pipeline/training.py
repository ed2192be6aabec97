"""A scene -> a trained run: what `wegs train` does, from its first step or, with --resume, from where it stopped."""

from pathlib import Path

import core.rasterizer
from core.config import Settings
from core.data import find_kind, find_photos, load_collection
from core.data.collection import Collection
from core.data.given_masks import check_masks, with_same_masks
from core.data.made import scene_beside
from core.data.photos.folder import list_photos
from core.data.prepare import prepared
from core.errors import BadInput, DiskFull, as_disk_full, command
from core.evaluation.results import measured_earlier
from core.looks.look_file import write_look
from core.looks.preview import write_preview
from core.looks.pruning import pruner_of
from core.looks.trained import TrainedRun, load_run, neutral_look
from core.report import QUIET, Report
from core.run import checkpoint, history, run_config, run_folders, viewer_files
from core.run.claim import held, new_run
from core.run.sized_photo import check_resolution
from core.system import device
from core.system.outputs import check_apart
from core.training.compiling import compile_kernels
from core.training.interrupt import StopRequest
from core.training.mask_files import write_masks
from core.training.rescue import as_no_room, saved_if_room_runs_out
from core.training.tell import next_step, tell_collection, tell_plan, tell_step
from core.training.trainer import Trainer
from core.words import counted, list_names


def train(
    scene: Path,
    settings: Settings,
    output: Path | None = None,
    report: Report = QUIET,
    *,
    force: bool = False,
    masks: Path | None = None,
) -> Path:
    """Train on the photos in `scene`; returns the run folder,
    into which nothing is written before the scene has been read.

    Cameras or points that the scene lacks are made first (core.data.prepare), and kept beside the run for the next one.
    masks: a folder of pictures, white where the photo of that name is to be used (core.data.given_masks).

    Raises BadInput for a scene, masks or an output that cannot be used, BadSetting for settings that do not suit them
    or the machine and for an output named as a .ply; TrainingStopped and DiskFull. A stop is a KeyboardInterrupt that
    says what is kept of the training.
    """
    # Mistakes are refused before cameras are found, which may take minutes.
    check_resolution(settings.resolution)
    if masks is not None:
        check_masks(
            masks, [path.name for path in list_photos(find_photos(scene))] if find_kind(scene) == "photos" else ()
        )
    core.rasterizer.create(settings.backend, device.chosen(settings.device, settings.backend).type)
    if device.may_be_gpu(settings.device, settings.backend) and (fault := device.fault_of_gpu()):
        report.warn(f"The GPU is not used: {fault}.")
    name = scene.resolve().name or "scene"
    with new_run(output, name, force) as folder:
        if run_folders.is_run(folder):
            check_apart(folder, [scene] if masks is None else [scene, masks])
        collection = prepared(scene, scene_beside(folder, scene), report, settings, masks)
        tell_collection(collection, report)
        return _train(Trainer.of_new_run(collection, settings, folder, report), report)


def resume(folder: Path | None, report: Report = QUIET) -> Path:
    """Continue a stopped run (default: the newest) as if it had never stopped; a finished one is left as it is.

    Raises as `train`; also BadInput for a run that cannot go on, such as one whose photos have changed.
    """
    folder = run_folders.find_run(folder)
    with held(folder):
        return _continue_run(folder, report)


def _continue_run(folder: Path, report: Report) -> Path:
    _, settings, before = run_config.read_config(folder)
    path = checkpoint.newest(folder)
    done = checkpoint.read_facts(path)["step"] if path else 0
    # Else it was stopped just before its last file.
    if done >= settings.steps and (clouds := list(folder.glob(run_folders.CLOUDS))):
        report.say(f"{folder} is finished: {counted(settings.steps, 'step')}, over which its schedules are spread.")
        report.say(f"For more steps, train a new run. To use this one: {next_step(folder, settings, clouds[0])}")
        return folder
    run_folders.check_writable(folder, "-o")
    if settings.device == "cuda" and not device.can_use_gpu():
        raise BadInput(
            f"{folder} was begun on a GPU, and none can be used here.",
            "Go on with it on a machine that has one, or train a new run.",
        )
    if not before.root.is_dir():
        raise run_config.scene_gone(folder, before, f"{folder} cannot go on")
    collection = with_same_masks(load_collection(before.read_from, settings.all_photos), before)
    _check_same_photos(folder, before, collection.changed_since(before) or run_config.changed_files(before))
    trainer = Trainer(collection, settings, folder, report)
    if path:
        _restore(trainer, path, before)
    # They may be incomplete, if it was stopped early, or lost.
    viewer_files.write(folder, collection, trainer.settings.transparent_is_empty)
    why = "" if path else ", with its own settings: it has no checkpoint yet"
    report.say(f"Going on with {folder} from step {done}{why}")
    history.rewind(folder, done)
    return _train(trainer, report)


def _restore(trainer: Trainer, path: Path, before: Collection) -> None:
    """Bring the trainer to the state in the checkpoint `path`.
    In a function of its own, so that the checkpoint does not stay in memory."""
    saved = checkpoint.load(path)
    with checkpoint.fitting(path):
        decoded = {sized.photo.name for sized in trainer.photos}  # without those damaged since
        _check_same_photos(trainer.folder, before, sorted(decoded ^ set(saved.facts["photos"])))
        trainer.resume(saved)


def _check_same_photos(folder: Path, before: Collection, changed: list[str]) -> None:
    """Raise BadInput if any photos have changed since the run in `folder` began.
    before: its collection, as it was then."""
    if changed:
        what = (
            f"The photos in {before.root}, or their masks, are not those that {folder} began with; "
            "changed, split otherwise or gone: "
        )
        raise BadInput(f"{what}{list_names(changed)}.", "Put them back as they were, or train a new run.")


def _train(trainer: Trainer, report: Report) -> Path:
    folder, settings = trainer.folder, trainer.settings
    advice = checkpoint.how_to_go_on(folder)
    tell_plan(trainer, report)
    if trainer.rasterizer.name == "cpu":
        _compile(trainer, advice)
    with StopRequest() as stop, saved_if_room_runs_out(trainer):
        for step in trainer.train():
            tell_step(step, settings, report)
            if step.step in trainer.saves and step.step < settings.steps:
                preview = _preview(trainer, report)
                if preview and step.step == min(trainer.saves):
                    report.say(f"To look at meanwhile: {preview}")
            if stop.asked and step.step < settings.steps:
                trainer.save()
                raise KeyboardInterrupt(f"Step {step.step} is kept; go on with: {advice}")
    try:
        _write_results(trainer, report)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"All steps are kept; finish with: {advice}") from None
    except (DiskFull, OSError) as problem:
        if (full := as_disk_full(problem)) is None:
            raise
        raise DiskFull(full.what, f"All steps are kept. Free some space, then type: {advice}") from None
    return folder


def _compile(trainer: Trainer, advice: str) -> None:
    """Compile the kernels before the first step, which a stop would wait for."""
    try:
        with saved_if_room_runs_out(trainer):
            compile_kernels(looks=trainer.settings.appearance == "full")
    except KeyboardInterrupt:
        kept = f"Step {trainer.state.done} is kept" if trainer.state.done else "No step was taken yet"
        raise KeyboardInterrupt(f"{kept}; go on with: {advice}") from None


def _preview(trainer: Trainer, report: Report, trained: TrainedRun | None = None) -> Path | None:
    """Draw the picture of the scene so far. Without room for it in memory, that is said: no training stops for it.
    trained: the run, if it is loaded already."""
    try:
        return write_preview(trained or load_run(trainer.folder), trainer.photos)
    except Exception as problem:
        if (cause := as_no_room(problem)) is None:
            raise
        report.warn(f"{run_folders.PREVIEW} was not drawn. {cause.what}")
        return None


def _write_results(trainer: Trainer, report: Report) -> None:
    """Write the results of a finished training. The neutral look comes last, because it marks the run as finished."""
    folder = trainer.folder
    trained = load_run(folder)
    neutral = run_folders.point_cloud_path(folder, trained.step)
    masks = write_masks(folder, trainer.model, trainer.photos, report)
    preview = _preview(trainer, report, trained)
    write_look(trained, neutral_look(trained), neutral, report, pruner_of(trained, report))
    rows = [
        ("run", str(folder)),
        ("steps", f"{trained.step:,} in {trainer.state.seconds:.0f} s"),
        ("Gaussians", f"{len(trained.splats):,} (sky {trainer.gaussians.sky_count:,})"),
        ("neutral look", f"{neutral} ({neutral.stat().st_size / 1e6:.1f} MB)"),
    ]
    if masks:
        rows.append(("masks", str(folder / run_folders.MASKS)))
    if preview:
        rows.append(("to look at", str(preview)))
    report.table("Done", rows)
    if earlier := measured_earlier(folder, trained.identity, trained.step):
        report.say(
            f"Of an earlier run or step: {', '.join(earlier)}. "
            f"To measure again, type: {command('wegs', 'eval', '--run', folder)}"
        )
    report.say(f"Next: {next_step(folder, trainer.settings, neutral)}")
