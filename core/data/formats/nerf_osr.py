"""NeRF-OSR folders, SITE/final/{train,validation,test}/{rgb,pose,intrinsics,mask},
and those of NeRF++, of the same layout.

Source: the README and data reader of github.com/r00tman/NeRF-OSR (Rudnev et al. 2022), and nerfstudio's parser of the
same data: text files of 16 numbers; pose leads from camera to world, with OpenCV axes; intrinsics are in px of the
photo; masks are white where nothing moves.
"""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap

from core.data.photos.folder import list_photos
from core.data.posed import Fault, Posed, PosedPhoto, from_camera_to_world, in_utf_8
from core.errors import BadInput
from core.words import Note, Reasons, name_them

FOLDERS = ("final", "final_clean", ".")  # the second is that of its Trevi fountain, the third NeRF++'s
TRAINING, HELD_OUT = "train", ("test", "validation")  # of the latter, the first that has photos
LARGEST_SKEW = 1e-3  # of the focal length; a pinhole has none


def find_nerf_osr(root: Path) -> Path | None:
    """The folder of the splits in or below `root`, or None."""
    folders = (root / name for name in FOLDERS)
    return next((folder for folder in folders if (folder / TRAINING / "pose").is_dir()), None)


def read_nerf_osr(root: Path) -> Posed:
    """What the folders of `root` say: train/ is trained on; test/ is held out, or validation/ if test/ has no photos.

    Text files and masks have the stem of their photo, also in subfolders; that of a mask may be the whole name
    (a.jpg.png). Raises BadInput if train/ has no photos.
    """
    source = find_nerf_osr(root)
    if source is None:
        raise BadInput(f"{root} has no folder {TRAINING}/pose any more.", "Put it back.")
    fix = f"Put photos into {source / TRAINING / 'rgb'}, and their pose and intrinsics beside them."
    photos = {split: _pictures(source / split / "rgb") for split in (TRAINING, *HELD_OUT)}
    if not photos[TRAINING]:
        raise BadInput(f"{source / TRAINING / 'rgb'} holds no photos.", fix)
    held_out = next((split for split in HELD_OUT if photos[split]), None)
    unused = [split for split in HELD_OUT if photos[split] and split != held_out]
    notes = [Note(f"{split}/ is not used: {held_out}/ is what is held out.", harmless=True) for split in unused]
    for split, found in photos.items():
        if split not in unused:
            notes += name_them(
                f"with a pose missing in {source / split / 'rgb'}", _without_photo(source / split / "pose", found)
            )
    roles = {TRAINING: "train", held_out: "test"} if held_out else {TRAINING: None}
    used = [(split, relative) for split in roles for relative in photos[split]]
    several = len({relative for _, relative in used}) < len(used)
    posed, faults = [], Reasons()
    masks = {
        split: {
            relative.with_suffix(""): source / split / "mask" / relative
            for relative in _pictures(source / split / "mask")
        }
        for split in photos
    }
    for split, relative in used:
        name = f"{split}/{relative.as_posix()}" if several else relative.as_posix()
        if not in_utf_8(name):
            faults.add("whose name is not in UTF-8, not used", name)
            continue
        try:
            lens = _lens(_matrix(source / split / "intrinsics", relative))
            rotation, centre = from_camera_to_world(_matrix(source / split / "pose", relative), "a pose")
        except Fault as fault:
            faults.add(f"{fault}, not used", name)
            continue
        mask = masks[split].get(relative.with_suffix("")) or masks[split].get(relative)
        posed.append(PosedPhoto(name, source / split / "rgb" / relative, lens, rotation, centre, roles[split], mask))
    if masks[TRAINING] and not any(photo.mask for photo in posed if photo.split != "test"):
        notes.append(Note(f"No mask in {source / TRAINING / 'mask'} has the name of a training photo: none is used."))
    return Posed("nerf-osr", source, posed, None, f"missing in {source}", fix, notes + faults.notes())


def _pictures(folder: Path) -> list[Path]:
    """The pictures in the folder and its subfolders, as relative paths; none if there is no such folder."""
    folders = sorted(Path(path) for path, _, _ in os.walk(folder))
    return [path.relative_to(folder) for each in folders for path in list_photos(each)]


def _without_photo(poses: Path, photos: list[Path]) -> list[str]:
    """The stems, with their subfolders, of the text files in the folder `poses` that belong to none of the photos."""
    given = {path.relative_to(poses).with_suffix("") for path in poses.rglob("*.txt") if not path.name.startswith(".")}
    return sorted(path.as_posix() for path in given - {relative.with_suffix("") for relative in photos})


def _matrix(folder: Path, relative: Path) -> np.ndarray:
    """The (4, 4) matrix in the text file of the photo with this relative path; Fault if it holds none."""
    path = folder / relative.with_suffix(".txt")
    try:
        numbers = np.array(path.read_text(encoding="utf-8-sig").split(), dtype=np.float64)
    except OSError:
        raise Fault(f"without a text file in {folder.name}/") from None
    except ValueError:
        numbers = np.zeros(0)
    if numbers.size != 16:
        raise Fault(f"whose text file in {folder.name}/ does not hold 16 numbers")
    return numbers.reshape(4, 4)


def _lens(matrix: np.ndarray) -> Callable[[int, int], pycolmap.Camera]:
    """The pinhole of an intrinsics matrix, for PosedPhoto.lens."""
    fx, skew, cx = matrix[0, :3]
    fy, cy = matrix[1, 1:3]
    if not abs(skew) <= LARGEST_SKEW * abs(fx):
        raise Fault("with intrinsics whose skew is not 0")
    return lambda width, height: pycolmap.Camera(model="PINHOLE", width=width, height=height, params=[fx, fy, cx, cy])
