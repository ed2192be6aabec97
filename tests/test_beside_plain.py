"""Held-out photos are drawn beside plain 3DGS and a run's looks."""

import re

import cv2
import pytest
from click.testing import CliRunner

from core.evaluation.protocols import measure
from core.looks.held_out_views import held_out_view
from core.looks.trained import load_run
from samples import beside_plain
from tests.small import HEIGHT, WIDTH, finished, small_collection, small_settings


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A run with looks, and one without, of the same scene."""
    folder = tmp_path_factory.mktemp("runs")
    collection = small_collection(tmp_path_factory.mktemp("scene"))
    settings = {"looks": small_settings(steps=4), "plain": small_settings(steps=4, appearance="off", transients="off")}
    return [str(finished(collection, each, folder / name).folder) for name, each in settings.items()]


def drawn(*line: str) -> str:
    return CliRunner().invoke(beside_plain.main, line).output


def test_a_row_for_each_photo_with_the_figures_of_the_evaluation(runs, tmp_path, few_steps):
    sheet = tmp_path / "sheet.jpg"
    told = drawn(*runs, "-o", str(sheet))
    height, width, _ = cv2.imread(str(sheet)).shape
    assert told.endswith(f"{sheet}: {width}x{height} px\n") and width > 4 * WIDTH and height > 2 * HEIGHT
    trained, plain = map(load_run, map(beside_plain.Path, runs))
    photo = trained.collection.photo("photo_5.png")
    scores, unlit = (measure(run, held_out_view(run, photo), "full")[0].scores["photo"] for run in (trained, plain))
    expected = [scores["zero_shot"].psnr, scores["refined"].psnr]
    line = re.search(r"photo_5.png  plain (\S+) dB, zero-shot (\S+) dB, refined (\S+) dB", told)
    assert [float(figure) for figure in line.groups()] == pytest.approx([unlit["zero_shot"].psnr, *expected], abs=0.051)
    one = drawn(*runs, "--photo", "photo_2.png", "-o", str(tmp_path / "one.jpg"))
    assert "photo_2.png  plain" in one and "photo_5.png" not in one


def test_what_cannot_be_compared_is_refused(runs, tmp_path):
    looks, plain = runs
    assert "has looks, which plain 3DGS has not." in drawn(looks, looks, "-o", str(tmp_path / "a.jpg"))
    assert "has one look only" in drawn(plain, plain, "-o", str(tmp_path / "a.jpg"))
    (tmp_path / "a.jpg").touch()
    assert "--force" in drawn(looks, plain, "-o", str(tmp_path / "a.jpg"))
