"""From matches to cameras and points, by COLMAP's incremental mapping;
if most photos are lost, twice more with focal lengths refined last."""

import shutil
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import median

import pycolmap

from core.data.photos.distortion import folds_over
from core.data.placing import focal_length_of, is_usual
from core.data.sfm.features import DATABASE, PHOTOS, SEED, images_in
from core.errors import BadInput
from core.report import Report
from core.system.cores import cores
from core.words import counted

# Up to this many photos one thread maps them, with nearly always the same result; a sixth slower than two (87 photos:
# 21 s).
REPEATABLE = 100
LEAST_PLACED = 3  # photos, unless there are only two: fewer are no scene


def map_photos(work: Path, names: list[str], report: Report) -> pycolmap.Reconstruction:
    """Cameras and points of the photos whose matches are in the database: the model with the most photos.
    BadInput if none has LEAST_PLACED."""
    models = _best_models(work, names, report)
    for model in models:
        _drop_folded(model)
    models = _largest_first(model for model in models if model.num_reg_images())
    placed = models[0].num_reg_images() if models else 0
    if placed < min(LEAST_PLACED, len(names)):
        some = f"Cameras could be found for only {placed} of {len(names)} photos"
        found = some if placed else "No cameras could be found"
        raise BadInput(
            f"{found}: the {len(names)} photos do not overlap enough.",
            "Add photos of the same place from nearby viewpoints, or larger ones.",
        )
    if len(models) > 1:
        sizes = ", ".join(str(part.num_reg_images()) for part in models)
        report.warn(
            f"The photos fall apart into {len(models)} places ({sizes} photos); the largest is kept. "
            "Add photos that connect them, or give each place a folder."
        )
    if folded := sum(not image.has_pose for image in models[0].images.values()):
        report.warn(f"{counted(folded, 'photo')} fit only with an impossible lens and were left out.")
    return models[0]


def _best_models(work: Path, names: list[str], report: Report) -> list[pycolmap.Reconstruction]:
    """COLMAP's models, with focal lengths refined along the way or, if that goes badly, last.

    COLMAP refines focal lengths from the second photo on. A few photos constrain them badly: they diverge, poses
    follow, and other photos cannot be registered (COLMAP drops such cameras only from models of 20 photos or more). So
    if fewer than half the photos are registered with a focal length that lenses have, they are mapped twice more, with
    focal lengths refined only at the end: from those of EXIF or COLMAP's guess, and from those that were found. Of
    these, models are taken whose largest one has more such photos and more points than the first, the best of them
    (core/TRIED.md has the figures).
    """
    models = best = _models(work, names, report)
    largest = _largest(models)
    found, points = _plausible(largest), largest.num_points3D()
    if 2 * len(found) >= len(names):
        return models
    most = (len(found), points)
    for start in ({}, found) if found else ({},):
        again = _models(work, names, report, start)
        largest = _largest(again)
        _refine(largest)
        worth = (len(_plausible(largest)), largest.num_points3D())
        if worth > most and worth[0] > len(found) and worth[1] > points:
            best, most = again, worth
    if best is not models:
        report.say(
            "Mapped again with focal lengths refined last: "
            f"{most[0]} of {len(names)} photos got a place and a focal length that lenses have, "
            f"not {len(found)} as with focal lengths refined along the way."
        )
    return best


def _largest_first(models: Iterable[pycolmap.Reconstruction]) -> list[pycolmap.Reconstruction]:
    return sorted(models, key=lambda model: (model.num_reg_images(), model.num_points3D()), reverse=True)


def _drop_folded(model: pycolmap.Reconstruction) -> None:
    """Take photos out whose lens formula folds over inside them: undistorted, they would become swirls.

    COLMAP finds such lenses where a photo shares few points with others. As a pinhole it fits them no better.
    """
    folded = [image for image in model.images.values() if image.has_pose and folds_over(image.camera)]
    for image in folded:
        model.deregister_frame(image.frame_id)


def _models(
    work: Path, names: list[str], report: Report, start: dict[str, float] | None = None
) -> list[pycolmap.Reconstruction]:
    """COLMAP's models of the matches, the one with the most photos first.

    start: None to refine focal lengths as photos are added. Else they stay as EXIF tells them; without EXIF, as `start`
    has them, over the photo's longer side, or at the median of these; if it is empty, at COLMAP's guess.
    """
    options = pycolmap.IncrementalPipelineOptions()
    options.min_model_size = min(LEAST_PLACED, len(names))  # COLMAP's 10 would refuse small collections
    options.random_seed = SEED
    options.num_threads = options.mapper.num_threads = _threads(len(names))
    options.ba_refine_focal_length = start is None
    folder = Path(tempfile.mkdtemp(prefix="models-", dir=work))
    database = work / DATABASE
    if start:
        database = Path(shutil.copy(database, folder))
        _begin_with(database, start)
    models = pycolmap.incremental_mapping(
        database,
        work / PHOTOS,
        folder,
        options,
        initial_image_pair_callback=_counter(report, len(names), 2),
        next_image_callback=_counter(report, len(names), 3),
    )
    return _largest_first(models.values())


def _begin_with(path: Path, start: dict[str, float]) -> None:
    """Write these focal lengths into the database; see `_models`."""
    usual = median(start.values())
    with pycolmap.Database.open(path) as database:
        for name, image in images_in(database).items():
            camera = database.read_camera(image.camera_id)
            if not camera.has_prior_focal_length:
                camera.focal_length = start.get(name, usual) * max(camera.width, camera.height)
                database.update_camera(camera)


def _largest(models: list[pycolmap.Reconstruction]) -> pycolmap.Reconstruction:
    """The first of the models, or an empty one."""
    return models[0] if models else pycolmap.Reconstruction()


def _refine(model: pycolmap.Reconstruction) -> None:
    """A bundle adjustment of the whole model, focal lengths included."""
    if not model.num_reg_images():
        return
    config = pycolmap.BundleAdjustmentConfig()
    for number in model.reg_image_ids():
        config.add_image(number)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    options.ceres.solver_options.num_threads = _threads(model.num_reg_images())
    # pycolmap.bundle_adjustment would turn COLMAP's log on.
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    model.update_point_3d_errors()


def _threads(photos: int) -> int:
    """How many threads COLMAP may use for this many photos."""
    return 1 if photos <= REPEATABLE else cores()


def _plausible(model: pycolmap.Reconstruction) -> dict[str, float]:
    """The photos of the model that have a pose and a focal length that lenses have: that length, over the longer side,
    by their names."""
    placed = {image.name: image.camera for image in model.images.values() if image.has_pose}
    return {name: focal_length_of(camera) for name, camera in placed.items() if is_usual(camera)}


def _counter(report: Report, total: int, first: int) -> Callable[[], None]:
    """A callback that counts registered photos, which several models may share. first: the number at its first call."""
    placed = first - 1

    def count() -> None:
        nonlocal placed
        if placed < total:
            placed += 1
            report.progress("Cameras", placed, total)

    return count
