"""Files for other programs, in a format chosen by the suffix. A new format is a module and a line in FORMATS."""

from pathlib import Path

from core.errors import BadInput
from core.export.ply import write_ply
from core.scene.splats import Splats

# Suffix -> writer(path, splats_in_world, comment) -> Gaussians dropped.
FORMATS = {".ply": write_ply}


def check_format(path: Path) -> None:
    """Raise BadInput, before the work, unless the suffix of `path` is a key of FORMATS."""
    if path.suffix.lower() not in FORMATS:
        suffixes = " or ".join(FORMATS)
        fix = f"End it in {suffixes}; SuperSplat converts that to other formats."
        raise BadInput(f"{path} was not written: its name does not end in {suffixes}.", fix)


def write(path: Path, splats_in_world: Splats, comment: str) -> int:
    """Write Gaussians (world units) in the format of the suffix of `path`; returns how many had to be dropped."""
    check_format(path)
    return FORMATS[path.suffix.lower()](path, splats_in_world, comment)


__all__ = ["FORMATS", "check_format", "write"]
