"""The loop as a whole: it learns, it resumes bit for bit. What it survives: test_survival."""

import gc
import re
import time
import weakref
from dataclasses import replace

import pytest
import torch

from core.errors import BadInput
from core.run import checkpoint
from core.training.trainer import Trainer
from tests.small import damage, small_settings, trained_to_the_end
from tests.training.learned import assert_same, learned


def run(collection, folder, settings, until=None):
    folder.mkdir(exist_ok=True)
    trainer = Trainer(collection, settings, folder)
    reports = []
    for report in trainer.train():
        reports.append(report)
        if report.step == until:
            break
    return trainer, reports


def test_the_picture_loss_falls(collection, tmp_path):
    _, reports = run(collection, tmp_path / "run", small_settings(steps=150, coarse_until=0.0))
    first = sum(report.picture_loss for report in reports[:10]) / 10
    last = sum(report.picture_loss for report in reports[-10:]) / 10
    assert last < 0.7 * first
    assert reports[-1].held_out_psnr > 12


def test_photos_are_learned_from_coarse_to_fine(trainer_of):
    trainer, factors = trainer_of(steps=10, coarse_until=0.8), []
    target = trainer.photos.target
    trainer.photos.target = lambda index, factor: factors.append(factor) or target(index, factor)
    for _ in range(10):
        trainer.step()
    assert factors == [4] * 4 + [2] * 4 + [1] * 2


def test_latents_start_to_learn_at_latents_from(collection, tmp_path):
    trainer = Trainer(collection, small_settings(steps=10, latent_size=3, latents_from=0.5), tmp_path)
    for report in trainer.train():
        # Of the sky.
        for latents in (
            trainer.gaussians.latents[: trainer.gaussians.solid_count],
            trainer.gaussians.latents[trainer.gaussians.solid_count :],
        ):
            assert latents.any() == (report.step > 5)


@pytest.mark.parametrize(
    "changes",
    [{}, {"appearance": "off", "transients": "off"}, {"embedding": "glo", "latent_size": 4, "latents_from": 0.3}],
)
def test_a_resumed_run_equals_an_unbroken_one_bit_for_bit(collection, tmp_path, monkeypatch, changes):
    monkeypatch.setattr("core.training.schedule.LONG_GROWTH", 0)  # so that something is removed before and after
    settings = small_settings(steps=44, **changes)
    whole, _ = run(collection, tmp_path / "whole", settings)
    run(collection, tmp_path / "broken", settings, until=22)  # in the middle of a round through the four photos
    resumed = Trainer(collection, settings, tmp_path / "broken")
    resumed.resume(checkpoint.load(checkpoint.newest(tmp_path / "broken")))
    assert resumed.state.done == 22 and len(resumed.state.order) == 2
    trained_to_the_end(resumed)
    assert_same(learned(resumed), learned(whole))


def test_a_checkpoint_of_another_run_is_refused(collection, tmp_path):
    trainer, _ = run(collection, tmp_path / "run", small_settings(steps=2))
    saved = checkpoint.load(checkpoint.newest(tmp_path / "run"))
    for wrong in ({"order": [4]}, {"last_losses": [None] * 5}):
        other = checkpoint.Checkpoint(saved.tensors, saved.facts | {"trainer": saved.facts["trainer"] | wrong})
        with pytest.raises(ValueError, match="of other photos than these 4"):
            trainer.resume(other)
    with pytest.raises(ValueError, match="of another kind"):
        trainer.resume(checkpoint.Checkpoint(saved.tensors, saved.facts | {"sky": 0}))
    del saved.facts["trainer"]["order"]
    path = checkpoint.save(tmp_path / "run", saved)
    with pytest.raises(BadInput, match="does not fit its run: TypeError: .*'order'"), checkpoint.fitting(path):
        trainer.resume(saved)


def test_what_a_run_has_counted_and_said_is_remembered(collection, tmp_path):
    trainer, resumed = (Trainer(collection, small_settings(), tmp_path) for _ in range(2))
    trainer.step()
    counted = {"skipped": 7, "skipped_in_a_row": 3, "useless": 11}
    trainer.state = replace(trainer.state, seconds=12.5, mask_mean=0.75, collapse_told=True, **counted)
    saved = checkpoint.load(trainer.save())
    resumed.resume(saved)
    assert resumed.state == trainer.state and resumed.state.done == 1
    resumed.resume(checkpoint.Checkpoint(saved.tensors, saved.facts | {"step": 7}))
    assert resumed.state == replace(trainer.state, done=7)  # there is no second number of steps that could differ
    before = {"step": 1, "trainer": saved.facts["trainer"] | {"done": 1}}  # as older versions wrote it
    resumed.resume(checkpoint.Checkpoint(saved.tensors, saved.facts | before))
    assert resumed.state == trainer.state
    del saved.facts["trainer"]["useless"]  # which they did not count
    resumed.resume(saved)
    assert resumed.state == replace(trainer.state, useless=0)


def test_a_gpu_that_ran_out_of_memory_is_no_fault_of_the_checkpoint(tmp_path):
    with pytest.raises(torch.OutOfMemoryError), checkpoint.fitting(tmp_path / "checkpoint_000002.safetensors"):
        raise torch.OutOfMemoryError("CUDA out of memory.")


def test_damaged_photos_are_left_out_and_named_unless_none_is_left(collection, tmp_path):
    first, *others = collection.photos
    trainer = Trainer(replace(collection, photos=(damage(first), *others)), small_settings(), tmp_path)
    assert [sized.photo.name for sized in trainer.photos] == ["photo_1.png", "photo_3.png", "photo_4.png"]
    (note,) = trainer.photos.notes
    assert (
        re.fullmatch(r"1 photo of the train split that cannot be used: photo_0.png \(ends before .*\)", note)
        and str(tmp_path) not in note
    )
    assert trainer.held_out.notes == [] and next(trainer.train()).step == 1
    hopeless = replace(collection, photos=tuple(map(damage, collection.photos)))
    with pytest.raises(
        BadInput,
        match=r"no photo is left to train on. 4 photos of the train split that cannot be used: photo_0.png \(ends before [^()]*\(truncated\).*\), photo_1",
    ):
        Trainer(hopeless, small_settings(), tmp_path)


@pytest.mark.parametrize("changes", [{}, {"appearance": "off", "transients": "off"}])
def test_a_step_leaves_nothing_in_memory(collection, tmp_path, changes):
    trainer = Trainer(collection, small_settings(**changes), tmp_path)
    met = []

    def read(*given, honest=trainer.model.read):
        found = honest(*given)
        met.append(weakref.ref(found))
        return found

    trainer.model.read = read
    for _ in range(3):
        trainer.step()
    for _ in range(200):  # the thread that looked lets go a moment after it has handed over
        gc.collect()
        if not any(found() for found in met):
            break
        time.sleep(0.01)
    assert [found() for found in met] == [None] * 3


def test_the_sky_keeps_its_shape_and_learns_its_colour(collection, tmp_path):
    trainer, _ = run(collection, tmp_path / "run", small_settings())
    fresh = Trainer(collection, small_settings(), tmp_path / "run").gaussians
    learned = trainer.gaussians
    for name in ("means", "quaternions", "log_scales", "logit_opacities"):
        assert torch.equal(
            learned.parameters[name][-learned.sky_count :], fresh.parameters[name][-fresh.sky_count :]
        ), name
    harmonics = learned.parameters["sh"][-learned.sky_count :]
    # The same from every side.
    assert not torch.equal(harmonics, fresh.parameters["sh"][-fresh.sky_count :]) and not harmonics[:, 1:].any()
