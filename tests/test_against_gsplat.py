"""gsplat's training loop beside a run of plain 3DGS, with strategies that only watch: everything but gsplat itself."""

import json

import pytest
from click.testing import CliRunner

from core.presets import PRESETS
from samples import against_gsplat
from samples.measurements import peer_training
from tests import gsplat_stand_in
from tests.gsplat_stand_in import Watching
from tests.small import finished, small_collection, small_settings

STEPS = 40


@pytest.fixture(scope="module")
def collection(tmp_path_factory):
    return small_collection(tmp_path_factory.mktemp("photos"))


@pytest.fixture
def compared(collection, tmp_path, monkeypatch):
    """The lines of the table, and the strategies that were used."""
    run = finished(collection, small_settings(steps=STEPS, **PRESETS["vanilla"]), tmp_path / "run")
    monkeypatch.setattr(against_gsplat, "usable_peer", lambda _: gsplat_stand_in)
    monkeypatch.setattr(against_gsplat, "load_collection", lambda _: collection)
    monkeypatch.setattr(Watching, "made", [])
    monkeypatch.setattr(peer_training, "STEPS_PER_DEGREE", peer_training.STEPS // 4)
    arguments = [str(run.folder), "--steps", str(STEPS), "--json", str(tmp_path / "rows.json")]
    result = CliRunner().invoke(against_gsplat.main, arguments, catch_exceptions=False)
    assert "| gsplat, mcmc | 40 |" in result.output
    return json.loads((tmp_path / "rows.json").read_text()), Watching.made


def test_both_strategies_are_measured_beside_the_run(compared, collection):
    rows, strategies = compared
    assert [row["method"] for row in rows] == ["wegs", "gsplat, default", "gsplat, mcmc"]
    assert {row["SH degree"] for row in rows} == {"1"}
    assert [row["Gaussians"] for row in rows[1:]] == [str(len(collection.points))] * 2
    assert all(strategy.steps == list(range(STEPS)) for strategy in strategies)


def test_schedules_are_scaled_and_the_limit_is_that_of_the_run(compared):
    _, (default, mcmc) = compared
    assert (default.refine_start_iter, default.refine_stop_iter) == (1, 20)
    assert (default.refine_every, default.reset_every) == (1, 4)
    assert mcmc.cap_max == small_settings().max_gaussians
    assert mcmc.rates[-1] == pytest.approx(peer_training.LAST_MEAN_RATE * mcmc.rates[0], rel=0.2)


def test_the_gaussians_learn_every_parameter(compared, collection):
    for strategy, control in zip(compared[1], peer_training.CONTROLS.values(), strict=True):
        before = peer_training.first_parameters(collection, control, 1, strategy.parameters["means"].device)
        for name in ("means", "scales", "opacities", "sh0", "shN"):
            assert not strategy.parameters[name].equal(before[name]), name


def test_learned_gaussians_come_closer_to_the_photos(compared, collection, tmp_path):
    first, last = (
        [float(row["PSNR / SSIM / LPIPS"].split()[0]) for row in rows[1:]]
        for rows in (one_step(collection, tmp_path), compared[0])
    )
    assert all(after > before for before, after in zip(first, last, strict=True))


def one_step(collection, folder) -> list[dict]:
    """The lines after a single step."""
    file = folder / "first.json"
    CliRunner().invoke(
        against_gsplat.main, [str(folder / "run"), "--steps", "1", "--json", str(file)], catch_exceptions=False
    )
    return json.loads(file.read_text())


def test_the_time_that_gsplat_takes_to_compile_is_not_of_its_training(collection, tmp_path, monkeypatch):
    run, done = finished(collection, small_settings(steps=1, **PRESETS["vanilla"]), tmp_path / "run"), []
    monkeypatch.setattr(against_gsplat, "usable_peer", lambda _: gsplat_stand_in)
    monkeypatch.setattr(against_gsplat, "load_collection", lambda _: collection)
    monkeypatch.setattr(against_gsplat.peer, "picture", lambda *_: done.append("first picture"))
    monkeypatch.setattr(against_gsplat, "trained_by", lambda *_: done.append("training") or run.splats)
    CliRunner().invoke(against_gsplat.main, [str(run.folder), "--steps", "1"], catch_exceptions=False)
    assert done == ["first picture", "training", "training"]


def test_runs_that_are_nothing_to_compare_with_are_refused(collection, tmp_path):
    plain = PRESETS["vanilla"]
    for name, changes, word in (
        ("looks", {}, "has looks"),
        ("cut-out", {**plain, "transparency": "empty", "sky": "none"}, "transparent pixels are empty space"),
        ("cpu", plain, "needs an NVIDIA GPU"),
    ):
        run = finished(collection, small_settings(steps=1, checkpoints=1, **changes), tmp_path / name)
        result = CliRunner().invoke(against_gsplat.main, [str(run.folder)])
        assert result.exit_code == 1 and result.output.count("\n") == 1 and word in result.output
