"""Point files in every form that programs write; one line for each file that cannot be read."""

import numpy as np
import plyfile
import pytest

from core.data.formats.point_file import read_points_file
from core.errors import BadInput

PLACES = np.array([[1.5, -2, 3], [4, 5, -6.25]])
COLOURS = np.array([[0, 127, 255], [10, 20, 30]], np.uint8)


def write(path, form, colours=True, place="float", extra=()):
    """Two points, with a normal between place and colour, and a comment as programs put them."""
    properties = [(place, name) for name in "xyz"] + [("double", "nx")]
    properties += [("uchar", name) for name in ("red", "green", "blue")] if colours else []
    header = ["ply", f"format {form} 1.0", "comment made here", "element vertex 2", *(f"property {kind} {name}" for kind, name in properties)]  # fmt: skip
    header += [*extra, "end_header", ""]
    if form == "ascii":
        rows = [[*map(str, p), "0.5", *(map(str, c) if colours else ())] for p, c in zip(PLACES, COLOURS, strict=True)]
        body = "".join(" ".join(row) + "\n" for row in rows).encode()
    else:
        order = "<" if "little" in form else ">"
        kinds = {"float": "f4", "float32": "f4", "double": "f8", "uchar": "u1"}
        rows = np.zeros(2, [(name, order + kinds[kind]) for kind, name in properties])
        for number, name in enumerate("xyz"):
            rows[name] = PLACES[:, number]
        for number, name in enumerate(("red", "green", "blue") if colours else ()):
            rows[name] = COLOURS[:, number]
        body = rows.tobytes()
    path.write_bytes("\n".join(header).encode() + body)
    return path


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("place", ["float", "double", "float32"])
def test_points_are_read_from_every_form_of_ply(tmp_path, form, place):
    positions, colours = read_points_file(write(tmp_path / "a.ply", form, place=place, extra=["element face 0", "property list uchar int vertex_indices"]))  # fmt: skip
    assert (positions == PLACES).all() and np.allclose(colours, COLOURS / 255, atol=1e-7)
    positions, colours = read_points_file(write(tmp_path / "b.ply", form, colours=False, place=place))
    assert (positions == PLACES).all() and (colours == 0.5).all()


@pytest.mark.parametrize("text", [True, False])
def test_bytes_beside_a_list_are_read_as_they_are(tmp_path, text):
    """Rows with lists are read byte by byte, as headers are, in which bytes from 128 on are no letters."""
    rows = np.zeros(4, [*((name, "f4") for name in "xyz"), *((c, "u1") for c in ("red", "green", "blue")), ("views", "O")])  # fmt: skip
    rows["red"], rows["views"] = [0, 100, 128, 255], [np.arange(count) for count in (0, 2, 127, 200)]
    vertices = plyfile.PlyElement.describe(rows, "vertex", len_types={"views": "u1"}, val_types={"views": "i4"})
    plyfile.PlyData([vertices], text=text, byte_order="<").write(str(tmp_path / "a.ply"))
    colours = read_points_file(tmp_path / "a.ply")[1]
    assert np.allclose(255 * colours[:, 0], rows["red"], rtol=0, atol=1e-4)  # float32


@pytest.mark.parametrize(
    ("kind", "white"),
    [("u1", 255), ("u2", 65535), ("i2", 255), ("i4", 255), ("u4", 255), ("f4", 1), ("f8", 1), ("f4", 255), ("f8", 255)],
)
def test_colours_of_every_type(tmp_path, kind, white):
    """No program states which value of a type is white."""
    shades = np.array([[0, 0.2, 1], [0.6, 1, 0.4]])
    rows = np.zeros(2, [(name, "f4") for name in "xyz"] + [(name, kind) for name in ("red", "green", "blue")])
    for column, name in enumerate(("red", "green", "blue")):
        rows[name] = shades[:, column] * white
    plyfile.PlyData([plyfile.PlyElement.describe(rows, "vertex")]).write(str(tmp_path / "a.ply"))
    assert np.allclose(read_points_file(tmp_path / "a.ply")[1], shades, rtol=0, atol=1e-6)  # float32


@pytest.mark.parametrize(
    ("given", "expected"),
    [([1.4, -0.3, 0.5], [1, 0, 0.5]), ([300.0, -5.0, 51.0], [1, 0, 0.2]), ([np.nan, 0.5, np.inf], [0, 0.5, 0])],
)
def test_colours_stay_within_what_can_be_shown(tmp_path, given, expected):
    rows = np.array([(0, 0, 0, *given)], [(name, "f4") for name in ("x", "y", "z", "red", "green", "blue")])
    plyfile.PlyData([plyfile.PlyElement.describe(rows, "vertex")]).write(str(tmp_path / "a.ply"))
    assert np.allclose(read_points_file(tmp_path / "a.ply")[1], [expected], rtol=0, atol=1e-6)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_a_truncated_file_is_refused(tmp_path, form):
    path = write(tmp_path / "a.ply", form)
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(BadInput, match="a.ply breaks off or is garbled at row 1"):
        read_points_file(path)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_no_points_are_no_fault_of_the_file(tmp_path, form):
    path = write(tmp_path / "a.ply", form)
    header = path.read_bytes().partition(b"end_header\n")[0] + b"end_header\n"
    path.write_bytes(header.replace(b"vertex 2", b"vertex 0"))
    positions, colours = read_points_file(path)
    assert positions.shape == colours.shape == (0, 3)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"ply", b"plain", "is not a .ply"),
        (b"end_header", b"end", "is not a .ply"),
        (b"ascii", b"morse", "is not a .ply"),
        (b"element vertex", b"element face", "has no element `vertex`"),
        (b"vertex 2", b"vertex -2", "is not a .ply"),
        (b"property float x", b"property float q", "has no numbers x, y and z"),
        (b"property float x", b"property list uchar int x", "breaks off or is garbled at row 0"),
        (b"1.5", b"one", "breaks off or is garbled at row 0"),
    ],
)
def test_what_is_no_points_file_is_refused(tmp_path, old, new, words):
    path = write(tmp_path / "a.ply", "ascii")
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with pytest.raises(BadInput, match=f"a.ply {words}"):
        read_points_file(path)


def test_an_empty_file_is_refused(tmp_path):
    (tmp_path / "a.ply").touch()
    with pytest.raises(BadInput, match="a.ply is not a .ply: it is empty. Give"):
        read_points_file(tmp_path / "a.ply")


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(BadInput, match="There is no file"):
        read_points_file(tmp_path / "a.ply")
