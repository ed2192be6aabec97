"""Landmarks, by which photos from outside are located:
SIFT features of a collection's photos, with the SfM points that they show."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from core.data.collection import Collection, Photo, spread_over
from core.data.formats.model_file import quiet
from core.data.sfm.features import DATABASE, MASKS, extract, images_in, write_pictures
from core.report import Report
from core.scene.frame import SceneFrame
from core.system.atomic import replacing, scratch

FILE = "landmarks.npz"  # in a run folder
MOST_PHOTOS = 40  # of the collection, at most
NEAR_PX = 2.0  # from a feature to the projection of the point that it shows; features are hardly more exact
LENGTH = 128  # numbers of a SIFT descriptor
NO_POINT = -1


@dataclass(frozen=True)
class Landmarks:
    """The features of all photos, one photo after the other.

    descriptors: (n, 128) uint8, as COLMAP has them. shows: (n,) int64, which row of `points` each feature shows, or
    NO_POINT. counts: (photos,) int64, how many features each photo has. points: (p, 3) float64, scene frame.
    """

    descriptors: np.ndarray
    shows: np.ndarray
    counts: np.ndarray
    points: np.ndarray

    def in_frame(self, own: SceneFrame, other: SceneFrame) -> "Landmarks":
        """The same, moved from the scene frame `own` to another frame of the same world."""
        return replace(self, points=other.to_scene(own.to_world(self.points)))

    def save(self, path: Path, run: str) -> None:
        """Write them as .npz, whole or not at all; raises as `core.system.atomic.replacing`.
        run: the identity of the run whose frame they are in."""
        with replacing(path) as temporary:
            np.savez(temporary, run=run, **vars(self))

    @staticmethod
    def load(path: Path, run: str) -> "Landmarks | None":
        """The inverse of `save`; None if there is no such file, or it is damaged or of another run."""
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                if arrays["run"] != run:
                    return None
                return Landmarks(**{field.name: arrays[field.name] for field in fields(Landmarks)})
        except (OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, BadZipFile):
            return None


def known_photos(collection: Collection) -> Sequence[Photo]:
    """Up to MOST_PHOTOS training photos that see SfM points, spread over the collection."""
    return spread_over([photo for photo in collection.split("train") if len(photo.points)], MOST_PHOTOS)


def landmarks_of(collection: Collection, report: Report) -> Landmarks:
    """The landmarks of its `known_photos`; undecodable ones are left out."""
    known = known_photos(collection)
    descriptors, shows = [np.zeros((0, LENGTH), np.uint8)], [np.zeros(0, np.int64)]
    with scratch("landmarks") as work, quiet():
        pictures = write_pictures([(photo, photo.camera) for photo in known], work, report)
        extract(work, list(pictures), report, work / MASKS)
        with pycolmap.Database.open(work / DATABASE) as database:
            images = images_in(database)
            for name, (photo, camera) in pictures.items():
                number = images[name].image_id
                seen, _ = camera.project(collection.points[photo.points])
                descriptors.append(database.read_descriptors(number).data)
                # If no point is near, the tree returns the number of points: the index of the NO_POINT appended here.
                _, nearest = cKDTree(seen).query(database.read_keypoints(number)[:, :2], distance_upper_bound=NEAR_PX)
                shows.append(np.append(photo.points, NO_POINT)[nearest])
    counts = np.array([len(each) for each in shows[1:]], dtype=np.int64)
    return Landmarks(np.concatenate(descriptors), np.concatenate(shows), counts, collection.points)
