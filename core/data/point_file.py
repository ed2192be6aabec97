"""Points from a .ply: positions and, where it has them, colours. Nothing else of the file is looked at.

The format: Greg Turk, The PLY Polygon File Format (1994). plyfile is not used here: it stays behind the exporter.
"""

from pathlib import Path

import numpy as np

from core.errors import BadInput

HEADER_BYTES = 1 << 16  # longer ones are no header
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
PLACE, COLOUR = ("x", "y", "z"), ("red", "green", "blue")
GREY = 0.5  # of points without colours


def read_points_file(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions (P, 3) float64 and colours (P, 3) float32 in [0, 1], of a .ply in any of the three forms.

    Colours of whole numbers are divided by the largest of their type. Raises BadInput for what cannot be read.
    """
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise _bad(path, f"cannot be opened ({problem.strerror})") from None
    try:
        vertices = _vertices(data)
    except ValueError as problem:
        raise _bad(path, str(problem)) from None
    columns = vertices.dtype.names
    if not set(PLACE) <= set(columns):
        raise _bad(path, "has vertices without x, y and z")
    positions = np.stack([vertices[name].astype(np.float64) for name in PLACE], axis=1)
    if not set(COLOUR) <= set(columns):
        return positions, np.full(positions.shape, GREY, np.float32)
    largest = [np.iinfo(vertices[name].dtype).max if vertices.dtype[name].kind in "iu" else 1 for name in COLOUR]
    colours = np.stack([vertices[name] / most for name, most in zip(COLOUR, largest, strict=True)], axis=1)
    return positions, np.nan_to_num(colours).clip(0, 1).astype(np.float32)


def _bad(path: Path, why: str) -> BadInput:
    return BadInput(f"The points file {path} {why}.", "Write it again, or take it out of the scene's description.")


def _vertices(data: bytes) -> np.ndarray:
    """The rows of the file's first element, which has to be its vertices; ValueError says what is wrong."""
    end = data.find(b"end_header", 0, HEADER_BYTES)
    start = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or not start:
        raise ValueError("is no .ply")
    lines = [line.split() for line in data[:end].decode("ascii", "replace").splitlines()]
    order = FORMATS.get(next((line[1] for line in lines if line[:1] == ["format"] and len(line) > 1), ""))
    elements = [number for number, line in enumerate(lines) if line[:1] == ["element"]]
    if order is None or not elements:
        raise ValueError("has a header without a known format or elements")
    first = lines[elements[0]]
    if len(first) != 3 or first[1] != "vertex" or not first[2].isdecimal():
        raise ValueError("does not begin with its vertices")
    after = elements[1] if len(elements) > 1 else len(lines)
    properties = [line[1:] for line in lines[elements[0] : after] if line[:1] == ["property"]]
    if not all(len(words) == 2 and words[0] in TYPES for words in properties):
        raise ValueError("has vertices with lists or unknown types")
    row, count = np.dtype([(name, order + TYPES[kind]) for kind, name in properties]), int(first[2])
    if order:
        if len(data) - start < count * row.itemsize:
            raise ValueError(f"ends before its {count} vertices do (truncated)")
        return np.frombuffer(data, row, count, start)
    words = data[start:].split(maxsplit=count * len(properties))[: count * len(properties)]
    if len(words) < count * len(properties):
        raise ValueError(f"ends before its {count} vertices do (truncated)")
    table, rows = np.array(words, dtype=np.float64).reshape(count, len(properties)), np.zeros(count, row)
    with np.errstate(invalid="ignore"):  # NaN where a whole number should be
        for name, values in zip(row.names, table.T, strict=True):
            rows[name] = values
    return rows
