"""The table of the PhotoTourism layout, which says which photos are for training and which for testing: SCENE/NAME.tsv,
or nerfw_split.csv, as nerfbaselines calls it."""

import codecs
import csv
from dataclasses import dataclass
from pathlib import Path

from core.errors import BadInput

COLUMNS = {"filename", "id", "split"}
NO_ID = ("", "nan")  # pandas writes either
SPLITS = ("train", "test")
TABLES = ("*.tsv", "nerfw_split.csv")  # in any letters


@dataclass(frozen=True)
class SplitTable:
    """The rows of a split .tsv.

    splits: photo name -> "train" or "test". without_id, unknown_split: names of photos all of whose rows are unusable
    for that reason. contradicted: those in both splits, which are held out.
    """

    splits: dict[str, str]
    without_id: tuple[str, ...]
    unknown_split: tuple[str, ...]
    contradicted: tuple[str, ...]


def list_files(folder: Path) -> list[Path]:
    """The files in a folder, if it is one, by name, without hidden ones."""
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))


def find_tables(*folders: Path) -> tuple[list[Path], list[Path]]:
    """The TABLES in the folders, in their order and by name: those that hold a split, and others.

    The first line of a split names its COLUMNS. If no file has all of them, those with a column of file names count as
    splits, so that reading one reports what it lacks.
    """
    paths = [
        path
        for folder in folders
        for path in list_files(folder)
        if any(Path(path.name.lower()).match(pattern) for pattern in TABLES)
    ]
    columns = {path: columns_of(path) for path in paths}
    splits = [path for path in paths if columns[path] >= COLUMNS] or [
        path for path in paths if "filename" in columns[path]
    ]
    return splits, [path for path in paths if path not in splits]


def encoding_of(path: Path) -> str:
    """The encoding of a table or list: UTF-8, or UTF-16 if it begins with the
    byte-order mark that Windows programs write."""
    with open(path, "rb") as file:
        return "utf-16" if file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig"


def columns_of(path: Path) -> set[str]:
    """The columns that the first line of a table names."""
    with open(path, encoding=encoding_of(path), errors="replace") as file:
        line = file.readline().replace("\0", "")
    try:
        return set(next(csv.reader([line], delimiter="\t"), []))
    except csv.Error:  # a line longer than csv allows
        return set()


def read_split_table(path: Path) -> SplitTable:
    """Read filename, id and split; other columns are ignored.

    Ids (floats in the official files) matter only in that a row without one is not used, as in NeRF-W's reader. Raises
    BadInput for a file without these columns.
    """
    fix = "Remove it, or give it the tab-separated columns filename, id and split."
    try:
        with open(path, encoding=encoding_of(path), newline="") as file:
            rows = list(csv.DictReader(file, delimiter="\t", strict=True))
    except UnicodeDecodeError as problem:
        raise BadInput(f"{path} is not in {problem.encoding.upper()}.", "Save it as UTF-8, or remove it.") from None
    except csv.Error as problem:  # such as a quotation mark that nothing closes
        raise BadInput(f"{path} cannot be read as a table: {problem}.", fix) from None
    if not rows:
        raise BadInput(f"{path} names no photos.", "Remove it, or write a line for each photo.")
    if not COLUMNS <= set(rows[0]):
        raise BadInput(f"{path} is not a split table.", fix)
    named: dict[str, set[str]] = {split: set() for split in SPLITS}
    without_id, unknown_split = set(), set()
    for row in rows:
        name, number, split = ((row[column] or "").strip() for column in ("filename", "id", "split"))
        if not name:
            continue
        if number.lower() in NO_ID:
            without_id.add(name)
        elif split.lower() not in SPLITS:
            unknown_split.add(name)
        else:
            named[split.lower()].add(name)
    train, test = (named[split] for split in SPLITS)
    splits = dict.fromkeys(train, "train") | dict.fromkeys(test, "test")
    unused = without_id - splits.keys(), unknown_split - splits.keys()
    return SplitTable(splits, *(tuple(sorted(names)) for names in (*unused, train & test)))
