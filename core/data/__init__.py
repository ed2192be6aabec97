"""Photo collections: whichever kind is found on disk becomes a Collection, and its photos become pixels.

From a folder to a Collection: `load` finds out the kind; `formats` reads what its files say into a Posed (`posed`);
`collect` turns that into a Collection (`collection`). `placing` fits cameras to the photos, `split` and `split_table`
say what is held out, `found_file` finds misnamed photos, `given_masks` adds masks, `transparency` says what transparent
pixels mean.

What a scene lacks for training is made by `prepare`, with `sfm`: cameras by `reconstruct` (`usable`, `features`,
`likely_pairs`, `guided`, `mapping`, `upright`; `kept_matches` lets a stopped search continue; `originals` remembers the
photos as they were), points by `kept_points` with `triangulate` and `silhouettes`; `disk_space` checks that there is
room. `made` recognises what was made before. `pose` tells the camera of a photo from points that it shows.

From a photo to pixels, in `photos`: `folder` lists files, `names` says what else they may be called, `lookalikes` finds
files of the same picture, `file` reads headers, `stored` decodes, `pixels` turns, undistorts (`distortion`) and fills
holes (`fill`). `pycolmap_loaded` keeps that library from handling signals.
"""

import core.data.pycolmap_loaded  # noqa: F401 - before anything imports pycolmap
from core.data.collection import Collection, Photo
from core.data.load import find_kind, find_photos, load_collection

__all__ = ["Collection", "Photo", "find_kind", "find_photos", "load_collection"]
