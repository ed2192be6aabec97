"""Which photos are held out for testing: as a .tsv says, or test.txt, or else every eighth."""

from pathlib import Path

from core.data.phototourism import find_split_tables, read_split_table
from core.errors import BadInput
from core.words import list_names, name_them

EVERY = 8  # of the original 3DGS and of everything compared with it
TEST_LIST = "test.txt"


def split_photos(root: Path, model: Path, names: list[str], in_model: set[str]) -> tuple[dict[str, str], list[str]]:
    """The split of each usable photo ("train" or "test"; photos that are in none are left out), and notes.

    A .tsv lies in `root`, a test.txt there or, as for the original 3DGS, in the folder `model` (cameras may be in a file).
    names: the usable photos, sorted. in_model: all photos that the model knows, usable or not, so that a list naming a
    photo that is merely missing is not called wrong. Raises BadInput where nothing is left to train on.
    """
    tables = find_split_tables(root)
    lists = [path for folder in (root, model) if (path := folder / TEST_LIST).is_file()]
    if tables:
        splits, notes = _by_table(tables[0], names, in_model)
        if len(tables) > 1:
            notes.append(
                f"Several .tsv files: {tables[0].name} is used, {list_names([path.name for path in tables[1:]])} not."
            )
        source = tables[0]
    elif lists:
        splits, notes = _by_list(lists[0], names, in_model)
        source = lists[0]
    elif len(names) == 1:
        return {names[0]: "train"}, ["One photo: none is held out for testing."]
    else:
        splits = {name: "test" if index % EVERY == 0 else "train" for index, name in enumerate(names)}
        return splits, [f"No split .tsv and no {TEST_LIST}: every {EVERY}th photo by name is held out for testing."]
    if "train" not in splits.values():
        why = f": {'; '.join(notes)}" if notes else ""
        raise BadInput(f"{source} leaves no photo of this model to train on{why}.", f"Correct or remove {source.name}.")
    if "test" not in splits.values():
        notes.append(f"{source.name} holds out none of these photos: quality on unseen photos cannot be measured.")
    return splits, notes


def _by_table(path: Path, names: list[str], in_model: set[str]) -> tuple[dict[str, str], list[str]]:
    table = read_split_table(path)
    listed = table.splits.keys() | set(table.without_id) | set(table.unknown_split)
    known = in_model | {_short(name) for name in in_model}
    splits = {name: _look_up(table.splits, name) for name in names}
    notes = name_them(f"of {path.name} without an id, not used", _present(table.without_id, names))
    notes += name_them(f"of {path.name} in neither train nor test, not used", _present(table.unknown_split, names))
    notes += name_them(f"of {path.name} not in the model", sorted(listed - known))
    notes += name_them(f"not in {path.name}, not used", [name for name in names if not {name, _short(name)} & listed])
    return {name: split for name, split in splits.items() if split}, notes


def _by_list(path: Path, names: list[str], in_model: set[str]) -> tuple[dict[str, str], list[str]]:
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    listed = {line.strip() for line in lines if line.strip()}
    known = in_model | {_short(name) for name in in_model}
    splits = {name: "test" if {name, _short(name)} & listed else "train" for name in names}
    return splits, name_them(f"of {path.name} not in the model", sorted(listed - known))


def _short(name: str) -> str:
    return name.rsplit("/", 1)[-1]


def _look_up(splits: dict[str, str], name: str) -> str | None:
    return splits.get(name) or splits.get(_short(name))


def _present(listed: tuple[str, ...], names: list[str]) -> list[str]:
    return [name for name in names if {name, _short(name)} & set(listed)]
