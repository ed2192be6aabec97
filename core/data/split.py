"""Which photos are held out for testing: as a .tsv or a list says, or else every eighth."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from core.data.made import digest, read_mark
from core.data.photos.names import rows_that_mean
from core.data.split_table import COLUMNS, columns_of, encoding_of, find_tables, list_files, read_split_table
from core.system.atomic import write_bytes, write_json
from core.words import Note, list_names, name_them

EVERY = 8  # as in the original 3DGS and everything compared with it
# The original 3DGS's; nerfbaselines', beside which a TRAINING_LIST says what is trained on.
TEST_LISTS = ("test.txt", "test_list.txt")
TRAINING_LIST = "train_list.txt"
COMMENT = "# "  # begins a line of any of these lists that names no photo
# In a scene made of plain photos: the lists that were copied into it, each with the hash of its content.
COPIED = "lists.json"


class Split(NamedTuple):
    """of_photo: "train" or "test" by the names of photos; those in neither are left out. source: what says so."""

    of_photo: dict[str, str]
    notes: list[Note]
    source: Path


def split_photos(root: Path, model: Path, names: list[str], in_model: set[str]) -> Split:
    """The split of the usable photos, as a file says; if none does, every eighth is held out, and `model` the source.

    A .tsv or one of TEST_LISTS, in upper or lower case, is looked for in `root`, in the folder `model` (as in the
    original 3DGS) and in those between them, such as dense/. names: the usable photos, sorted. in_model: all photos of
    the model, so that a list is not called wrong for naming one whose file is merely missing. Raises BadInput for a
    table that cannot be read.
    """
    places = dict.fromkeys((root, model, *(folder for folder in model.parents if root in folder.parents)))
    tables, others = find_tables(*places)
    unlike = f"holds no split, not used: its first line does not name {', '.join(sorted(COLUMNS))}, tab-separated."
    no_splits = [Note(f"{path.name} {unlike}") for path in others]
    lists = [path for folder in places for path in _find(folder, *TEST_LISTS)]
    if not tables and not lists:
        of_photo, notes = _every_eighth(root, names)
        return Split(of_photo, notes + no_splits, model)
    source = (tables or lists)[0]
    of_photo, notes = (_by_table if tables else _by_list)(source, names, in_model)
    if len(tables) > 1:
        unused = list_names([path.name for path in tables[1:]])
        notes.append(Note(f"Several split tables: {source.name} is used, {unused} not."))
    notes += none_held_out(of_photo, f"{source.name} holds out none of these photos")
    return Split(of_photo, notes + no_splits, source)


def none_held_out(splits: dict[str, str], why: str) -> list[Note]:
    """A note if there are photos to train on but none to test on. why: in words."""
    lacking = "train" in splits.values() and "test" not in splits.values()
    return [Note(f"{why}: quality on unseen photos cannot be measured.")] if lacking else []


def copy_lists(folders: Iterable[Path], scene: Path) -> None:
    """Copy the split tables and the test list in the folders of plain photos into the scene made of these,
    where they are looked for.

    Of two with the same name the last is copied. What was copied earlier and is gone from the folders is removed from
    the scene, too, unless it was changed there.
    """
    found = {path.name: path for folder in folders for path in _lists_in(folder)}
    copied = read_mark(scene / COPIED)
    for name in copied.keys() - found.keys():
        if (copy := scene / Path(name).name).is_file() and digest(copy) == copied[name]:
            copy.unlink()
    digests = {name: digest(path) for name, path in found.items()}
    for name, path in found.items():
        if not (scene / name).is_file() or digest(scene / name) != digests[name]:
            write_bytes(scene / name, path.read_bytes())
    if digests != copied:
        write_json(scene / COPIED, digests)


def _lists_in(folder: Path) -> list[Path]:
    """The split tables and the test list in a folder; other tables may be about anything."""
    tables = [path for path in find_tables(folder)[0] if columns_of(path) >= COLUMNS]
    return [*tables, *_find(folder, *TEST_LISTS, TRAINING_LIST)]


def _find(folder: Path, *names: str) -> list[Path]:
    """The files in a folder that have these names, in upper or lower case, in the order of the names."""
    files = list_files(folder)
    return [path for name in names for path in files if path.name.lower() == name]


def in_both(train: str, test: str, names: Iterable[str]) -> list[Note]:
    """A note that names photos in the lists for training and for testing; they are held out.
    train, test: what the lists are called."""
    return name_them(f"in both {train} and {test}, held out", sorted(names), of_split=True)


def _lists_without_effect(root: Path) -> list[Note]:
    """Notes on tables and lists that are not used:
    they lie in another folder, or lack the list that belongs to them."""
    notes = []
    if root.name == "dense" and (tables := find_tables(root.parent)[0]):
        notes.append(
            Note(f"{tables[0]} is not used: give the folder it is in, {root.parent}, to split by it.", of_split=True)
        )
    if _find(root, TRAINING_LIST):
        notes.append(Note(f"{TRAINING_LIST} is not used: there is no {TEST_LISTS[1]} beside it.", of_split=True))
    return notes


def _every_eighth(root: Path, names: list[str]) -> tuple[dict[str, str], list[Note]]:
    if len(names) == 1:
        return {names[0]: "train"}, [Note("One photo: none is held out for testing.", harmless=True)]
    every = (
        f"No split .tsv and no {TEST_LISTS[0]}: every {EVERY}th photo by name is held out for testing; "
        "`--all-photos` trains on all."
    )
    notes = [Note(every, harmless=True, of_split=True), *_lists_without_effect(root.resolve())]
    return {name: "test" if index % EVERY == 0 else "train" for index, name in enumerate(names)}, notes


def _by_table(path: Path, names: list[str], in_model: set[str]) -> tuple[dict[str, str], list[Note]]:
    table = read_split_table(path)
    listed = set(table.splits) | set(table.without_id) | set(table.unknown_split)
    rows, odd = _rows_in(path, in_model.union(names), listed)
    splits = {name: table.splits[rows[name]] for name in names if rows.get(name) in table.splits}
    odd_rows = {"without an id, not used": table.without_id, "in neither train nor test, not used": table.unknown_split}
    notes = []
    for what, those in odd_rows.items():
        notes += name_them(f"of {path.name} {what}", [name for name in names if rows.get(name) in those])
    notes += in_both("train", f"test of {path.name}", [name for name in names if rows.get(name) in table.contradicted])
    notes += odd + name_them(f"not in {path.name}, not used", [name for name in names if name not in rows])
    return splits, notes


def _by_list(path: Path, names: list[str], in_model: set[str]) -> tuple[dict[str, str], list[Note]]:
    held_out, notes = _rows_in(path, in_model.union(names), _lines_of(path))
    training = next(iter(_find(path.parent, TRAINING_LIST)), None)
    if path.name.lower() != TEST_LISTS[1] or training is None:
        return {name: "test" if name in held_out else "train" for name in names}, notes
    trained, more = _rows_in(training, in_model.union(names), _lines_of(training))
    listed = held_out.keys() | trained.keys()
    notes += more + in_both(training.name, path.name, held_out.keys() & trained.keys())
    notes += name_them(
        f"neither in {path.name} nor in {training.name}, not used", [name for name in names if name not in listed]
    )
    return {name: "test" if name in held_out else "train" for name in names if name in listed}, notes


def _lines_of(path: Path) -> set[str]:
    lines = map(str.strip, path.read_text(encoding=encoding_of(path), errors="replace").splitlines())
    return {line for line in lines if line and not line.startswith(COMMENT)}


def _rows_in(path: Path, names: Iterable[str], listed: set[str]) -> tuple[dict[str, str], list[Note]]:
    """As `rows_that_mean`, for the list in the file `path`; and notes on the rows that are of no use."""
    rows, unclear = rows_that_mean(names, listed)
    several = [f"{row} ({list_names(fitting)})" for row, fitting in sorted(unclear.items())]
    notes = name_them(f"of {path.name} not in the model", sorted(listed - set(rows.values()) - unclear.keys()))
    return rows, notes + name_them(f"of {path.name} whose name fits several of the model, not used", several)
