"""A trained run and its held-out photos -> figures: what `wegs eval` does."""

import time
from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from pathlib import Path
from statistics import fmean

from core.data.collection import Photo, spread_over
from core.data.photos.names import is_file, png_paths
from core.errors import BadInput
from core.evaluation import RESULT_FILES, WAYS, lpips
from core.evaluation.protocols import ViewPictures, ViewResult, check_protocol, measure
from core.evaluation.results import Results
from core.evaluation.sheet import Row, picture_sheet, pictures_kept, row_of, write_view
from core.export.pictures import write_png
from core.looks.held_out_views import over_views
from core.looks.trained import TrainedRun
from core.pipeline.opened import open_run
from core.report import QUIET, Report
from core.run import run_folders
from core.run.run_config import check_same_run
from core.system.atomic import adding
from core.words import counted

# Of the sheet. With pictures of usual shapes it stays below 32,767 px, beyond which browsers show none;
# 500 photos would take 2.6 GB.
MOST_ROWS = 60


def evaluate(
    folder: Path | None,
    protocol: str = "half",
    report: Report = QUIET,
    *,
    refine: bool = True,
    keep_pictures: bool = False,
) -> Results:
    """Measure the held-out photos at training size;
    writes results.json, per_view.json and sheet.png of the protocol into the run.

    keep_pictures: also every render and photo, as they were compared, into its pictures/.
    Raises BadInput for a run that cannot be used or written in, and if no held-out photo can be measured; BadSetting
    for an unknown protocol; DiskFull.
    """
    check_protocol(protocol)
    trained = open_run(folder, report)
    _check_outputs(trained.folder, protocol)
    photos = _held_out(trained)
    report.say(_what_is_measured(trained, photos, protocol))
    if (distance := lpips.load(trained.device)) is None:
        report.warn(f"LPIPS: {lpips.ABSENT}")
    start = time.perf_counter()
    kept = trained.folder / run_folders.PICTURES / protocol
    with pictures_kept(kept, protocol) if keep_pictures else nullcontext() as work:
        measured = over_views(
            trained, photos, lambda view: measure(trained, view, protocol, refine, distance), "Photos", report
        )
        on_sheet = spread_over([photo.name for photo in photos if is_file(photo.path)], MOST_ROWS)
        views, rows, scale = _gathered(measured, on_sheet, png_paths(photo.name for photo in photos), work)
        check_same_run(trained.folder, trained.identity)
    results = Results(
        protocol=protocol,
        views=views,
        run=trained.identity,
        gaussians=len(trained.splats),
        train_photos=len(trained.collection.split("train")),
        test_photos=len(photos),
        scale=scale,
        lpips_backbone=None if distance is None else lpips.BACKBONE,
        seed=trained.settings.seed,
        steps=trained.step,
        training_seconds=trained.seconds,
        evaluation_seconds=time.perf_counter() - start,
        white_background=trained.settings.transparent_is_empty,
        has_looks=trained.has_looks,
    )
    if distance is not None and (small := sum(view.scores["photo"]["zero_shot"].lpips is None for view in views)):
        report.say(f"LPIPS: {counted(small, 'photo')} too small for it")
    if not keep_pictures and kept.exists():
        report.warn(f"{kept} is of an earlier call: --pictures replaces it")
    report.table(f"Held-out quality, protocol {protocol}", results.rows())
    names = RESULT_FILES[protocol]
    with adding(trained.folder) as files:
        results.save(files)
        write_png(files / names.sheet, picture_sheet(rows, protocol, trained.step))
    some = "" if len(rows) == len(views) else f" (of {counted(len(rows), 'photo')})"
    written = [names.means, names.per_view, f"{names.sheet}{some}"]
    if keep_pictures:
        written.append(f"{run_folders.PICTURES}/{protocol}/")
    report.say(f"{trained.folder}: {', '.join(written)}")
    return results


def _check_outputs(folder: Path, protocol: str) -> None:
    """Raise BadInput unless the figures can be written into the run."""
    run_folders.check_writable(folder)
    for path in (folder / name for name in RESULT_FILES[protocol]):
        if path.is_dir():
            raise BadInput(f"{path} is a folder, where a file is to be written.", "Move it away.")


def _held_out(trained: TrainedRun) -> tuple[Photo, ...]:
    photos = trained.collection.split("test")
    if not photos:
        raise BadInput(
            f"{trained.folder} has no held-out photos.",
            "Train without --all-photos on a scene whose split has test photos.",
        )
    return photos


def _what_is_measured(trained: TrainedRun, photos: tuple[Photo, ...], protocol: str) -> str:
    """A line: which run, on how many photos of those held out, and how."""
    there, count = sum(is_file(photo.path) for photo in photos), counted(len(photos), "held-out photo")
    found = count if there == len(photos) else f"{there} of {count}"
    over = ", over white" if trained.settings.transparent_is_empty else ""
    return f"{trained.folder}, step {trained.step}{trained.on_device_in_words}: {found}, protocol {protocol}{over}"


def _gathered(
    measured: Iterable[tuple[Photo, tuple[ViewResult, ViewPictures]]],
    on_sheet: Sequence[str],
    paths: dict[str, Path],
    work: Path | None,
) -> tuple[tuple[ViewResult, ...], list[Row], float]:
    """The figures of each photo, the rows of the sheet, and the mean scale of the photos (1: as on disk).

    on_sheet: the photos that have a row; where these turn out to be damaged, another has one. paths: of the pictures,
    by photo. work: where to write them, if at all.
    """
    views: list[ViewResult] = []
    rows: list[Row] = []
    scales: list[float] = []
    for photo, (result, pictures) in measured:
        views.append(result)
        scales.append(result.width / photo.camera.width)
        if photo.name in on_sheet or not rows:
            figures = (
                f"{WAYS[look]} {score.psnr:.2f} dB" if pictures.look else f"{score.psnr:.2f} dB"
                for look, score in result.scores["photo"].items()
            )
            rows.append(row_of(pictures, ", ".join(figures)))
        if work is not None:
            write_view(work, paths[photo.name], pictures)
    return tuple(views), rows, fmean(scales)
