"""From matches to cameras and points, by COLMAP's incremental mapping;
if most photos are lost, again with focal lengths refined last."""

from collections.abc import Callable, Iterable
from pathlib import Path

import pycolmap

from core.data.photos.distortion import folds_over
from core.data.placing import is_usual
from core.data.sfm.features import DATABASE, PHOTOS, SEED
from core.errors import BadInput
from core.report import Report
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
    if fewer than half the photos are registered with a focal length that lenses have, they are mapped again with the
    focal lengths of EXIF, or COLMAP's guess, refined only at the end. Those models are taken if the largest has more
    such photos, and more points (core/TRIED.md has the figures).
    """
    models = _models(work, names, report, refined=True)
    largest = _largest(models)
    found = _plausible(largest)
    if 2 * found >= len(names):
        return models
    again = _models(work, names, report, refined=False)
    largest_again = _largest(again)
    _refine(largest_again)
    plausible = _plausible(largest_again)
    if plausible <= found or largest_again.num_points3D() <= largest.num_points3D():
        return models
    report.say(
        "Mapped again with focal lengths refined last: "
        f"{plausible} of {len(names)} photos got a place and a focal length that lenses have, "
        f"not {found} as with focal lengths refined along the way."
    )
    return again


def _largest_first(models: Iterable[pycolmap.Reconstruction]) -> list[pycolmap.Reconstruction]:
    return sorted(models, key=lambda model: (model.num_reg_images(), model.num_points3D()), reverse=True)


def _drop_folded(model: pycolmap.Reconstruction) -> None:
    """Take photos out whose lens formula folds over inside them: undistorted, they would become swirls.

    COLMAP finds such lenses where a photo shares few points with others. As a pinhole it fits them no better.
    """
    folded = [image for image in model.images.values() if image.has_pose and folds_over(image.camera)]
    for image in folded:
        model.deregister_frame(image.frame_id)


def _models(work: Path, names: list[str], report: Report, refined: bool) -> list[pycolmap.Reconstruction]:
    """COLMAP's models of the matches, the one with the most photos first.
    refined: whether focal lengths are refined as photos are added."""
    options = pycolmap.IncrementalPipelineOptions()
    options.min_model_size = min(LEAST_PLACED, len(names))  # COLMAP's 10 would refuse small collections
    options.random_seed = SEED
    options.num_threads = options.mapper.num_threads = _threads(len(names))
    options.ba_refine_focal_length = refined
    folder = work / ("models" if refined else "models-again")
    folder.mkdir()
    models = pycolmap.incremental_mapping(
        work / DATABASE,
        work / PHOTOS,
        folder,
        options,
        initial_image_pair_callback=_counter(report, len(names), 2),
        next_image_callback=_counter(report, len(names), 3),
    )
    return _largest_first(models.values())


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
    """How many threads COLMAP may use for this many photos; -1: one a core."""
    return 1 if photos <= REPEATABLE else -1


def _plausible(model: pycolmap.Reconstruction) -> int:
    """How many photos of the model have a pose, and a focal length that lenses have."""
    return sum(is_usual(image.camera) for image in model.images.values() if image.has_pose)


def _counter(report: Report, total: int, first: int) -> Callable[[], None]:
    """A callback that counts registered photos, which several models may share. first: the number at its first call."""
    placed = first - 1

    def count() -> None:
        nonlocal placed
        if placed < total:
            placed += 1
            report.progress("Cameras", placed, total)

    return count
