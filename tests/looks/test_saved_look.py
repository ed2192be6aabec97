"""Looks kept by name: exact, of one run at one step, and never called as something else."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from core.appearance.colouring import Colouring
from core.errors import BadInput, BadSetting
from core.looks import saved_look
from core.looks.trained import Look
from tests.failing import DENIED, failing
from tests.small import small_collection

WEIGHTS = {"layers.0.weight": torch.zeros(3, 2), "last.bias": torch.zeros(4)}  # that a look of the run may change


def loaded(path, size: int) -> Look:
    return saved_look.load(path, "abc", 7, Colouring(torch.zeros(size), changes=WEIGHTS))


def test_a_look_comes_back_bit_for_bit(tmp_path):
    dusk = Colouring(torch.randn(16, generator=torch.Generator().manual_seed(0)))
    look = Look("dusk", "dusk.jpg", dusk)
    back = loaded(saved_look.save(tmp_path, look, "abc", 7), 16)
    assert torch.equal(back.colouring.embedding, dusk.embedding)
    assert (back.name, back.source, back.colouring[1:]) == ("dusk", "saved look dusk (of dusk.jpg)", (None, {}))
    text = (tmp_path / "appearance" / "dusk.json").read_text()
    (tmp_path / "copy.json").write_text(text.replace("{", '{"name": "dusk",', 1))  # as earlier versions wrote it
    assert loaded(tmp_path / "copy.json", 16).name == "copy"  # files are copied; what they say of themselves is no path
    night = Look("night", "night.jpg", dusk._replace(tone=torch.rand(2, 3)))
    assert torch.equal(loaded(saved_look.save(tmp_path, night, "abc", 7), 16).colouring.tone, night.colouring.tone)
    changes = {name: torch.randn_like(weight) for name, weight in WEIGHTS.items()}
    back = loaded(
        saved_look.save(tmp_path, Look("changed", "dusk.jpg", dusk._replace(changes=changes)), "abc", 7), 16
    ).colouring.changes
    assert back.keys() == WEIGHTS.keys() and all(torch.equal(back[name], changes[name]) for name in WEIGHTS)


def saved(**changes) -> str:
    """What stands in the file of a look of this run, or of one that differs in these facts."""
    return json.dumps({"source": "b", "run": "abc", "step": 7, "embedding": [1, 2]} | changes)


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "not a saved look"),
        ("{}", "not a saved look"),
        ('{"source": "b", "run": "abc", "step": 7, "embedding": ' + 100_000 * "[", "not a saved look"),
        (saved(run="other"), "saved by run other"),
        (saved(step=5), "saved at step 5; the run is at step 7 now. Save the look again"),
        (saved(embedding=[1]), "2 numbers of an embedding"),
        (saved(embedding=[1, math.nan]), "2 numbers of an embedding"),
        (saved(embedding=[1, -3e38]), "2 numbers of an embedding"),
        (saved(embedding=[1, "x"]), "not a saved look"),
        (saved(embedding=[1, 10**400]), "not a saved look"),
        (saved(tone=[1]), "not two rows of three gains"),
        (saved(tone=[[1, 1], [1, 1], [1, 1]]), "not two rows"),
        (saved(tone=[[1, 1, 1], [1, 1, math.nan]]), "not two rows"),
        (saved(tone=[[1, 1, 1], [1, 1, -1]]), "not two rows"),
        (saved(tone=[[1, 1, 1], [1, 1, 3e38]]), "not two rows"),
        (saved(tone=[[1, 1, 1], [1, 1]]), "not a saved look"),
        (saved(changes=[1]), "not a saved look"),
        (saved(changes={"last.bias": [1, 1, 1]}), "changes that do not fit abc"),
        (saved(changes={"last.bias": [1, 1, 1, math.nan]}), "changes that do not fit"),
        (saved(changes={"encoder": [1]}), "changes that do not fit abc"),
    ],
)
def test_a_look_of_no_use_is_refused(tmp_path, text, words):
    path = tmp_path / "a.json"
    path.write_text(saved())
    assert loaded(path, 2).colouring.embedding.tolist() == [1, 2]
    path.write_text(text)
    with pytest.raises(BadInput, match=words):
        loaded(path, 2)


def test_a_look_that_may_not_be_read_is_not_called_damaged(tmp_path, monkeypatch):
    (tmp_path / "a.json").touch()
    monkeypatch.setattr(Path, "read_bytes", failing(DENIED))
    with pytest.raises(PermissionError):
        loaded(tmp_path / "a.json", 2)


@pytest.mark.parametrize("name", ["photo_1", "photo_1.png"])
def test_a_look_may_not_be_called_as_a_photo_is(name, tmp_path):
    collection = small_collection(tmp_path)
    photos = tuple(replace(photo, name=f"left/{photo.name}") for photo in collection.photos)
    for each in (collection, replace(collection, photos=photos)):
        with pytest.raises(BadSetting, match="is the name of a photo"):
            saved_look.check_free(tmp_path, name, True, each)
    saved_look.check_free(tmp_path, "photo_99", True, collection)


@pytest.mark.parametrize("name", ["", ".json", "../dusk", "a/b", ".hidden"])
def test_a_look_needs_a_plain_name(tmp_path, name):
    with pytest.raises(BadSetting):
        saved_look.path_of(tmp_path, name)


@pytest.mark.parametrize("name", ["neutral", "neutral.json"])
def test_a_look_may_not_be_called_neutral_and_is_told_why(tmp_path, name):
    with pytest.raises(BadSetting, match="every run has"):
        saved_look.path_of(tmp_path, name)


def test_a_look_may_be_named_with_its_suffix_and_in_either_unicode_form(tmp_path):
    assert saved_look.path_of(tmp_path, "dusk.json") == saved_look.path_of(tmp_path, "dusk")
    assert saved_look.path_of(tmp_path, "da\u0308mmer") == saved_look.path_of(tmp_path, "d\xe4mmer")
