"""Points for scenes that have cameras but no points, triangulated once and kept beside the runs."""

from dataclasses import asdict
from pathlib import Path

import pycolmap

from core.data.collection import CHECK_POSES, Collection, Photo
from core.data.formats.colmap import read_points
from core.data.formats.model_file import read_model
from core.data.made import made_once, moved_together, path_from, read_mark, relative_path_to, stamp
from core.data.posed import Points
from core.data.sfm.disk_space import write_model
from core.data.sfm.silhouettes import points_in_silhouettes
from core.data.sfm.triangulate import triangulate
from core.errors import BadInput
from core.report import Report
from core.scene.camera import Camera
from core.system.atomic import replacing_folder, write_json
from core.words import Note, counted

MARK = "triangulated.json"  # in a folder of points: whose they are, what they were made of, and how far the cameras fit
MODEL = "points"  # a COLMAP model of the training photos
# Share of matches that agree with the cameras. Right ones: 34 (plaza) to 95 % (fountain). Poses inverted, in other axes
# or of other photos: at most 18 %.
LEAST_NEAR = 0.2


def points_beside(collection: Collection, transparent_is_empty: bool, wanted: Path, report: Report) -> Path:
    """The folder of the collection's points, which core.data.load reads like the scene itself;
    made now unless it exists.

    transparent_is_empty: whether the space that photos show as transparent is empty. wanted: the name of the folder,
    to which a number is added if it is taken. Points are used again only for the very same training photos, masks and
    cameras. Warns each time if the cameras do not fit the photos. Raises BadInput if no point is found, or nothing can
    be written.
    """
    training = [(photo, photo.camera.in_world(collection.frame)) for photo in collection.split("train")]
    root = collection.root.resolve()
    made_of = {}
    for photo, camera in training:
        mask = [] if photo.mask is None else [path_from(collection.root, photo.mask.path), *stamp(photo.mask.path)]
        made_of[path_from(collection.root, photo.path)] = [
            *stamp(photo.path),
            *camera.numbers(),
            photo.lens and asdict(photo.lens),
            *mask,
        ]
    same = {"kind": collection.kind, "transparent_is_empty": transparent_is_empty, "made_of": made_of}

    def are_there(folder: Path) -> bool:
        return same.items() <= read_mark(folder / MARK).items() and home_of(folder).resolve() == root

    def make(folder: Path) -> None:
        report.say(
            f"{collection.root} has cameras but no points: "
            f"they are triangulated from {counted(len(training), 'photo')}."
        )
        with replacing_folder(folder) as work:
            model, near = triangulate(training, work, report)
            if transparent_is_empty:
                _fill_silhouettes(model, training, report)
            if not model.num_points3D():
                what = f"No point could be triangulated from the photos and cameras of {collection.root}"
                raise BadInput(f"{what}.", CHECK_POSES)
            (work / "scene" / MODEL).mkdir(parents=True)
            write_model(model, work / "scene" / MODEL)
            write_json(
                work / "scene" / MARK,
                {"scene": str(root), "from_here": relative_path_to(root, folder), "near": near, **same},
            )
        report.say(f"{folder}: {counted(model.num_points3D(), 'point')}")

    points = made_once(wanted, MARK, are_there, make, "Points as triangulated", report)
    near = read_mark(points / MARK).get("near")
    if isinstance(near, float) and near < LEAST_NEAR:
        report.warn(
            f"Only {near:.0%} of the matches between photos agree with the cameras of the scene: "
            f"expect a poor one. {CHECK_POSES}"
        )
    return points


def _fill_silhouettes(model: pycolmap.Reconstruction, posed: list[tuple[Photo, Camera]], report: Report) -> None:
    """Add points to those triangulated: what is smooth has none, and Gaussians far from all points are removed."""
    positions, colours = points_in_silhouettes(posed, report)
    if len(positions):
        report.say(
            f"{counted(len(positions), 'point')} at random added to {model.num_points3D():,} triangulated, "
            "where no photo shows empty space"
        )
    for position, colour in zip(positions, colours, strict=True):
        model.add_point3D(position, pycolmap.Track(), colour)


def scene_of(folder: Path) -> tuple[Path, str] | None:
    """The scene whose points the folder holds, and its kind; None if the folder holds anything else."""
    facts = read_mark(folder / MARK)
    if not {"scene", "kind", "made_of"} <= facts.keys():
        return None
    scene = moved_together(Path(str(facts["scene"])), facts.get("from_here"), folder, facts["made_of"])
    return scene, str(facts["kind"])


def home_of(root: Path) -> Path:
    """The scene's own folder: `root` or, if that holds triangulated points, the scene that they belong to."""
    scene, _ = scene_of(root) or (root, None)
    return scene


def read_kept(folder: Path) -> tuple[Points, list[Note]]:
    """The points, and notes on them; BadInput for a model that is damaged or has no points."""
    points, notes = read_points(read_model(folder / MODEL), folder / MODEL)
    if points is None:
        raise BadInput(f"{folder / MODEL} holds no points any more.", f"Remove {folder} to have them found again.")
    return points, notes
