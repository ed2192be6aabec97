"""The table in tests/README.md names tests and scenes that exist."""

import re
from pathlib import Path

import pytest

from tests.rasterizer.scenes import SCENES

HERE = Path(__file__).parent
TEXT = (HERE / "README.md").read_text(encoding="utf-8")
SOURCES = {
    path.relative_to(HERE).with_suffix("").as_posix(): path.read_text(encoding="utf-8")
    for path in HERE.rglob("test_*.py")
}
ROWS = re.findall(r"^\| (\d[\d, ]*) \|(.*)", TEXT, re.MULTILINE)


def missing(row: str) -> list[str]:
    """What a row names in backticks and nobody has written; three dots stand for the rest of a name."""
    words, gone = re.findall(r"`([^`]+)`", row.partition("|")[2]), []
    for word in words:
        file, _, name = word.rpartition("::")
        name, begun = name.removesuffix("..."), word.endswith("...")
        if not name.startswith("test_") and "/" not in name:
            found = name in SCENES
        elif not file and ("/" in word or word in {Path(path).name for path in SOURCES}):
            found = any(path.endswith(word) for path in SOURCES)
        else:
            texts = [text for path, text in SOURCES.items() if path.endswith(file)]
            found = any(re.search(rf"def {name}{'' if begun else '[(]'}", text) for text in texts)
        if not found:
            gone.append(word)
    return gone


def test_every_row_of_the_list_is_there():
    numbers = [int(number) for row, _ in ROWS for number in row.split(",")]
    assert numbers == list(range(1, 22))


@pytest.mark.parametrize("number, row", ROWS)
def test_what_a_row_names_exists(number, row):
    assert missing(row) == []


def test_a_name_that_does_not_exist_is_found():
    assert missing("case | scene `needles`, `no_such_scene`; `test_reference::test_nothing`; `data/test_none`") == [
        "no_such_scene",
        "test_reference::test_nothing",
        "data/test_none",
    ]
