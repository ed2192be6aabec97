"""Which figures are drawn, of what, and where they go: what `wegs bench` and `wegs eval --curve` do."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from core.automatic import LEAST
from core.bench import FIGURES, files, small_scene
from core.bench.baking import baking_figure
from core.bench.figure import Figure
from core.bench.refinement import refinement_figure
from core.bench.rendering import rendering_figure
from core.bench.training import Course, checks, training_figure
from core.config import Settings
from core.data.collection import Collection, spread_over
from core.data.made import scene_beside
from core.data.prepare import prepared
from core.errors import BadInput
from core.evaluation import PROTOCOLS
from core.looks.trained import TrainedRun, bake, load_run, neutral_look
from core.pipeline.opened import open_run
from core.presets import PRESETS, preset
from core.report import Report
from core.run import run_folders
from core.setting import UNDECIDED
from core.system.atomic import made_for_user, scratch
from core.training.trainer import Trainer

OF_RUN = "rendering-run"  # the rendering figure of a run's own cameras
ELSEWHERE = ("Seconds are those of the machine that trained; this figure was drawn on:",)  # histories do not name it
CHECKS = 12  # times a run that is trained for a figure is measured on the way


@dataclass(frozen=True)
class Size:
    """How much is measured."""

    share: float  # of each preset's steps that are trained
    gaussians: int  # in training, at most
    budget: float  # see `stopwatch.timed`
    resolution: int  # of the photos in training: a width in px, or UNDECIDED
    seeds: int  # that each preset is trained with
    views: int  # that baking is judged by
    photos: int  # that are refined
    cameras: int  # of a run that are rendered


SMALL = Size(share=0.2, gaussians=4000, budget=0.5, resolution=160, seeds=1, views=8, photos=4, cameras=1)
FULL = Size(
    share=1.0,
    gaussians=LEAST["max_gaussians"],
    budget=3.0,
    resolution=UNDECIDED,
    seeds=3,
    views=32,
    photos=100,
    cameras=3,
)


def bench(
    scene: Path | None,
    run_folder: Path | None,
    names: tuple[str, ...],
    full: bool,
    output: Path,
    report: Report,
    force: bool = False,
) -> list[Figure]:
    """Measure and draw the figures `names` (of FIGURES, in that order);
    each is written into `output` as soon as it is measured.

    They are of the run in `run_folder` or, without one, of all presets, which are trained now on `scene` or on the
    built-in scene. force: replace figures that are there, or remove them where nothing can be drawn in their place.

    Raises BadInput for a scene, run or output that cannot be used, and where nothing can be measured; BadSetting for an
    output with the suffix of a file; DiskFull.
    """
    _check_asked(scene, run_folder, names)
    names = tuple(name for name in FIGURES if name in names)  # one may be given twice
    replaced = (*names, OF_RUN) if "rendering" in names else names
    files.check_free(output, replaced, force)
    trained = None if run_folder is None else open_run(run_folder, report)  # fails now, not after minutes
    collection = None if scene is None else prepared(scene, scene_beside(output, scene), report)
    names = _measurable(names, trained, collection, report)
    figures = []
    with made_for_user(output), scratch("bench") as work:  # made now, not after minutes
        for figure in _figures(names, trained, collection, FULL if full else SMALL, work, report):
            figures.append(figure)
            _keep(figure, output, report)
    if not figures:
        raise BadInput("There was nothing to measure.", "Take another --only, or a run with looks.")
    _remove_older(output, replaced, figures, report)
    return figures


def _check_asked(scene: Path | None, run_folder: Path | None, names: tuple[str, ...]) -> None:
    """Raise BadInput for what excludes each other."""
    if scene is not None and run_folder is not None:
        raise BadInput(
            "A scene and a run were given.", "Give one: the scene is trained on, the run is measured as it is."
        )
    if scene is not None and set(names) == {"rendering"}:
        raise BadInput(
            "Without --run, rendering is measured on the built-in scene alone.",
            "Leave SCENE out, or give a run with --run.",
        )


def _figures(
    names: tuple[str, ...],
    trained: TrainedRun | None,
    collection: Collection | None,
    size: Size,
    work: Path,
    report: Report,
) -> Iterator[Figure]:
    """The figures `names`, each as soon as it is measured: of a run or, for None, of what is trained on the collection
    (None: the built-in one) in the folder `work`."""
    if "rendering" in names:
        yield _fixed_rendering(size, report)
        if trained is not None:
            yield _rendering_of(trained, size, report)
    if trained is None:
        courses, title, notes = _train_presets(collection, names, size, work, report)
        if not courses:
            return
        trained = load_run(courses[0].folders[0])
    else:
        courses = _courses_of([trained.folder])
        title, notes = f"Training {courses[0].name}", ELSEWHERE
    if "baking" in names:
        yield baking_figure(trained, size.views, report, size.budget)
    if "training" in names:
        yield training_figure(courses, title, notes)
    if "refinement" in names:
        figure = _refinement({courses[0].name: trained}, tuple(PROTOCOLS), size.photos, report)
        if figure is not None:
            yield figure


def curves(runs: tuple[Path, ...], protocols: tuple[str, ...], refine: bool, report: Report) -> list[Figure]:
    """Draw the training of runs, and the refinement on their held-out photos, into the folder of the first.

    Figures that an earlier call left there are replaced or, if they are not drawn now, removed: they may be of other
    runs. runs: their folders, the newest run if empty; one given twice is drawn once. refine: if False, only the
    training is drawn. Raises BadInput for a run that cannot be used or written in, or whose held-out quality was never
    measured; DiskFull.
    """
    found = [run_folders.find_run(path) for path in runs or (None,)]
    folders = list({folder.resolve(): folder for folder in found}.values())
    run_folders.check_writable(folders[0] / run_folders.CURVES)
    courses = _courses_of(folders)
    title = f"Training: {', '.join(course.name for course in courses)}"
    figures = [training_figure(courses, title, ELSEWHERE)]
    if refine:
        trained = {course.name: open_run(course.folders[0], report) for course in courses}
        figure = _refinement(trained, protocols, FULL.photos, report)
        if figure is not None:
            figures.append(figure)
    _remove_older(folders[0] / run_folders.CURVES, FIGURES, figures, report)
    for figure in figures:
        _keep(figure, folders[0] / run_folders.CURVES, report)
    return figures


def _keep(figure: Figure, folder: Path, report: Report) -> None:
    files.show(figure, report)
    paths = files.save(figure, folder)
    report.say(f"{folder}: {', '.join(path.name for path in paths)}")
    report.say("")


def _remove_older(folder: Path, names: tuple[str, ...], figures: list[Figure], report: Report) -> None:
    """Delete those of the figures `names` in the folder that were not drawn now: they may be of another run."""
    drawn = {figure.name for figure in figures}
    if old := files.figure_files(folder, tuple(name for name in names if name not in drawn)):
        for path in old:
            path.unlink()
        report.say(f"{folder}: removed {', '.join(path.name for path in old)}, of an earlier call")


def _measurable(
    names: tuple[str, ...], trained: TrainedRun | None, collection: Collection | None, report: Report
) -> tuple[str, ...]:
    """Those of the figures `names` that the run or the photos allow to measure;
    the others are reported, with the reason.

    collection: None for that of the run, or the built-in one.
    """
    collection = trained.collection if trained else collection
    reasons: dict[str, BadInput] = {}
    if collection is not None and not collection.split("test"):
        none_held_out = BadInput(
            f"No photo of {collection.name} is held out.",
            "Take a run without --all-photos of a scene whose split has test photos.",
        )
        reasons = {"training": none_held_out, "refinement": none_held_out}
    elif trained is not None:
        try:
            checks(trained.folder)
        except BadInput as unchecked:
            reasons = {"training": unchecked}
    lacking = [name for name in names if name in reasons]
    if not lacking:
        return names
    reason = reasons[lacking[0]]
    if len(lacking) == len(names):
        raise BadInput(reason.what, f"{reason.fix} Or choose another figure with --only.")
    report.say(f"Nothing is drawn of {' and '.join(lacking)}: {reason}")
    return tuple(name for name in names if name not in reasons)


def _courses_of(folders: list[Path]) -> list[Course]:
    """The courses of runs that were trained before;
    as their settings may be any, none of their points is called a default.

    They are named by the ends of their paths, as long as it takes to tell them apart.
    """
    paths = [folder.resolve().parts for folder in folders]
    for length in range(1, max(map(len, paths)) + 1):
        names = ["/".join(path[-length:]) for path in paths]
        if len(set(names)) == len(set(paths)):
            break
    return [Course(name, (folder,)) for name, folder in zip(names, folders, strict=True)]


def _refinement(
    trained: dict[str, TrainedRun], protocols: tuple[str, ...], photos: int, report: Report
) -> Figure | None:
    """As `refinement_figure`, of those runs that have looks; None, and told why, if nothing can be drawn."""
    for name, run in trained.items():
        if not run.has_looks:
            report.say(f"{name}: trained without appearance, so there is no look to refine.")
    if with_looks := {name: run for name, run in trained.items() if run.has_looks}:
        try:
            return refinement_figure(with_looks, protocols, photos, report)
        except BadInput as problem:  # for example if photos are gone, which the histories do not need
            report.warn(f"Nothing is drawn of the refinement: {problem}")
    return None


def _fixed_rendering(size: Size, report: Report) -> Figure:
    splats, cameras = small_scene.rendering_scene()
    return rendering_figure("the built-in scene", splats, cameras, report, seed=0, budget=size.budget)


def _rendering_of(trained: TrainedRun, size: Size, report: Report) -> Figure:
    photos = spread_over(trained.collection.split("test") or trained.collection.photos, size.cameras)
    cameras = [trained.camera(photo) for photo in photos]
    splats = bake(trained, neutral_look(trained)).map(Tensor.cpu)  # that figure is of a CPU
    return rendering_figure(
        trained.folder.resolve().name,
        splats,
        cameras,
        report,
        seed=trained.settings.seed,
        budget=size.budget,
        name=OF_RUN,
    )


# --- what is trained


def _train_presets(
    collection: Collection | None, names: tuple[str, ...], size: Size, folder: Path, report: Report
) -> tuple[list[Course], str, tuple[str, ...]]:
    """Train what the figures `names` need, `default` first, into `folder`: the courses, a title and notes for a figure.

    collection: None for the built-in one.
    """
    if "training" in names:
        wanted, seeds = list(PRESETS), size.seeds
    elif "baking" in names or "refinement" in names:
        wanted, seeds = ["default"], 1
    else:
        return [], "", ()
    is_built_in = collection is None
    if collection is None:
        (folder / "photos").mkdir()
        collection = small_scene.collection(folder / "photos")
    # Otherwise the compilation of the kernels would count as time of the first preset.
    _train(collection, _sized("default", size, 0, is_built_in).changed(steps=20), folder / "warm-up", report)
    courses = []
    for name in wanted:
        folders = [folder / (name if seed == 0 else f"{name}-{seed}") for seed in range(seeds)]
        for seed, path in enumerate(folders):
            _train(collection, _sized(name, size, seed, is_built_in), path, report)
        courses.append(Course(name, tuple(folders), name == "default"))
    most = f"{round(LEAST['steps'] * size.share)} steps and {size.gaussians} Gaussians"
    note = f"Presets with {size.share:.0%} of their steps; none has more than {most}."
    return courses, f"Training on {collection.name}: every preset", (note,)


def _sized(name: str, size: Size, seed: int, is_built_in: bool) -> Settings:
    """The preset with fewer steps and Gaussians, as `size` says, and with more checks of its held-out quality."""
    settings = preset(name)
    whole = settings.decided(**LEAST)  # for these numbers alone: what follows from the steps is decided of fewer
    return settings.changed(
        steps=max(1, round(min(whole.steps, LEAST["steps"]) * size.share)),
        max_gaussians=min(whole.max_gaussians, size.gaussians),
        seed=seed,
        resolution=1 if is_built_in else size.resolution,
        held_out_checks=CHECKS,
        checkpoints=1,
    )


def _train(collection: Collection, settings: Settings, folder: Path, report: Report) -> None:
    for step in Trainer.of_new_run(collection, settings, folder).train():
        report.progress(f"Training {folder.name}", step.step, settings.steps, f"loss {step.loss:.3f}")
