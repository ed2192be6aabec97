"""Looks refined against their photos: of held-out ones always,
of photos from outside where these were taken is found."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import fmean

import cv2
import numpy as np
import pytest
import torch

from core.appearance.colouring import Colouring
from core.appearance.refinement import LATER_STEPS, STEPS, RefinementTarget, refinement
from core.data import load_collection
from core.looks import refined_look, saved_look
from core.looks.find_look import find_look
from core.looks.locate import locate
from core.looks.trained import TrainedRun, bake, blend, drawn
from core.report import Report
from core.scene.cells import cell_sums
from tests.data.room_corner import HEIGHT, WIDTH
from tests.heard import Heard

ORANGE, BLUE = (20, 120, 240), (230, 60, 20)  # B, G, R


def off(trained: TrainedRun, look, name: str = "0.png") -> float:
    """The mean difference, which a refinement makes smaller, between the look,
    seen by the camera of a photo, and that photo."""
    sized = trained.sized_photo(trained.collection.photo(name))
    image = drawn(trained, bake(trained, look), sized.camera)
    return float((image - torch.from_numpy(sized.pixels).float() / 255).abs().mean())


def alike(first: Colouring, second: Colouring) -> bool:
    """Whether two refined looks are the same, bit for bit."""
    pairs = [
        (first.embedding, second.embedding),
        (first.tone, second.tone),
        *((first.changes[name], second.changes[name]) for name in first.changes),
    ]
    return first.changes.keys() == second.changes.keys() and all(torch.equal(*pair) for pair in pairs)


def test_a_crowd_before_the_place_is_not_painted_onto_it(trained, monkeypatch):
    """How far an orange crowd on a seventh of the photo moves what is seen in its look,
    with and without being found strange."""
    sized = trained.sized_photo(trained.collection.photo("0.png"))
    clean = torch.from_numpy(sized.pixels).float() / 255
    crowded, begin, seen = clean.clone(), find_look(trained, "0.png", refine=False), trained.seen_by(sized.camera)
    crowded[HEIGHT // 2 : HEIGHT - 8, WIDTH // 4 : WIDTH // 2] = torch.tensor([0.9, 0.4, 0.05])

    def moved() -> float:
        looks = [refined_look.refined(trained, begin, sized.camera, pixels, None) for pixels in (clean, crowded)]
        with torch.no_grad():
            return float((seen.render(looks[0].colouring) - seen.render(looks[1].colouring)).abs().mean())

    found = moved()
    monkeypatch.setattr("core.appearance.refinement.without_strangers", lambda seen, look, photo: photo)
    assert found < 0.01 and found < 0.5 * moved()


def test_refinement_brings_a_look_closer_to_its_photo(trained):
    heard = Heard()
    encoded, refined = (find_look(trained, "0.png", refine=refine, report=heard) for refine in (False, True))
    assert off(trained, refined) < 0.97 * off(trained, encoded)  # 0.93 was seen, after seconds of training
    assert encoded.source == "held-out photo 0.png" and refined.source == "held-out photo 0.png, refined"
    assert heard.steps[-1] == (STEPS + LATER_STEPS,) * 2
    assert trained.known_range.distance(encoded.colouring.embedding) <= 1 + 1e-5
    # The weights that it gives are refined in its place.
    assert torch.equal(refined.colouring.embedding, encoded.colouring.embedding)
    assert (
        set(refined.colouring.changes) == set(trained.given_spread | trained.model.hidden_weights)
        and encoded.colouring.changes == {}
    )


def test_a_training_photo_is_refined_for_as_long_as_it_is_there(trained):
    """Its look as it was learned is in the run."""
    learned, refined = (find_look(trained, "1.png", refine=refine) for refine in (False, True))
    assert torch.equal(learned.colouring.embedding, trained.photo_embeddings[trained.model.row_of("1.png")])
    assert (
        off(trained, refined, "1.png") < off(trained, learned, "1.png")
        and refined.source == "training photo 1.png, refined"
    )
    photos = tuple(replace(photo, path=photo.path.with_name("gone.png")) for photo in trained.collection.photos)
    kept = find_look(replace(trained, collection=replace(trained.collection, photos=photos)), "1.png")
    assert torch.equal(kept.colouring.embedding, learned.colouring.embedding) and kept.colouring.changes == {}
    assert kept.source.startswith("training photo 1.png, not refined: ") and "gone.png" in kept.source


def test_a_refined_look_is_saved_whole_and_fades_evenly(trained, tmp_path):
    refined, other = find_look(trained, "0.png"), find_look(trained, "2.png")
    (tmp_path / "run").mkdir()
    new = replace(trained, folder=tmp_path / "run")
    saved_look.save(new.folder, replace(refined, name="kept"), new.identity, new.step)
    camera = trained.camera(trained.collection.photo("0.png"))
    frames = [
        trained.seen_by(camera).render(blend(find_look(new, "kept"), other, share / 9).colouring) for share in range(10)
    ]
    assert torch.equal(frames[0], trained.seen_by(camera).render(refined.colouring))
    steps = [float((after - before).abs().mean()) for before, after in pairwise(frames)]
    assert max(steps) <= 2 * fmean(steps)


def test_what_a_photo_does_not_show_stays_as_the_first_part_left_it(trained, monkeypatch):
    """What lies out of view moves less than what is in view, and much less than if nothing held it."""
    sized = trained.sized_photo(trained.collection.photo("0.png"))
    half = sized.camera.cropped(0, 0, sized.camera.width // 2, sized.camera.height)
    seen, photo = (
        trained.seen_by(half),
        RefinementTarget.of(half, torch.from_numpy(sized.pixels[:, : half.width]).float() / 255, None),
    )
    start = find_look(trained, "0.png", refine=False).colouring
    unseen = seen.in_cells(photo.weight).unseen

    @torch.no_grad()
    def moved() -> tuple[float, float]:
        looks = list(refinement(seen, start, photo))
        rows = seen.visible.rows, unseen
        return tuple(
            float((seen.harmonics(each, looks[-1]) - seen.harmonics(each, looks[STEPS])).abs().mean()) for each in rows
        )

    shown, hidden = moved()
    monkeypatch.setattr("core.appearance.refinement.HOLD", 0.0)
    _, free = moved()
    assert 0 < hidden < shown and hidden < 0.5 * free


def test_unseen_is_what_is_out_of_view_behind_something_or_under_a_mask_but_nothing_that_is_not_finite(trained):
    """Two opaque Gaussians on the axis of a camera, one behind the other,
    one that is not finite, and those of the run."""
    photo = trained.collection.photo("0.png")
    camera = trained.camera(photo)
    count = trained.solid_count
    axis = camera.world_to_camera[2]
    tensors = {name: tensor.detach().clone() for name, tensor in trained.splats.tensors().items()}
    for row, depth, size in ((0, 0.2, 0.1), (1, 0.6, 0.002)):
        tensors["means"][row] = torch.as_tensor(camera.centre + depth * axis).float()
        tensors["log_scales"][row], tensors["logit_opacities"][row] = np.log(size), 10.0
    tensors["means"][2] = torch.nan
    made = replace(trained, splats=type(trained.splats)(**tensors))
    seen = made.seen_by(camera)
    everything = torch.ones(camera.height, camera.width)
    unseen = set(seen.in_cells(everything).unseen.tolist())
    assert 0 not in unseen and 1 in unseen and 2 not in unseen and max(unseen) >= count  # sky behind the camera
    left = torch.zeros(camera.height, camera.width)
    left[:, : camera.width // 2] = 1
    masked = set(seen.in_cells(left).unseen.tolist())
    half = made.seen_by(camera.cropped(0, 0, camera.width // 2, camera.height))
    assert unseen < masked
    different = masked ^ set(
        half.in_cells(everything[:, : camera.width // 2]).unseen.tolist()
    )  # wide discs at the edge, whose shape depends on where a picture ends
    assert all(row >= count for row in different) and len(different) < 10


def test_a_photo_from_outside_is_refined_from_where_it_was_taken(trained, tmp_path):
    """A training photo in a light of its own."""
    photo, outside = trained.collection.photo("4.png"), tmp_path / "outside.png"
    pixels = (cv2.imread(str(photo.path)) * (1.2, 0.9, 0.6)).clip(0, 255).astype(np.uint8)
    cv2.imwrite(str(outside), pixels)
    encoded, refined, again = (find_look(trained, str(outside), refine=refine) for refine in (False, True, True))
    shown = [drawn(trained, bake(trained, look), trained.camera(photo)).numpy() for look in (encoded, refined)]
    off = [np.abs(255 * each - pixels[..., ::-1]).mean() for each in shown]
    assert off[1] < 0.97 * off[0]
    assert "from outside the collection, refined from where it was taken (" in refined.source
    assert alike(again.colouring, refined.colouring)


@pytest.mark.parametrize("name", ["2.png", "4.png"])
def test_a_photo_is_located_by_pictures_in_its_own_look(trained, tmp_path, name):
    """Less than 1% of the picture's width off, after seconds of training."""
    outside = tmp_path / "outside.png"
    outside.write_bytes(trained.collection.photo(name).path.read_bytes())
    read = find_look(trained, str(outside), refine=False)
    camera = locate(trained, read, outside, None, Report()).camera
    known = trained.collection.photo(name).camera
    assert (camera.width, camera.height) == (known.width, known.height)
    points = load_collection(trained.collection.read_from).points
    points = points[known.shows(points)[0]]
    off_px = np.linalg.norm(camera.project(points)[0] - known.project(points)[0], axis=1)
    assert np.median(off_px) < 0.01 * WIDTH  # half of that was seen
    refined = find_look(trained, str(outside))
    assert off(trained, refined, name) < off(trained, read, name)
    assert refined.source.startswith(f"{read.source}, refined from where it was taken (")
    assert refined.source.endswith(" places agree)")


def test_a_photo_is_located_alike_by_any_number_of_threads(trained, on_threads):
    path = trained.collection.photo("4.png").path
    found = on_threads(
        (1, 2, 3), lambda: locate(trained, find_look(trained, "4.png", refine=False), path, None, Report())
    )
    assert found[0].camera.numbers() == found[1].camera.numbers() == found[2].camera.numbers()


@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (WIDTH // 6, HEIGHT // 6), (20 * WIDTH, 20)])
def test_a_texture_is_nowhere(trained, tmp_path, size):
    """Edges everywhere, which agree with no picture of the scene."""
    coarse = np.random.default_rng(0).integers(0, 255, (12, 16, 3), np.uint8)
    path = tmp_path / "texture.png"
    cv2.imwrite(str(path), cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC))
    assert locate(trained, find_look(trained, str(path), refine=False), path, None, Report()) is None


def painted_below(trained: TrainedRun, folder: Path, colour: tuple[int, int, int]) -> tuple[Path, Path]:
    """Photo 2.png, the lowest eighth of it of one colour, and a mask that hides that; both in `folder`."""
    pixels, mask = cv2.imread(str(trained.collection.photo("2.png").path)), np.full((HEIGHT, WIDTH), 255, np.uint8)
    pixels[-HEIGHT // 8 :], mask[-HEIGHT // 8 :] = colour, 0
    paths = folder / "photo.png", folder / "mask.png"
    for path, picture in zip(paths, (pixels, mask), strict=True):
        assert cv2.imwrite(str(path), picture)
    return paths


def test_what_a_mask_hides_does_not_tell_where_a_photo_was_taken(trained, tmp_path):
    read = find_look(trained, "2.png", refine=False)
    first, second = (
        locate(trained, read, *painted_below(trained, tmp_path, colour), Report()) for colour in (ORANGE, BLUE)
    )
    assert first.camera.numbers() == second.camera.numbers()


def test_a_photo_of_another_place_keeps_the_look_that_was_read(trained, tmp_path):
    wall = tmp_path / "wall.png"
    cv2.imwrite(str(wall), np.full((HEIGHT, WIDTH, 3), (90, 120, 150), np.uint8))
    encoded, kept = (find_look(trained, str(wall), refine=refine) for refine in (False, True))
    assert torch.equal(kept.colouring.embedding, encoded.colouring.embedding) and kept.colouring.changes == {}
    assert (
        kept.source
        == f"{encoded.source}, not refined: its camera could not be located (too little of it agrees with what the training photos show)"
    )


def test_a_photo_is_located_without_the_scene_and_its_points(trained, tmp_path, few_steps):
    outside = tmp_path / "outside.png"
    outside.write_bytes(trained.collection.photo("4.png").path.read_bytes())
    gone = replace(trained.collection, root=tmp_path / "gone", points_from=None, points=trained.collection.points[:0])
    looks = [find_look(replace(trained, collection=each), str(outside)) for each in (trained.collection, gone)]
    assert alike(looks[0].colouring, looks[1].colouring) and "refined from where it was taken" in looks[1].source


def test_a_large_photo_is_drawn_no_larger_than_those_of_the_run(trained, tmp_path, monkeypatch):
    pixels = cv2.resize(
        cv2.imread(str(trained.collection.photo("4.png").path)), (4 * WIDTH, 4 * HEIGHT), interpolation=cv2.INTER_CUBIC
    )
    cv2.imwrite(str(tmp_path / "large.png"), pixels)
    drawn = []
    monkeypatch.setattr(refined_look, "refined", lambda trained, look, camera, *rest: drawn.append(camera) or look)
    find_look(trained, str(tmp_path / "large.png"), refine=True)
    assert (drawn[0].width, drawn[0].height) == (WIDTH, HEIGHT)


def test_a_mask_too_fine_for_the_size_that_is_drawn_leaves_the_look_as_it_was_read(trained, tmp_path):
    """Three rows of four of a photo that is shrunk to a sixth: no pixel is averaged of used ones alone."""
    pixels = cv2.resize(
        cv2.imread(str(trained.collection.photo("4.png").path)), (6 * WIDTH, 6 * HEIGHT), interpolation=cv2.INTER_CUBIC
    )
    mask = np.full(pixels.shape[:2], 255, np.uint8)
    mask[::4] = 0
    for name, picture in (("photo.png", pixels), ("mask.png", mask)):
        cv2.imwrite(str(tmp_path / name), picture)
    words = str(tmp_path / "photo.png"), tmp_path / "mask.png"
    encoded, kept = (find_look(trained, *words, refine=refine) for refine in (False, True))
    assert torch.equal(kept.colouring.embedding, encoded.colouring.embedding) and kept.colouring.changes == {}
    assert kept.source == f"{encoded.source}, not refined: too little of it is left at the size at which it is drawn"


def test_what_the_mask_of_a_photo_hides_does_not_move_its_look(trained, tmp_path, few_steps):
    looks = []
    for colour in (ORANGE, BLUE):
        photo, mask = painted_below(trained, tmp_path, colour)
        looks.append(find_look(trained, str(photo), mask, refine=True))
    assert alike(looks[0].colouring, looks[1].colouring)


def test_a_run_renders_a_look_as_its_bake_is_rendered(trained, few_steps):
    """float32, and a sum over fewer Gaussians where those out of view are left out."""
    look, camera = find_look(trained, "1.png"), trained.camera(trained.collection.photo("0.png"))
    for tone in (None, torch.tensor([[0.5, 0.7, 0.9], [0.1, 0.2, 0.3]])):
        shown = replace(look, colouring=look.colouring._replace(tone=tone))
        baked = drawn(trained, bake(trained, shown), camera)
        torch.testing.assert_close(trained.seen_by(camera).render(shown.colouring), baked, rtol=0, atol=1e-5)
    embedding = look.colouring.embedding.clone().requires_grad_()
    trained.seen_by(camera).render(Colouring(embedding)).sum().backward()
    assert embedding.grad.abs().max() > 0
    assert trained.splats.means.grad is None and all(
        weight.grad is None for weight in trained.model.encoder.parameters()
    )


def test_cells_show_what_the_picture_shows(trained, few_steps):
    """Sky, tone and a background of its own included: a refinement compares these in place of pictures."""
    camera = trained.camera(trained.collection.photo("0.png"))
    weight = torch.rand(camera.height, camera.width)
    tone = torch.tensor([[0.5, 0.7, 0.9], [0.1, 0.2, 0.3]])
    for run in (trained, replace(trained, settings=trained.settings.changed(sky="none", transparency="empty"))):
        for colouring in (
            find_look(trained, "1.png").colouring,
            find_look(trained, "2.png").colouring._replace(tone=tone),
        ):
            seen = run.seen_by(camera)
            expected = cell_sums(seen.render(colouring) * weight[..., None])
            torch.testing.assert_close(seen.in_cells(weight).sums(colouring), expected, rtol=1e-5, atol=1e-4)
