"""What a scene that wegs made of plain photos remembers of them:
the files, what the scene calls them, and their lenses."""

from pathlib import Path

from core.data.made import MADE_OF, read_mark, stamp
from core.data.photos.distortion import colmap_camera, stated_lens
from core.data.photos.folder import list_photos
from core.data.placing import is_usual
from core.scene.lens import Lens

# In the scene's folder, beside MADE_OF, which holds the files it was made of, each with its stamp:
NAMES = "names.json"  # what it calls the photo of each file that could be read
LENSES = "lenses.json"  # the lens through which each of its photos was taken, before it was undistorted


def files_of(photos: Path) -> dict[str, list[int]]:
    """The photos in a folder, by whole path, each with the stamp that tells whether it has changed."""
    return {str(path.resolve()): stamp(path) for path in list_photos(photos)}


def name_in(scene: Path, path: Path) -> str | None:
    """What the scene calls the photo made of the file `path`, which may have been moved since;
    None for other files, and for changed ones."""
    known, original = read_mark(scene / MADE_OF), str(path.resolve())
    if original not in known:
        moved = [file for file in known if Path(file).name == path.name and not Path(file).exists()]
        original = moved[0] if len(moved) == 1 else original
    return read_mark(scene / NAMES).get(original) if known.get(original) == stamp(path) else None


def is_made_of(scene: Path, files: dict[str, list[int]]) -> bool:
    """Whether the scene was made of these very files (`files_of`):
    the same names, sizes and modification times, wherever they were then."""
    made_of, found = (
        [(Path(path).name, mark) for path, mark in each.items()] for each in (read_mark(scene / MADE_OF), files)
    )
    return bool(found) and made_of == found  # in their order: two links may lead to files of one name


def lenses_of(scene: Path) -> dict[str, Lens]:
    """The lenses through which the photos were taken, by the scene's names;
    empty for a scene that wegs did not make."""
    found = read_mark(scene / LENSES) if (scene / MADE_OF).is_file() else {}
    lenses = {name: stated_lens(facts) for name, facts in found.items()}
    return {name: lens for name, lens in lenses.items() if lens is not None}


def placed_of(scene: Path) -> tuple[int, int, int] | None:
    """How many photos the scene was made of, how many of these got a camera,
    and how many of those with a focal length that lenses have.

    None for a scene that wegs did not make.
    """
    total, lenses = len(read_mark(scene / NAMES)), lenses_of(scene)
    if not total or not lenses:
        return None
    return total, len(lenses), sum(is_usual(colmap_camera(lens)) for lens in lenses.values())


def left_out(scene: Path) -> list[Path]:
    """The files of a scene's photos that are not in it: not placed, unreadable, or copies of others;
    none for a scene that wegs did not make."""
    names, placed = read_mark(scene / NAMES), lenses_of(scene)
    return [Path(path) for path in read_mark(scene / MADE_OF) if names and names.get(path) not in placed]


def shortfall(scene: Path) -> str:
    """A warning if the scene lost most of the photos it was made of, else nothing."""
    total, placed, plausible = placed_of(scene) or (0, 0, 0)
    if 2 * plausible >= total:
        return ""
    but = f", and {placed - plausible} of these with a focal length that no lens has" if placed > plausible else ""
    return f"Only {placed} of {total} photos could be placed{but}: expect a poor scene. Add photos from in between."
