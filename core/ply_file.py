"""A .ply as a table of rows, by plyfile; its faults in one line.

The only module that imports plyfile, whose licence is GPL-3.
"""

import io
import re
import warnings
from pathlib import Path

import numpy as np
import plyfile

from core.errors import BadInput

HEADER_BYTES = 1 << 16  # no header is longer
IN_ASCII = bytes(range(128)) + b"?" * 128  # what each byte is read as


class _Opened(io.FileIO):
    """A binary file for plyfile, which reads headers byte by byte and refuses any that is not ASCII,
    as in other programs' comments."""

    def __init__(self, path: Path, header: bytes):
        super().__init__(path)
        self.header_bytes = _header_bytes(header) or HEADER_BYTES

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        # Rows with lists are read number by number, some of which are bytes, too.
        return data.translate(IN_ASCII) if len(data) == 1 and self.tell() <= self.header_bytes else data


def read_rows(path: Path, wanted: str) -> np.ndarray:
    """The structured array of the element `vertex`, of a file in any of the format's three forms.

    wanted: what the file should be, for the one who gave another. Raises BadInput for what cannot be read.
    """
    if not path.is_file():
        raise BadInput(f"There is no file {path}.", f"Give the path of a {wanted}.")
    try:
        return _parsed(path)["vertex"].data
    except OSError as problem:
        raise BadInput(f"{path} cannot be opened: {problem.strerror}.", f"Give the path of a {wanted}.") from None
    except plyfile.PlyElementParseError as problem:
        row = f" at row {problem.row}" if problem.row is not None else ""
        raise BadInput(
            f"{path} breaks off or is garbled{row}: {problem.message}.", "Copy or export it again."
        ) from None
    except OverflowError as problem:  # text: a number that its column's type cannot hold
        raise BadInput(f"{path} is garbled: {problem}.", "Copy or export it again.") from None
    except (plyfile.PlyParseError, ValueError) as problem:
        fault = "it is no text" if isinstance(problem, UnicodeDecodeError) else problem
        if not path.stat().st_size:
            fault = "it is empty"
        raise BadInput(f"{path} is not a .ply: {fault}.", f"Give a {wanted}.") from None
    except MemoryError:
        raise BadInput(f"{path} announces more rows than fit into memory.", "Copy or export it again.") from None
    except KeyError:
        raise BadInput(f"{path} has no element `vertex`.", f"Give a {wanted}.") from None


def read_header(path: Path) -> bytes:
    """The start of the file, with all of its header and maybe some of its rows."""
    with path.open("rb") as file:
        return file.read(HEADER_BYTES)


def _header_bytes(header: bytes) -> int | None:
    """Where the rows begin; None if nothing ends the header."""
    end = re.search(rb"[\r\n]end_header(\r\n|\r|\n)", header)  # a line of its own: a comment may end in the word
    return end and end.end()


def _is_text(header: bytes) -> bool:
    """Whether the rows are text, as the header is; no comment line begins in this way."""
    return re.search(rb"[\r\n]format ascii", header) is not None


def _parsed(path: Path) -> plyfile.PlyData:
    header = read_header(path)
    opened = path.open(encoding="ascii", errors="backslashreplace") if _is_text(header) else _Opened(path, header)
    with (
        opened as file,
        warnings.catch_warnings(action="ignore", category=UserWarning),  # NumPy's of an empty list in a text
    ):
        return plyfile.PlyData.read(file)


def bytes_beyond(path: Path) -> int:
    """How many bytes a readable file has beyond the rows that its header announces;
    0 in a file of text, or with lists."""
    header = read_header(path)
    rows_begin = _header_bytes(header)
    if rows_begin is None or _is_text(header):
        return 0
    elements = _parsed(path).elements  # maps the rows, and reads none
    if any(isinstance(column, plyfile.PlyListProperty) for element in elements for column in element.properties):
        return 0
    return path.stat().st_size - rows_begin - sum(element.data.nbytes for element in elements)


def write_rows(path: Path, rows: np.ndarray, comment: str = "") -> None:
    """Write a structured array as a binary little-endian .ply of one element `vertex`, in one piece.

    comment: one line of ASCII. It follows the `element` line, where plyfile puts those of an element, not those of a
    file: the original viewer counts lines.
    """
    vertices = plyfile.PlyElement.describe(rows, "vertex", comments=[comment] if comment else [])
    plyfile.PlyData([vertices], byte_order="<").write(str(path))
