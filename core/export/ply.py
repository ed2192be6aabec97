"""The vanilla 3DGS .ply, which every viewer of Gaussians reads.

binary_little_endian, one element `vertex`, 62 float32 properties, 248 bytes a Gaussian. f_rest is channel-major (all of
R, then G, then B), opacity a logit, scale a natural log, rot w x y z: the original project's save_ply, byte for byte.
"""

import re
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

import core
from core.errors import BadInput
from core.ply_file import read_header, read_rows, write_rows
from core.scene.harmonics import MAX_DEGREE, coefficient_count
from core.scene.splats import QUATERNION_MIN_NORM2, Splats
from core.system.atomic import replacing
from core.words import counted

_REST_OF_DEGREE = {degree: 3 * (coefficient_count(degree) - 1) for degree in range(MAX_DEGREE + 1)}


def _properties(rest: int) -> list[str]:
    """The names of the columns, in order, with `rest` higher SH coefficients."""
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(rest)),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


PROPERTIES = _properties(_REST_OF_DEGREE[MAX_DEGREE])
# Where they are in a row.
CENTRE, DC, REST, OPACITY, SCALE, QUATERNION = slice(0, 3), slice(6, 9), slice(9, 54), 54, slice(55, 58), slice(58, 62)
# Converters from 8-bit formats write the logits and logarithms of 0 and 1 as +-Inf; they are read as +- this, which
# renders the same.
ENDLESS = 30.0
BYTES_PER_GAUSSIAN = 4 * len(PROPERTIES)


def _undrawable(table: Float32[np.ndarray, "n p"]) -> Bool[np.ndarray, " n"]:
    """Which rows, of all PROPERTIES, no viewer can draw:
    with anything NaN or infinite, or a quaternion of length zero."""
    quaternions = table[:, QUATERNION]
    norm2 = np.einsum("nk,nk->n", quaternions, quaternions, dtype=np.float64)
    # A float64 sum finds NaN and Inf in a third of the time of a table of flags; finite float32 cannot overflow it.
    with np.errstate(invalid="ignore"):  # Inf - Inf
        total = table.sum(axis=1, dtype=np.float64)
    return ~np.isfinite(total) | (norm2 < QUATERNION_MIN_NORM2)


def write_ply(path: Path, splats_in_world: Splats, comment: str = "") -> int:
    """Write Gaussians (world units) for any 3DGS viewer; returns how many undrawable ones were left out.

    The file appears whole or not at all. Always 45 f_rest columns, zero above the degree, because several viewers
    assume them. comment: one line in the header; anything but ASCII is escaped.
    Errors: as core.system.atomic.replacing; BadInput if no Gaussian is left.
    """
    with np.errstate(over="ignore"):  # a float64 beyond float32 becomes Inf here, and is then dropped and counted
        parts = {name: tensor.detach().cpu().numpy() for name, tensor in splats_in_world.tensors().items()}
        count, coefficients = parts["sh"].shape[:2]
        table = np.zeros((count, len(PROPERTIES)), dtype="<f4")
        table[:, CENTRE] = parts["means"]
        table[:, DC] = parts["sh"][:, 0]
        for channel, columns in enumerate(np.split(table[:, REST], 3, axis=1)):
            columns[:, : coefficients - 1] = parts["sh"][:, 1:, channel]
        table[:, OPACITY] = parts["logit_opacities"]
        table[:, SCALE] = parts["log_scales"]
        table[:, QUATERNION] = parts["quaternions"]
    dropped = _undrawable(table)
    if dropped.any():
        table = table[~dropped]
    if not len(table):
        raise BadInput(f"{path} was not written: none of {counted(count, 'Gaussian')} can be drawn.", "Train again.")
    rows = table.view([(name, "<f4") for name in PROPERTIES])[:, 0]
    line = " ".join(comment.encode("ascii", "backslashreplace").decode().split())
    with replacing(path) as temporary:
        write_rows(temporary, rows, line)
    return int(dropped.sum())


def read_ply(path: Path) -> Splats:
    """The Gaussians (world units, float32) of a 3DGS .ply, binary or ASCII, of SH degree 0 to 3:
    every row, also those that cannot be drawn.

    Opacities of 0 and 1 and scales of 0, which other programs write as logits and logarithms of +-Inf, are read as
    +-ENDLESS.

    Raises BadInput naming what is wrong: no such file, not a .ply, cut short, a column missing, a number of f_rest
    columns that fits no degree.
    """
    vertices = read_rows(path, "3DGS .ply")
    if not len(vertices):
        raise BadInput(f"{path} holds no Gaussians.", "Export it again.")
    names = vertices.dtype.names or ()
    rest = sum(name.startswith("f_rest_") for name in names)
    degree = next((degree for degree, columns in _REST_OF_DEGREE.items() if columns == rest), None)
    if degree is None:
        raise BadInput(
            f"{path} has {counted(rest, 'f_rest column')}.", "Export it with SH degree 0 to 3: 0, 9, 24 or 45 of them."
        )
    if "packed_position" in names:
        raise BadInput(f"{path} is a compressed .ply, as SuperSplat writes it.", "Export it uncompressed.")
    if "scale_1" in names and "scale_2" not in names:
        raise BadInput(f"{path} holds flat Gaussians (2DGS).", "Give one with three scales a Gaussian.")
    wanted = [name for name in _properties(rest) if name not in ("nx", "ny", "nz")]
    for name in wanted:
        if name not in names or vertices.dtype[name].kind not in "fiu":
            fault = f"lacks the column {name}" if name not in names else f"holds lists in the column {name}"
            raise BadInput(f"{path} {fault}.", "It is not a 3DGS .ply; export it as one.")
    table = np.empty((len(vertices), len(wanted)), dtype=np.float32)
    with np.errstate(over="ignore"):  # a double beyond float32 becomes Inf, as which it is reported
        for column, name in enumerate(wanted):
            table[:, column] = vertices[name]
            if name == "opacity":
                np.nan_to_num(table[:, column], copy=False, nan=np.nan, posinf=ENDLESS, neginf=-ENDLESS)
            elif name.startswith("scale_"):
                np.nan_to_num(table[:, column], copy=False, nan=np.nan, posinf=np.inf, neginf=-ENDLESS)
    return _splats(torch.from_numpy(table), coefficient_count(degree))


def header_comment(run: str, sky_count: int, look: str) -> str:
    """The comment in a file that wegs writes. sky_count: how many of its last Gaussians are the dome."""
    return f"wegs {core.__version__}, run {run}, sky {sky_count}, look {look}"


def sky_count_in(path: Path) -> int | None:
    """How many of the file's last Gaussians are the dome, by its `header_comment`; None for other programs' files."""
    header = read_header(path).partition(b"end_header")[0]
    found = re.search(rb"^comment wegs [^,]*, run [^,]*, sky (\d+), look ", header, re.MULTILINE)
    return int(found[1]) if found else None


def _splats(table: Float[Tensor, "n p"], coefficients: int) -> Splats:
    """Columns x y z, SH, opacity, scale, rot -> Splats."""
    sizes = [3, 3, 3 * (coefficients - 1), 1, 3, 4]
    means, dc, rest, opacities, scales, quaternions = (part.contiguous() for part in table.split(sizes, dim=1))
    higher = rest.reshape(len(table), 3, coefficients - 1).transpose(1, 2)
    sh = torch.cat([dc[:, None, :], higher], dim=1)
    return Splats(means, quaternions, scales, opacities[:, 0], sh)


def write_points(path: Path, points: Float[np.ndarray, "n 3"], colours: Float[np.ndarray, "n 3"]) -> None:
    """Write a point cloud as the run folder's `input.ply`. points: world units. colours: [0, 1], stored in 8 bits."""
    position = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    rows = np.zeros(len(points), dtype=[*position, ("red", "u1"), ("green", "u1"), ("blue", "u1")])
    for axis, name in enumerate("xyz"):
        rows[name] = points[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        rows[name] = np.clip(np.rint(np.asarray(colours)[:, channel] * 255), 0, 255)
    with replacing(path) as temporary:
        write_rows(temporary, rows)
