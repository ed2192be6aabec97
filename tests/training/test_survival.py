"""Runs on what real collections hold: they end with a picture, say what was wrong, and stop only with a checkpoint."""

import csv
import json
import math
from dataclasses import replace

import cv2
import numpy as np
import plyfile
import pytest
import torch

from core import pipeline
from core.appearance.transfer_kernels import STRIP
from core.data import load_collection
from core.errors import TrainingStopped
from core.export.ply import read_ply
from core.looks.find_look import find_look
from core.looks.trained import bake, load_run
from core.rasterizer import create
from core.run import checkpoint
from core.training.gaussians.densify import ALL_GONE
from core.training.losses import mask_weights
from core.training.mask_files import write_masks
from core.training.trainer import SKIPS_TO_STOP, Trainer
from tests.data.checks import notes_with
from tests.data.small_scene import SmallScene
from tests.small import HEIGHT, WIDTH, small_collection, small_settings, trained_to_the_end
from tests.training.learned import assert_same, copied, learned


def run(collection, folder, **changes):
    """A finished run: its trainer, and everything it said."""
    folder.mkdir()
    trainer = Trainer(collection, small_settings(**changes), folder)
    messages = [message for report in trainer.train() for message in report.messages]
    for name, tensor in learned(trainer).items():
        assert torch.isfinite(tensor).all(), name
    return trainer, messages


# --- where the world lies and how large it is


def trained_quality(scene: SmallScene, folder) -> float:
    """Held-out PSNR (dB) of a run from files to files; the .ply, read back, shows what the live model shows."""
    root = scene.write(folder / "scene")
    settings = small_settings(steps=60, held_out_checks=1, prune_contribution=0.0)
    output = pipeline.train(root, settings, folder / "run")
    trained = load_run(output)
    live = bake(trained, find_look(trained, "neutral"))
    frame, camera = trained.collection.frame.for_files(), trained.collection.photos[0].camera
    from_file = read_ply(output / f"point_cloud/iteration_{settings.steps}/point_cloud.ply").in_scene(frame)
    pictures = [create("cpu").render(splats, camera) for splats in (live, replace(from_file, sh=from_file.sh[:, :4]))]
    # A file in the world frame rounds coordinates by up to 1e-5 of the scene: 2e-3 px here, times colours of order 1.
    torch.testing.assert_close(*pictures, rtol=0, atol=5e-3)
    with (output / "history.csv").open() as file:
        return float(list(csv.DictReader(file))[-1]["held_out_psnr"])


def test_a_georeferenced_or_tiny_or_huge_world_is_learned_as_well(tmp_path):
    """COLMAP's files in, .ply out: an offset of 5e6 and units of 1e-4 and 1e4 cost nothing."""
    qualities = {}
    for name, changes in {
        "plain": {},
        "far": {"offset": np.array([5e6, -5e6, 300.0])},
        "tiny": {"unit": 1e-4},
        "huge": {"unit": 1e4},
    }.items():
        (tmp_path / name).mkdir()
        qualities[name] = trained_quality(SmallScene(**changes), tmp_path / name)
    # Cameras and points come back with other last digits; sixty steps of training amplify them to some hundredths.
    assert qualities["plain"] > 15
    assert all(abs(quality - qualities["plain"]) < 0.3 for quality in qualities.values()), qualities


def test_files_of_a_world_far_off_are_moved_and_say_so(tmp_path):
    scene = SmallScene(offset=np.array([5e6, -5e6, 300.0])).write(tmp_path / "scene")
    collection = load_collection(scene)
    (note,) = notes_with(collection, "far from the origin")
    assert "by 0.3 units" in note and "around (5000000" in note
    output = pipeline.train(scene, small_settings(steps=2), tmp_path / "run")
    ply = next(output.glob("point_cloud/*/point_cloud.ply"))
    header = ply.read_bytes()[:3000].decode("ascii", "ignore")
    assert "files are written around (5000000" in header
    assert float(read_ply(ply).means.norm(dim=1).median()) < 100
    # The viewers' cameras and points move along.
    points = plyfile.PlyData.read(str(output / "input.ply"))["vertex"]
    cameras = json.loads((output / "cameras.json").read_text())
    assert np.abs([points[axis] for axis in "xyz"]).max() < 10
    assert np.abs([camera["position"] for camera in cameras]).max() < 10


# --- cameras and photos that are wrong


def with_camera(collection, **changes):
    """The collection with its first camera changed."""
    first, *others = collection.photos
    return replace(collection, photos=(replace(first, camera=replace(first.camera, **changes)), *others))


def with_picture(collection, index, level):
    """The collection with one photo of a single grey."""
    photos = list(collection.photos)
    path = photos[index].path.with_name(f"level_{level}_{index}.png")
    assert cv2.imwrite(str(path), np.full((HEIGHT, WIDTH, 3), level, np.uint8))
    photos[index] = replace(photos[index], path=path)
    return replace(collection, photos=tuple(photos))


SPOILT = {
    "focal length of 3e6 px": lambda given: with_camera(given, fx=3e6, fy=3e6),
    "focal length of 1e-3 px": lambda given: with_camera(given, fx=1e-3, fy=1e-3),
    "camera a million units off": lambda given: with_camera(given, centre=np.array([1e6, 0.0, 0.0])),
    "camera in the middle of the points": lambda given: with_camera(given, centre=np.zeros(3)),
    "camera that looks away": lambda given: with_camera(
        given, world_to_camera=np.diag([-1.0, 1.0, -1.0]) @ given.photos[0].camera.world_to_camera
    ),
    "a black and a white photo": lambda given: with_picture(with_picture(given, 0, 0), 1, 255),
    "photos without points": lambda given: replace(
        given, photos=tuple(replace(photo, points=np.zeros(0, np.int64)) for photo in given.photos)
    ),
}


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    """Held-out PSNR (dB) of the collection as it is."""
    folder = tmp_path_factory.mktemp("healthy")
    return run(small_collection(folder, photos=9), folder / "run", steps=50)[0].held_out_quality()[0]


@pytest.mark.parametrize("fault", SPOILT)
def test_one_bad_camera_or_photo_does_not_spoil_the_rest(tmp_path, healthy, fault):
    collection = SPOILT[fault](small_collection(tmp_path, photos=9))
    trainer, messages = run(collection, tmp_path / "run", steps=50)
    assert messages == [] and trainer.state.skipped == 0
    # One or two of six training photos teach nothing or something wrong; the lessons of the others must hold.
    assert trainer.held_out_quality()[0] > healthy - 1.5


def test_a_single_photo_and_photos_that_are_all_the_same(collection, tmp_path):
    """Their embeddings have no spread to be amplified; they are learned like any other photo."""
    first = collection.photos[0]
    alike = replace(collection, photos=tuple(replace(first, name=f"{i}.png", split="train") for i in range(3)))
    for name, given in (("one", replace(collection, photos=(first,))), ("alike", alike)):
        folder = tmp_path / name
        folder.mkdir()
        reports = list(Trainer(given, small_settings(steps=60), folder).train())
        assert max(report.picture_loss for report in reports) < 0.6  # the start costs 0.3; diverging ones pass 1
        assert reports[-1].picture_loss < 0.15


@pytest.mark.parametrize("points", [1, 50])
def test_points_in_one_place_allow_gaussians_around_them(collection, tmp_path, points):
    same = [np.repeat(array[:1], points, axis=0) for array in (collection.points, collection.point_colours)]
    trainer, _ = run(
        replace(collection, points=same[0], point_colours=same[1]), tmp_path / "run", prune_contribution=0.0
    )
    assert trainer.gaussians.solid_count > 0


@pytest.mark.parametrize("changes", [{}, {"sky": "none"}, {"sky": "none", "appearance": "off", "transients": "off"}])
def test_a_run_that_loses_all_its_gaussians_says_so_and_goes_on(collection, tmp_path, changes):
    trainer, messages = run(collection, tmp_path / "run", prune_opacity=1.0, **changes)
    assert (trainer.gaussians.solid_count, trainer.state.done) == (0, 40)
    assert messages == [ALL_GONE]


def test_a_view_of_nothing_is_a_step_like_any_other(collection, tmp_path):
    """Without a sky a camera that looks away sees no Gaussian at all."""
    away = np.diag([-1.0, 1.0, -1.0])
    blind = tuple(
        replace(photo, camera=replace(photo.camera, world_to_camera=away @ photo.camera.world_to_camera))
        for photo in collection.photos
    )
    before = Trainer(collection, small_settings(sky="none", steps=9), tmp_path).gaussians.parameters
    unchanged = {"densify_from": 1.0, "densify_until": 1.0, "prune_contribution": 0.0}
    trainer, messages = run(replace(collection, photos=blind), tmp_path / "run", sky="none", steps=9, **unchanged)
    assert messages == [] and trainer.state.skipped == 0
    assert_same(trainer.gaussians.parameters, before)


# --- masks


def test_masks_that_collapse_are_held_and_it_is_said_once(collection, tmp_path):
    """Nothing keeps these masks from collapsing: they start at a tenth, and hiding is free."""
    folder = tmp_path / "run"
    folder.mkdir()
    trainer = Trainer(collection, small_settings(mask_regularisation=0.0, mask_start=0.0, mask_apply=0.1), folder)
    torch.nn.init.constant_(trainer.model.encoder.unet.up_2.bias, -2.2)
    messages = [message for report in trainer.train() for message in report.messages]
    (message,) = messages
    assert "masks hide" in message and "raise mask_regularisation" in message
    assert trainer.state.mask_mean < mask_weights.LEAST_STATIC
    mask = trainer.model.read(trainer.photos[0].encoder_input, 0).mask
    weights = mask_weights.pixel_weights(trainer.photos.target(0, 1)[1].to_pixels(mask), mask.detach().mean())
    # Bilinear resizing moves the mean a little.
    assert float(weights.mean()) == pytest.approx(mask_weights.LEAST_STATIC, abs=0.02)


def test_masks_that_are_not_applied_yet_cause_no_warning(collection, tmp_path):
    settings = small_settings(mask_regularisation=0.0, mask_start=0.0, mask_apply=1.0)
    trainer = Trainer(collection, settings, tmp_path)
    torch.nn.init.constant_(trainer.model.encoder.unet.up_2.bias, -2.2)
    assert [message for report in trainer.train() for message in report.messages] == []
    assert trainer.state.mask_mean < mask_weights.LEAST_STATIC


def test_masks_of_photos_with_odd_names_stay_in_the_run(collection, tmp_path):
    trainer = Trainer(collection, small_settings(), tmp_path)
    theirs = tmp_path / "photos" / "absolute.png"
    names = [str(theirs.with_suffix(".jpg")), "../above.jpg", "left/0001.jpg"]
    for number, name in enumerate(names):
        sized = trainer.photos[number]
        trainer.photos.photos[number] = replace(sized, photo=replace(sized.photo, name=name))
    write_masks(tmp_path / "run", trainer.model, trainer.photos)
    assert not theirs.exists() and not (tmp_path / "run" / "above.png").exists()
    assert all((tmp_path / "run" / "masks" / name).is_file() for name in ("absolute.png", "above.png", "left/0001.png"))


# --- losses and gradients that are wrong


def spoil(trainer, steps, change):
    """Let `change` be done to the picture losses of the next `steps` steps."""
    honest, left = trainer.objective.picture, [steps]

    def picture_loss(*arguments):
        left[0] -= 1
        loss = honest(*arguments)
        return change(loss) if left[0] >= 0 else loss

    trainer.objective.picture = picture_loss


class NanBackward(torch.autograd.Function):
    """A loss as it is, with a gradient that is not."""

    @staticmethod
    def forward(ctx, loss):
        return loss.clone()

    @staticmethod
    def backward(ctx, gradient):
        return gradient * math.nan


WRONG = {
    "loss was not finite": lambda loss: loss * math.nan,
    "was a spike; usual is": lambda loss: loss * 1e4,
    "gradient was not finite": NanBackward.apply,
}


@pytest.mark.parametrize("words", WRONG)
def test_an_invalid_step_is_skipped_counted_and_leaves_no_trace(collection, tmp_path, words):
    trainer = Trainer(collection, small_settings(), tmp_path)
    for _ in range(12):
        trainer.step()
    before = copied(learned(trainer))
    spoil(trainer, 1, WRONG[words])
    (message,) = trainer.step().messages
    assert message.startswith("Step 13 was skipped: its ") and words in message and "(photo photo_" in message
    assert_same(learned(trainer), before)
    assert trainer.step().messages == () and (trainer.state.skipped, trainer.state.skipped_in_a_row) == (1, 0)
    assert int(trainer.model.remembered) == 13  # of the photos read in 14 steps


def test_an_encoder_whose_gradient_overflows_keeps_only_the_networks_from_learning(collection, tmp_path):
    """This is noticed only after the Gaussians, whose gradients were finite, have been updated."""
    trainer = Trainer(collection, small_settings(), tmp_path)
    trainer.step()
    overflowing = next(trainer.model.encoder.parameters()).register_hook(lambda gradient: gradient + math.inf)
    networks = copied(trainer.model.state_dict())
    harmonics = trainer.gaussians.splats.sh.clone()
    (message,) = trainer.step().messages
    assert message.startswith("Step 2 taught the networks nothing: its networks' gradient was not finite (photo ")
    assert not torch.equal(trainer.gaussians.splats.sh, harmonics)
    assert_same(trainer.model.state_dict(), networks)
    overflowing.remove()
    assert trainer.step().messages == () and trainer.state.skipped == 1


@pytest.mark.parametrize("words", WRONG)
def test_several_in_a_row_stop_with_a_checkpoint_that_goes_on_bit_for_bit(collection, tmp_path, words):
    folder = tmp_path / "run"
    folder.mkdir()
    trainer = Trainer(collection, small_settings(), folder)
    for _ in range(12):
        trainer.step()
    spoil(trainer, SKIPS_TO_STOP, WRONG[words])
    trainer.density.grow_at, few = [22], trainer.gaussians.solid_count
    with pytest.raises(TrainingStopped, match=f"{SKIPS_TO_STOP} steps in a row.*{words}.*Saved .*checkpoint_000022"):
        trained_to_the_end(trainer)
    assert trainer.gaussians.solid_count > few  # a round of growth was due just then
    resumed = Trainer(collection, small_settings(), folder)
    resumed.resume(checkpoint.load(checkpoint.newest(folder)))
    assert (resumed.state.skipped, resumed.state.skipped_in_a_row, resumed.state.last_losses) == (
        10,
        0,
        trainer.state.last_losses,
    )
    assert trainer.step() == resumed.step()


def test_an_odd_photo_is_no_spike(collection, tmp_path):
    """A white photo among black ones costs a hundred times what is usual, and is learned all the same."""
    for index in range(len(collection.photos)):
        collection = with_picture(collection, index, 255 if index == 4 else 0)
    trainer, messages = run(replace(collection, point_colours=0 * collection.point_colours), tmp_path / "run", steps=30)
    assert messages == [] and None not in trainer.state.last_losses


def test_any_number_of_threads_trains_the_same_bits(collection, tmp_path, on_threads, monkeypatch):
    for size in ("losses.photometric_cpu.BLOCK_PIXELS", "gaussians.adam.ROWS_PER_BLOCK"):
        monkeypatch.setattr(f"core.training.{size}", 64)
    monkeypatch.setattr("core.rasterizer.cpu.backend.ROWS_PER_BLOCK", 64)
    monkeypatch.setattr("core.appearance.transfer_mlp.ROWS", STRIP)

    def found():
        return learned(run(collection, tmp_path / str(torch.get_num_threads()))[0])

    first, *others = on_threads((1, 2, 4), found)
    for other in others:
        assert_same(other, first)
