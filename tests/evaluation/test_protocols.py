"""The two protocols, on a subject whose every figure is known."""

import dataclasses
import json
import math

import cv2
import numpy as np
import pytest
import torch

import core
from core.errors import BadInput, BadSetting
from core.evaluation.protocols import HeldOutView, Scores, ViewResult, compare, fit_of, measure
from core.evaluation.results import Results, measured_earlier
from core.evaluation.truth import Truth, load_truth
from tests.flat_view import FlatView
from tests.small import ring_camera

WIDTH, HEIGHT = 25, 14  # an odd width: the halves are 13 and 12 columns
CAMERA = dataclasses.replace(ring_camera(0.0), width=WIDTH, height=HEIGHT)


class Flat:
    """Renders one colour, its embedding; embeds the mean colour of what it is shown, plus an error."""

    def __init__(self, error=0.0, has_looks=True):
        self.error, self.has_looks, self.shown, self.cameras = error, has_looks, [], []

    def embed(self, picture):
        self.shown.append(tuple(picture.shape))
        return picture.mean(dim=(1, 2)) + self.error

    def mask(self, picture):
        mask = torch.ones(picture.shape[1:])
        mask[:, :10] = 0
        return mask

    def seen_by(self, camera):
        self.cameras.append(camera)
        return FlatView((camera.height, camera.width))


def halves(left, right):
    picture = torch.full((HEIGHT, WIDTH, 3), float(right))
    picture[:, :13] = left
    return picture


def view(**changes):
    return dataclasses.replace(HeldOutView("a.png", halves(0.4, 0.6), CAMERA), **changes)


def test_half_embeds_the_left_and_measures_the_right():
    subject = Flat()
    result, pictures = measure(subject, view(), "half", refine=False)
    assert subject.shown == [(3, HEIGHT, 13)]
    # The left is reproduced; the right is 0.2 off, both on steps of 1/255: 102 and 153.
    assert result.scores["photo"]["zero_shot"].psnr == pytest.approx(-20 * math.log10(51 / 255), abs=1e-4)
    assert "refined" not in result.scores["photo"]
    assert (pictures.render == 102).all() and pictures.photo[0, -1].tolist() == [153] * 3


def test_half_reads_no_colours_of_the_right_where_the_left_is_transparent():
    valid = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    valid[:, 8:13] = False
    embedded = []
    for right in (0.0, 1.0):
        picture = halves(0.4, right)
        picture[:, 8:13] = right  # as a photo is filled when it is loaded
        fit = fit_of(Flat(), view(picture=picture, valid=valid), "half")
        assert torch.equal(fit.region, torch.full((HEIGHT, 13, 3), 102 / 255))
        embedded.append(fit.start)
    assert torch.equal(*embedded)
    assert torch.equal(fit_of(Flat(), view(picture=picture, valid=valid), "full").region, picture)


def test_full_embeds_and_measures_the_whole():
    subject = Flat()
    result, _ = measure(subject, view(), "full", refine=False)
    assert subject.shown == [(3, HEIGHT, WIDTH)]
    mean = round((13 * 102 + 12 * 153) / 25)  # 8-bit level of the mean colour
    squares = (13 * (mean - 102) ** 2 + 12 * (mean - 153) ** 2) / 25
    assert result.scores["photo"]["zero_shot"].psnr == pytest.approx(-10 * math.log10(squares / 255**2), abs=1e-4)


def test_refinement_sees_the_left_half_only_and_mends_the_embedding():
    subject = Flat(error=0.3)
    result, pictures = measure(subject, view(picture=halves(0.4, 0.4)), "half")
    assert pictures.look == "refined"
    assert [(camera.width, camera.cx, camera.cy) for camera in subject.cameras] == [
        (width, CAMERA.cx, CAMERA.cy) for width in (13, WIDTH)
    ]
    photo = result.scores["photo"]
    assert photo["zero_shot"].psnr < 12
    # L1 on a flat colour leaves Adam swinging around it by less than its rate; the best step of 128 is within 0.02.
    assert photo["refined"].psnr > -20 * math.log10(0.02)


def test_pixels_that_show_nothing_are_not_scored():
    valid = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    valid[:, 18:] = False
    picture = halves(0.4, 0.4)
    picture[:, 18:] = 1.0
    for protocol in ("half", "full"):
        subject = Flat()
        subject.embed = lambda shown: torch.full((3,), 0.4)
        scores, _ = measure(subject, view(picture=picture, valid=valid), protocol, refine=False)
        assert scores.scores["photo"]["zero_shot"].psnr == 100.0


def test_a_look_that_follows_nothing_is_not_refined():
    result, pictures = measure(Flat(has_looks=False), view(), "half")
    assert pictures.look is None
    assert set(result.scores["photo"]) == {"zero_shot"}


def test_refinement_ignores_invalid_pixels():
    valid = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    valid[:, 3:13] = False
    picture = halves(0.9, 0.4)
    picture[:, :3] = 0.4
    result, _ = measure(Flat(), view(picture=picture, valid=valid), "half")
    assert result.scores["photo"]["refined"].psnr > -20 * math.log10(0.02)


def test_renders_are_clamped_and_quantised_before_they_are_compared():
    result, _ = measure(Flat(error=5.0), view(picture=halves(0.0, 1.0)), "half", refine=False)
    assert result.scores["photo"]["zero_shot"].psnr == 100.0  # 5 is shown as 1
    result, _ = measure(Flat(error=0.4 / 255), view(picture=halves(0.4, 0.4)), "half", refine=False)
    assert result.scores["photo"]["zero_shot"].psnr == 100.0


def test_clean_truth_is_kept_apart_and_masks_enter_no_metric():
    static = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    static[:, :10] = False
    truth = Truth(halves(0.4, 0.8), static)
    result, _ = measure(Flat(), view(truth=truth), "half", refine=False)
    without, _ = measure(Flat(), view(), "half", refine=False)
    assert result.scores["photo"] == without.scores["photo"]
    assert set(result.scores) == {"photo", "clean", "clean_right"} and set(without.scores) == {"photo"}
    right, all_of_it = (result.scores[name]["zero_shot"].psnr for name in ("clean_right", "clean"))
    assert right == pytest.approx(-20 * math.log10(102 / 255), abs=1e-4)  # of 0.4 and 0.8
    assert all_of_it == pytest.approx(right + 10 * math.log10(25 / 12), abs=1e-4)
    assert result.mask_iou == 1.0 and without.mask_iou is None
    assert set(measure(Flat(), view(truth=truth), "full", refine=False)[0].scores) == {"photo", "clean"}


def test_lpips_is_asked_for_the_region_and_sees_no_error_where_the_photo_is_not_valid():
    asked = []

    def distance(image, photo):
        asked.append(image)
        return float((image - photo).abs().mean())

    result, _ = measure(Flat(), view(), "half", refine=False, lpips=distance)
    assert asked[0].shape == (HEIGHT, 12, 3)
    assert result.scores["photo"]["zero_shot"].lpips == pytest.approx(0.2, abs=1e-6)
    nowhere = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    assert compare(halves(0, 0), halves(1, 1), nowhere, distance).lpips == 0.0


def test_bad_requests_are_refused():
    with pytest.raises(BadSetting, match="quarter"):
        measure(Flat(), view(), "quarter")
    narrow = HeldOutView("narrow.png", torch.zeros(4, 1, 3), dataclasses.replace(CAMERA, width=1, height=4))
    with pytest.raises(BadInput, match=r"narrow\.png"):
        measure(Flat(), narrow, "half")
    left = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    left[:, 13:] = False
    for valid, part in ((left, "that is scored"), (~left, "that gives the look")):
        with pytest.raises(BadInput, match=rf"a\.png has no valid pixel in the part {part}"):
            measure(Flat(), view(valid=valid), "half")
    assert math.isfinite(measure(Flat(), view(valid=left), "full", refine=False)[0].scores["photo"]["zero_shot"].psnr)


# --- truth and results as files


def test_truth_is_read_at_the_size_wanted(tmp_path):
    for kind in ("clean", "masks"):
        (tmp_path / "truth" / kind / "sub").mkdir(parents=True)
    red = np.zeros((8, 10, 3), np.uint8)
    red[..., 2] = 255
    static = np.zeros((8, 10), np.uint8)
    static[:, 5:] = 255
    cv2.imwrite(str(tmp_path / "truth/clean/sub/a.png"), red)
    cv2.imwrite(str(tmp_path / "truth/masks/sub/a.png"), static)
    truth = load_truth(tmp_path, "sub/a.jpg", 20, 16)
    assert truth.clean.shape == (16, 20, 3) and truth.clean[3, 3].tolist() == [1, 0, 0]
    assert not truth.static[:, :10].any() and truth.static[:, 10:].all()
    cv2.imwrite(str(tmp_path / "truth/masks/sub/a.png"), np.array([[0, 127, 128, 255]], np.uint8))
    assert load_truth(tmp_path, "sub/a.jpg", 4, 1).static.tolist() == [[False, False, True, True]]
    assert load_truth(tmp_path, "b.jpg", 20, 16) == Truth(None, None)
    above = tmp_path / "truth" / "a.png"  # a photo, in reach of names that lead out of a folder
    cv2.imwrite(str(above), red)
    assert [load_truth(tmp_path, name, 20, 16).clean for name in (str(above), "../a.png")] == [None, None]
    (tmp_path / "truth/clean/c.png").write_bytes(b"no picture")
    with pytest.raises(BadInput, match=r"c\.png"):
        load_truth(tmp_path, "c.jpg", 20, 16)


def results(*views, **changes):
    made = Results("half", views, "abc", 9, 50, len(views), 0.5, None, 7, 1500, 90.0, 4.0, False, True)
    return dataclasses.replace(made, **changes)


def test_results_state_what_decides_whether_they_can_be_compared(tmp_path):
    views = [measure(Flat(error), view(), "half")[0] for error in (0.0, 0.05)]
    made = results(*views)
    made.save(tmp_path)
    written = json.loads((tmp_path / "results.json").read_text())
    assert written["protocol"] == "half" and written["scale"] == 0.5 and written["seed"] == 7
    assert written["steps"] == 1500 and written["training_seconds"] == 90.0
    assert written["wegs"] == core.__version__ and written["run"] == "abc" and written["gaussians"] == 9
    assert written["photos"] == {"train": 50, "test": 2, "measured": 2}
    assert "mean squared error over all scored pixels" in written["psnr"] and written["psnr"].endswith("at most 100")
    assert written["averaged"] == "each metric over the photos"
    assert (
        "11 x 11 Gaussian" in written["ssim"]
        and "absent" in written["lpips"]
        and "128 steps of the tone" in written["refinement"]
    )
    mean = sum(one.scores["photo"]["zero_shot"].psnr for one in views) / 2
    assert written["means"]["photo"]["zero_shot"]["psnr"] == pytest.approx(mean)
    assert written["means"]["photo"]["zero_shot"]["lpips"] is None
    assert [one["name"] for one in json.loads((tmp_path / "per_view.json").read_text())] == ["a.png", "a.png"]


def test_results_of_another_run_or_step_are_known(tmp_path):
    assert measured_earlier(tmp_path, "abc", 1500) == []
    results(ViewResult("a.png", 9, 9, {"photo": {"zero_shot": Scores(20.0, 0.5, None)}}, None)).save(tmp_path)
    found = [measured_earlier(tmp_path, *now) for now in (("abc", 1500), ("abc", 1600), ("other", 1500))]
    assert found == [[], ["results.json"], ["results.json"]]


def test_figures_are_told_with_their_units_and_a_look_only_where_there_are_several():
    refined, _ = measure(Flat(0.1), view(), "half", lpips=lambda image, photo: 0.25)
    rows = results(refined).rows()
    assert [name for name, _ in rows] == ["photo, zero-shot", "photo, refined"]
    assert [figures.partition("LPIPS")[2] for _, figures in rows] == [" 0.250 (lower is better)", " 0.250"]
    plain, _ = measure(Flat(0.1), view(), "half", refine=False)
    assert results(plain, has_looks=False).rows() == [("photo", "PSNR 19.83 dB  SSIM 0.983")]


def test_results_without_refinement_with_lpips_and_of_an_exact_render(tmp_path):
    one, _ = measure(Flat(), view(picture=halves(0.4, 0.4)), "half", refine=False, lpips=lambda image, photo: 0.25)
    made = results(one, lpips_backbone="alex")
    made.save(tmp_path)
    written = json.loads((tmp_path / "results.json").read_text(), parse_constant=pytest.fail)  # strict JSON
    assert written["means"]["photo"]["zero_shot"]["psnr"] == 100.0
    assert written["means"]["photo"]["zero_shot"]["lpips"] == 0.25
    assert written["lpips"] == "alex" and written["refinement"] is None and written["mask_iou"] is None


def test_figures_of_a_poisoned_render_are_spelled_out(tmp_path):
    one = ViewResult("a.png", 9, 9, {"photo": {"zero_shot": Scores(math.nan, math.inf, None)}}, None)
    results(one).save(tmp_path)
    means, (view,) = (
        json.loads((tmp_path / name).read_text(), parse_constant=pytest.fail)
        for name in ("results.json", "per_view.json")
    )
    assert means["means"] == view["scores"] == {"photo": {"zero_shot": {"psnr": "nan", "ssim": "inf", "lpips": None}}}


def test_what_some_photos_lack_is_averaged_over_the_others():
    figures = ((10.0, 0.5, None, None), (30.0, None, None, 0.25))  # PSNR, SSIM, LPIPS; overlap of masks
    views = [
        ViewResult("a.png", 9, 9, {"photo": {"zero_shot": Scores(*scores)}}, overlap) for *scores, overlap in figures
    ]
    assert results(*views).means() == {"photo": {"zero_shot": {"psnr": 20.0, "ssim": 0.5, "lpips": None}}}
    assert results(*views).mask_iou() == 0.25
