"""Checkpoints: one safetensors file with every tensor of a run,
and its plain facts as JSON in the header. No pickle."""

import json
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from core.errors import BadInput, as_out_of_memory, command
from core.system import atomic, outputs

NAME = re.compile(r"checkpoint_\d{6,}\.safetensors")
# Names the temporary folder, the same for all steps; safetensors' own temporary file lies in it, too.
BEING_WRITTEN = "checkpoint"
# Matches that folder, which a killed run leaves behind until it goes on.
TEMPORARY = f".{BEING_WRITTEN}{outputs.TEMPORARY}*"
VERSION = 2
Read = TypeVar("Read")


@dataclass(frozen=True)
class Checkpoint:
    """tensors: by dotted name, the part they belong to first. facts: JSON values; always holds `step`."""

    tensors: dict[str, Tensor]
    facts: dict

    def part(self, name: str) -> dict[str, Tensor]:
        """The tensors of one part, with its name taken off."""
        prefix = name + "."
        return {key[len(prefix) :]: tensor for key, tensor in self.tensors.items() if key.startswith(prefix)}


def how_to_go_on(folder: Path) -> str:
    """The command that goes on with a stopped run."""
    return command("wegs", "train", "--resume", "-o", folder)


def check_name(path: Path, fix: str) -> None:
    """Raise BadInput for a path that is not in UTF-8: safetensors reads no other."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise BadInput(f"The name {path} is not in UTF-8, so no checkpoint could be read there.", fix) from None


def save(folder: Path, checkpoint: Checkpoint) -> Path:
    """Write FOLDER/checkpoint_STEP.safetensors under a temporary name, rename it, and drop all others."""
    path = folder / f"checkpoint_{checkpoint.facts['step']:06d}.safetensors"
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in checkpoint.tensors.items()}
    try:
        with atomic.temporary_folder(folder / BEING_WRITTEN) as work:
            temporary = work / path.name
            temporary.touch()
            mode = temporary.stat().st_mode
            save_file(tensors, temporary, metadata={"wegs": json.dumps({"version": VERSION, **checkpoint.facts})})
            temporary.chmod(mode)  # save_file leaves it to its owner alone: nobody else could bake from a shared folder
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())  # before the previous checkpoint is deleted
            os.replace(temporary, path)
    except (OSError, SafetensorError) as error:
        fix = f"Free some space, or let the folder be written in, then type: {how_to_go_on(folder)}"
        # Safetensors puts the system's words last.
        reason = getattr(error, "strerror", None) or str(error).rpartition("I/O error: ")[2]
        raise BadInput(f"{path} could not be written: {reason}.", fix) from None
    for old in written(folder):
        if old != path:
            old.unlink()
    return path


def written(folder: Path) -> list[Path]:
    """The checkpoints in a run folder: files of other names, such as copies that the user made, are none."""
    return [path for path in folder.glob("checkpoint_*") if NAME.fullmatch(path.name)]


def newest(folder: Path) -> Path | None:
    """The checkpoint with the highest step in a run folder, or None."""
    # Steps are padded with zeros, but only to six digits: of two names the longer one is the later one.
    return max(written(folder), key=lambda path: (len(path.name), path.name), default=None)


def read_newest(folder: Path, read: Callable[[Path], Read]) -> tuple[Path, Read] | None:
    """The newest checkpoint of a run folder and what `read` reads of it,
    or None if there is none; raises as `read` does.

    A training at work in the folder may replace the checkpoint while it is read; then the new one is read.
    """
    while path := newest(folder):
        try:
            return path, read(path)
        except BadInput:
            if path == newest(folder):
                raise
    return None


def read_facts(path: Path) -> dict:
    """The facts of a checkpoint, without its tensors; BadInput if it is cut off or not one of ours."""
    return _read(path, with_tensors=False).facts


def load(path: Path) -> Checkpoint:
    """Read a checkpoint; BadInput if it is cut off or not one of ours."""
    return _read(path, with_tensors=True)


def _read(path: Path, with_tensors: bool) -> Checkpoint:
    check_name(path, "Rename the folder.")
    try:
        path.open("rb").close()  # safetensors calls a file missing that may not be read
        with safe_open(path, framework="pt") as file:
            facts = json.loads((file.metadata() or {})["wegs"])
            names = file.keys() if with_tensors else ()
            tensors = {name: file.get_tensor(name) for name in names}
    except PermissionError:
        raise
    # RuntimeError: of torch, if the file goes meanwhile.
    except (OSError, SafetensorError, KeyError, ValueError, RuntimeError) as error:
        if as_out_of_memory(error) is not None:  # no fault of the checkpoint's
            raise
        raise BadInput(f"{path} is not a readable checkpoint: {error}.", "Train again, or name another run.") from None
    if facts.get("version") != VERSION:
        raise BadInput(f"{path} has version {facts.get('version')}, this is version {VERSION}.", "Train again.")
    return Checkpoint(tensors, facts)


@contextmanager
def fitting(path: Path) -> Iterator[None]:
    """Around building from the checkpoint `path`: raises BadInput if parts of it are missing or of other sizes."""
    try:
        yield
    except (KeyError, TypeError, ValueError, RuntimeError) as problem:
        if as_out_of_memory(problem) is not None:  # no fault of the checkpoint's
            raise
        reason = " ".join(str(problem).split())[:200]
        raise BadInput(
            f"{path} does not fit its run: {type(problem).__name__}: {reason}.",
            "It was changed, or is of another version of wegs: train the run again.",
        ) from None
