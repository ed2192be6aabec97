"""Training under masks that the user gives: what they hide has no influence, from the first step to the last bit."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from core import pipeline
from core.data.given_masks import with_masks_in
from core.errors import BadInput
from core.looks.find_look import find_look
from core.looks.trained import load_run
from core.pipeline import training
from core.run import run_config
from core.run.sized_photo import Sizes
from core.training.mask_files import write_masks
from core.training.sized_photos import SizedPhotos
from core.training.trainer import Trainer
from tests.failing import failing
from tests.heard import Heard, StopsAtStep
from tests.small import HEIGHT, WIDTH, give_to_pipeline, small_collection, small_settings
from tests.training.learned import assert_same, learned
from tests.training.step_contexts import context_at

HIDDEN = np.s_[20:, 8:28]
STEPS = 12


def crowded(folder, colour):
    """The small collection with a block of one colour in each training photo, and masks that hide it."""
    (folder / "masks").mkdir(parents=True)
    collection = small_collection(folder)
    for photo in collection.split("train"):
        pixels, mask = cv2.imread(str(photo.path)), np.full((HEIGHT, WIDTH), 255, np.uint8)
        pixels[HIDDEN], mask[HIDDEN] = colour, 0
        cv2.imwrite(str(photo.path), pixels)
        cv2.imwrite(str(folder / "masks" / photo.name), mask)
    return collection


def trained(collection, folder, **changes):
    folder.mkdir()
    trainer = Trainer(collection, small_settings(steps=STEPS, **changes), folder)
    reports = list(trainer.train())
    return learned(trainer), reports


@pytest.mark.parametrize(
    "changes", [{}, {"transients": "off"}, {"mask_loss": "paper", "mask_start": 0.0, "mask_apply": 0.0}]
)
def test_what_given_masks_hide_has_no_influence(tmp_path, changes):
    runs = []
    for name, colour in (("orange", (20, 120, 240)), ("blue", (240, 30, 30))):
        collection = crowded(tmp_path / name, colour)
        given = with_masks_in(collection, tmp_path / name / "masks")
        runs.append(trained(given, tmp_path / f"{name}-run", held_out_checks=0, **changes)[0])
    assert_same(*runs)


@pytest.mark.parametrize("transients", ["on", "off"])
def test_the_written_masks_show_what_the_given_ones_hide(tmp_path, transients):
    collection = crowded(tmp_path / "scene", (255, 0, 255))
    given = with_masks_in(collection, tmp_path / "scene" / "masks")
    trainer = Trainer(given, small_settings(transients=transients), tmp_path / "run")
    assert write_masks(tmp_path / "run", trainer.model, trainer.photos) == 4
    for sized in trainer.photos:
        shown = cv2.imread(str(tmp_path / "run" / "masks" / sized.photo.name), cv2.IMREAD_GRAYSCALE)
        assert (shown[HIDDEN] == 0).all() and (shown[:18] > 0).all()
        assert transients == "on" or (np.delete(shown.flatten(), np.flatnonzero(~sized.valid)) == 255).all()


def test_hidden_places_count_for_nothing_from_step_0(tmp_path):
    """They add no loss: with masks, the first steps lose less than without, by what the block adds."""
    collection = crowded(tmp_path / "scene", (255, 0, 255))
    _, free = trained(collection, tmp_path / "free", transients="off")
    _, given = trained(with_masks_in(collection, tmp_path / "scene" / "masks"), tmp_path / "given", transients="off")
    assert all(
        report.picture_loss > 1.2 * other.picture_loss for report, other in zip(free[:4], given[:4], strict=True)
    )


def test_masks_that_are_inverted_by_mistake_are_noticed(tmp_path):
    collection = crowded(tmp_path, (0, 0, 255))
    for inverted in (False, True):
        for mask in (tmp_path / "masks").iterdir() if inverted else ():
            cv2.imwrite(str(mask), 255 - cv2.imread(str(mask)))
        given = with_masks_in(collection, tmp_path / "masks").split("train")
        notes = SizedPhotos(given, Sizes(1, 32)).notes
        assert notes == (
            ["The masks leave 19% of their photos: white is what is used. Invert them if it marks what is not."]
            * inverted
        )


def test_masks_that_are_all_black_are_refused_in_one_line(tmp_path):
    collection = crowded(tmp_path, (0, 0, 255))
    for mask in (tmp_path / "masks").iterdir():
        cv2.imwrite(str(mask), np.zeros((HEIGHT, WIDTH), np.uint8))
    with pytest.raises(BadInput) as caught:
        Trainer(with_masks_in(collection, tmp_path / "masks"), small_settings(), tmp_path / "run")
    first, *others = (photo.name for photo in collection.split("train"))
    named = ", ".join(
        [f"{first} (is left with 0.0% of its pixels by its mask)", *(f"{name} (likewise)" for name in others)]
    )
    why = f"4 photos of the train split that cannot be used: {named}"
    assert caught.value.what == f"{tmp_path}: no photo is left to train on. {why}."


def test_masks_belong_to_the_run_and_are_used_when_it_is_resumed(tmp_path, monkeypatch):
    scene = tmp_path / "scene"
    collection = crowded(scene, (20, 120, 240))
    give_to_pipeline(replace(collection, root=scene), monkeypatch)
    heard = Heard()
    settings = small_settings(steps=STEPS, checkpoints=2)
    whole = pipeline.train(scene, settings, tmp_path / "whole", heard, masks=scene / "masks")
    assert f"4 photos with a mask from {scene / 'masks'}." in heard.lines
    assert [photo.mask and photo.mask.path.name for photo in run_config.read_config(whole).collection.photos] == [
        photo.name if photo.split == "train" else None for photo in collection.photos
    ]
    with pytest.raises(KeyboardInterrupt):
        pipeline.train(scene, settings, tmp_path / "broken", StopsAtStep(8), masks=scene / "masks")
    hidden = (scene / "masks").rename(scene / "hidden")
    with pytest.raises(BadInput, match="4 masks of the run cannot be found, such as .*photo_0.png. Put them back"):
        pipeline.resume(tmp_path / "broken")
    hidden.rename(scene / "masks")
    broken = pipeline.resume(tmp_path / "broken", Heard())
    first, second = load_run(whole), load_run(broken)
    assert_same(second.splats.tensors(), first.splats.tensors())
    # Looks are read as they were trained: what was hidden stays so.
    looks = [find_look(live, "photo_0.png").colouring.embedding for live in (first, second)]
    assert torch.equal(*looks)


def test_a_hidden_place_teaches_the_predicted_mask_nothing(tmp_path):
    collection = crowded(tmp_path / "scene", (20, 120, 240))
    trainer = Trainer(with_masks_in(collection, tmp_path / "scene" / "masks"), small_settings(), tmp_path)
    target = trainer.photos.target(0, 1)[1]
    mask = trainer.model.read(trainer.photos[0].encoder_input, 0).mask
    image = torch.full((HEIGHT, WIDTH, 3), 0.4)
    losses = []
    for value, place in ((0.4, HIDDEN), (1.0, HIDDEN), (1.0, np.s_[:10, :10])):
        changed = image.clone()
        changed[place] = value
        losses.append(float(trainer.objective.mask(changed, target, mask, context_at(trainer, 0.9)).detach()))
    assert losses[0] == losses[1] != losses[2]


def test_missing_masks_are_refused_before_cameras_are_searched_for(tmp_path, monkeypatch):
    monkeypatch.setattr(training, "prepared", failing(AssertionError("minutes of work")))
    for name in ("photos/a.jpg", "masks/a_mask.png"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).touch()
    for masks, words in (
        ("nowhere", "There is no folder .*nowhere"),
        ("masks", "masks holds no mask of a training photo. Name masks .* a.png"),
    ):
        with pytest.raises(BadInput, match=words):
            pipeline.train(tmp_path / "photos", small_settings(), masks=tmp_path / masks)
