"""A look as a file: what is left out of it, and what is said about that."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from core.export.ply import read_ply, sky_count_in
from core.looks.find_look import find_look
from core.looks.look_file import write_look
from core.looks.pruning import Pruned, Pruner, pruner_of
from core.looks.trained import TrainedRun
from core.training.tell import next_step
from core.words import counted
from tests.heard import Heard
from tests.small import finished, small_collection, small_settings

ROW_BYTES = 248  # of a Gaussian in a vanilla .ply


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> TrainedRun:
    """A finished run whose photos are gone."""
    scene, folder = (tmp_path_factory.mktemp(name) for name in ("scene", "run"))
    torch.manual_seed(0)
    trained = finished(small_collection(scene), small_settings(steps=4), folder)
    shutil.rmtree(scene)
    return trained


def test_gaussians_that_no_view_shows_are_left_out_and_counted_without_the_photos(trained, tmp_path):
    faded = trained.splats.map(torch.clone)
    faded.logit_opacities[:7] = -20
    trained = replace(trained, splats=faded)
    heard, neutral = Heard(), find_look(trained, "neutral")
    paths = [tmp_path / "all.ply", tmp_path / "fewer.ply"]
    assert write_look(trained, neutral, paths[0], heard, None) == len(trained.splats)
    assert heard.lines == []
    pruner = pruner_of(trained, heard)
    written = write_look(trained, neutral, paths[1], heard, pruner)
    gone = len(trained.splats) - written
    assert gone >= 7 and pruner.kept[-trained.sky_count :].all()
    (line,) = heard.lines
    assert line == f"Left out {counted(gone, 'Gaussian')}: no training view changes; `wegs bake --prune off` keeps all"
    assert [len(read_ply(path)) for path in paths] == [len(trained.splats), written]
    # Digits of the count.
    assert paths[0].stat().st_size - paths[1].stat().st_size == pytest.approx(gone * ROW_BYTES, abs=2)


def test_bands_that_no_view_shows_are_left_out_and_named(trained, tmp_path, monkeypatch):
    pruner, heard = pruner_of(trained, Heard()), Heard()
    monkeypatch.setattr(Pruner, "__call__", lambda _, baked: Pruned(baked.up_to_degree(0), bands=1, largest=0.25))
    write_look(trained, find_look(trained, "neutral"), tmp_path / "a.ply", heard, pruner)
    bound = "in no training view does a pixel change by more than 0.25 of 255; `wegs bake --prune off` keeps all"
    assert heard.lines == [f"Left out the SH bands above degree 0 (zeros in a .ply): {bound}"]


def test_gaussians_that_cannot_be_drawn_are_left_out_and_counted(trained, tmp_path):
    broken, heard = trained.splats.map(torch.clone), Heard()
    broken.means[:2] = torch.nan
    trained = replace(trained, splats=broken)
    written = write_look(trained, find_look(trained, "neutral"), tmp_path / "a.ply", heard, None)
    assert written == len(read_ply(tmp_path / "a.ply")) == len(broken) - 2
    assert heard.lines == ["! a.ply: 2 Gaussians that cannot be drawn (NaN, Inf or a zero quaternion) left out."]


def test_a_look_can_be_written_without_the_sky(trained, tmp_path):
    paths, neutral = [tmp_path / "all.ply", tmp_path / "place.ply"], find_look(trained, "neutral")
    counts = [
        write_look(trained, neutral, path, Heard(), None, sky) for path, sky in zip(paths, (True, False), strict=True)
    ]
    assert [sky_count_in(path) for path in paths] == [trained.sky_count, 0]
    assert trained.sky_count > 0 and counts == [len(trained.splats), trained.solid_count]
    whole, place = (read_ply(path) for path in paths)
    assert all(
        torch.equal(part[: len(place)], other)
        for part, other in zip(whole.tensors().values(), place.tensors().values())
    )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "any photo; then open look.ply"),
        ({"embedding": "glo"}, "the name of a training photo; then open look.ply"),
        ({"appearance": "off"}, "open neutral.ply in a 3DGS viewer   (all looks of this run are one)"),
    ],
)
def test_the_next_step_is_one_that_this_run_can_take(trained, changes, words):
    changed = replace(trained, settings=trained.settings.changed(**changes))
    advice = next_step(changed.folder, changed.settings, Path("neutral.ply"))
    assert words in advice and ("wegs bake --run" in advice) == ("look.ply" in advice)
