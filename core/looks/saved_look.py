"""Looks saved by name in JSON files: embedding, tone and the changes of a refinement.
Only the run that saved one can read it, at that step."""

import json
import re
from pathlib import Path

import torch
from torch import Tensor

from core.appearance.colouring import EVEN, Colouring
from core.data.collection import Collection
from core.data.photos.names import composed
from core.errors import BadInput, BadSetting
from core.looks.trained import NEUTRAL, Look
from core.run.run_folders import LOOKS, check_writable
from core.system.atomic import write_json
from core.system.device import CPU
from core.words import counted

LARGEST = 1e6  # far beyond any number of a look; much larger ones would overflow


def file_of(folder: Path, name: str) -> Path:
    """Where a run's look `name`, with or without `.json`, would lie; for names that no look may have, too."""
    return folder / LOOKS / f"{_stem_of(name)}.json"


def path_of(folder: Path, name: str) -> Path:
    """Where a run saves the look `name`; BadSetting unless that is a plain file name other than `neutral`,
    with or without `.json`."""
    name = _stem_of(name)
    if name == NEUTRAL:
        raise BadSetting(f"{NEUTRAL!r} is the name of a look that every run has.", "Choose another name.")
    if not re.fullmatch(r"\w[\w. -]*", name):
        raise BadSetting(
            f"{name!r} cannot be the name of a look.",
            "Begin it with a letter, a digit or '_'; '.', '-' and spaces may follow.",
        )
    return file_of(folder, name)


def _stem_of(name: str) -> str:
    return composed(name.removesuffix(".json"))


def check_free(folder: Path, name: str, force: bool, collection: Collection) -> None:
    """Raise BadInput, before the work, if a run cannot save a look `name`, or has one that may not be replaced.

    Raises BadSetting for the name of a photo of the run's collection, whose own look could then no longer be named.
    """
    path = path_of(folder, name)
    if collection.called(path.stem) is not None:
        raise BadSetting(f"{path.stem!r} is the name of a photo of this run.", "Choose another name.")
    check_writable(path.parent)
    if path.exists() and not force:
        raise BadInput(f"{path} exists.", "Add --force to replace it, or choose another name.")


def names(folder: Path) -> list[str]:
    """The names of the looks saved in a run."""
    return sorted(path.stem for path in (folder / LOOKS).glob("*.json"))


def save(folder: Path, look: Look, identity: str, step: int) -> Path:
    """Write the look into a run folder, replacing an older one of that name.

    identity: the run's (config.json); only its SH transfer after `step` steps understands embedding and changes.
    """
    path = path_of(folder, look.name)
    path.parent.mkdir(exist_ok=True)
    embedding, tone, changes = look.colouring.detached().to(CPU)
    facts = {"run": identity, "step": step, "source": look.source, "embedding": embedding.tolist()}
    if tone is not None:
        facts["tone"] = tone.tolist()
    if changes:
        facts["changes"] = {name: change.tolist() for name, change in changes.items()}
    write_json(path, facts)
    return path


def load(path: Path, identity: str, step: int, like: Colouring) -> Look:
    """Read a look of the run `identity` after `step` steps.

    like: the embedding and all changes that a look of the run may hold; only their shapes matter. Raises BadInput if
    the file is anything else, or holds other shapes, numbers beyond LARGEST, or gains below zero.
    """
    if not path.is_file():
        raise BadInput(f"There is no saved look {path}.", "Make one with --save-appearance NAME.")
    try:
        facts = json.loads(path.read_bytes())
        source, owner, saved_at, numbers = (facts[key] for key in ("source", "run", "step", "embedding"))
        found = _tensor(numbers)
        tone = _tensor(facts["tone"]) if "tone" in facts else None
        changes = {name: _tensor(change) for name, change in facts.get("changes", {}).items()}
    except PermissionError:  # says nothing about the look
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as problem:
        raise BadInput(
            f"{path} is not a saved look: {type(problem).__name__}: {problem}.", "Make one with --save-appearance NAME."
        ) from None
    if owner != identity:
        raise BadInput(
            f"{path} was saved by run {owner}, not by {identity}.", "Name its run with --run, or save it again."
        )
    if saved_at != step:
        raise BadInput(f"{path} was saved at step {saved_at}; the run is at step {step} now.", "Save the look again.")
    if not _fits(found, like.embedding):
        raise BadInput(
            f"{path} does not hold {counted(len(like.embedding), 'number')} of an embedding.", "Save the look again."
        )
    if tone is not None and not (_fits(tone, EVEN) and (tone >= 0).all()):
        raise BadInput(f"{path} has a tone that is not two rows of three gains.", "Save the look again.")
    if not all(name in like.changes and _fits(change, like.changes[name]) for name, change in changes.items()):
        raise BadInput(f"{path} has changes that do not fit {identity}.", "Save the look again.")
    return Look(path.stem, f"saved look {path.stem} (of {source})", Colouring(found, tone, changes))


def _tensor(numbers: list) -> Tensor:
    """Raises TypeError, ValueError or OverflowError for anything but numbers in rows of equal length."""
    return torch.tensor(numbers, dtype=torch.float32)


def _fits(found: Tensor, like: Tensor) -> bool:
    return found.shape == like.shape and bool((found.abs() <= LARGEST).all())
