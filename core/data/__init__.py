"""Photo collections: whichever kind is found on disk becomes a Collection, and its photos become pixels.

From a folder to a Collection: `load` finds out the kind; `colmap`, `transforms` or `nerf_osr` reads what its files say into a Posed;
`posed` makes the Collection of that. `placing` fits cameras to the photos (`lens`), `split` and `phototourism` say what is held out,
`found_file` finds misnamed photos, `given_masks` adds masks; `model_file` and `point_file` read files of points and poses.

What a scene lacks for training is made by `prepare`: cameras by `found_cameras` with `sfm` (`features`, `likely_pairs`, `mapping`;
`sfm_record` remembers the original photos), points by `kept_points` with `triangulate`. `made` recognises what was made before.

From a photo to pixels: `photo_folder` lists files, `photo_file` reads headers, `photos` decodes, undistorts (`lens`) and fills holes
(`fill`). A photo from outside is found by `locate` among the `landmarks` of a collection.
"""

from core.data.collection import Collection, Photo
from core.data.load import find_kind, find_photos, load_collection

__all__ = ["Collection", "Photo", "find_kind", "find_photos", "load_collection"]
