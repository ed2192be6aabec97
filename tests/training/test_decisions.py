"""Which parts are left out of which scene, what may overrule that, and that nothing is left of them."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from core import automatic, config, pipeline
from core.config import Settings
from core.data import load_collection
from core.pipeline import training
from core.presets import preset
from core.run import checkpoint, run_config
from core.run.sized_photo import Sizes
from core.training import decisions
from core.training.evidence import Evidence
from core.training.sized_photos import SizedPhotos
from core.training.trainer import Trainer
from tests.data.converted import write_processed
from tests.failing import failing
from tests.heard import Heard
from tests.paths import PLAZA
from tests.real_data import real
from tests.small import trained_to_the_end
from tests.training.known_scene import crowded, exposed, known_collection, lit, plain
from tests.training.learned import assert_same

SMALL = {
    "max_gaussians": 600,
    "sky_gaussians": 60,
    "densify_rounds": 4,
    "encoder_side_px": 32,
    "checkpoints": 1,
    "device": "cpu",
}


def decided_for(collection, settings: Settings | None = None, change=lambda photo: photo) -> dict:
    """What is decided for the training photos, by setting; `change` may alter them."""
    photos = SizedPhotos(collection.split("train"), Sizes.of(Settings(encoder_side_px=32), collection.photos)).photos
    decided, taken = decisions.decide(settings or Settings(), collection.points, list(map(change, photos)))
    assert not decided.undecided
    assert all(getattr(decided, decision.setting) == decision.value for decision in taken)
    return {decision.setting: decision for decision in taken}


def values(taken: dict) -> tuple:
    return tuple(taken[name].value for name in ("appearance", "transients"))


# --- what is decided


@pytest.mark.parametrize(
    "change, expected",
    [(plain, ("off", "off")), (exposed, ("exposure", "off")), (lit, ("full", "off")), (crowded, ("off", "on"))],
)
def test_each_part_is_kept_where_photos_need_it(tmp_path, change, expected):
    assert values(decided_for(known_collection(tmp_path, change))) == expected


def test_a_wild_collection_keeps_everything():
    taken = decided_for(load_collection(PLAZA))
    assert values(taken) == ("full", "on")
    # 4 %: light changes far more than the viewing direction.
    assert taken["sh_degree"].figure < 0.6 * decisions.LEAST_VIEW_DEPENDENCE
    assert taken["appearance"].figure > 3 * decisions.LEAST_SPREAD_BEYOND_EXPOSURE  # 12.9
    assert taken["transients"].figure > 2 * decisions.LEAST_STRANGE_SHARE  # 4.9 %


def test_a_copy_in_nerfstudios_format_is_judged_alike(tmp_path):
    given = load_collection(PLAZA)
    lists = {f"{split}_filenames": [photo.name for photo in given.split(split)] for split in ("train", "test")}
    copy, original = (
        decided_for(load_collection(write_processed(PLAZA, tmp_path / "copy", **lists))),
        decided_for(given),
    )
    for name, decision in original.items():
        assert copy[name].value == decision.value and copy[name].figure == pytest.approx(decision.figure, rel=1e-6)


def test_a_real_collection_too_small_to_teach_masks_gets_none():
    taken = decided_for(load_collection(real("kermit")))
    assert taken["transients"].value == "off" and taken["transients"].figure is None


@pytest.mark.parametrize("name", ["sacre_coeur", "statue_of_liberty"])
def test_real_wild_collections_keep_everything(name):
    taken = decided_for(load_collection(real(name)))
    assert values(taken) == ("full", "on") and taken["sh_degree"].value == 1


def test_a_real_calm_collection_needs_no_looks_and_no_masks():
    taken = decided_for(load_collection(real("fountain")))
    assert values(taken) == ("off", "off") and taken["sh_degree"].value == 1
    assert taken["appearance"].figure < 0.7 * decisions.LEAST_COLOUR_SPREAD  # 3.6: the camera's own exposure wanders
    assert taken["transients"].figure < 0.1 * decisions.LEAST_STRANGE_SHARE


def test_a_real_calm_collection_in_other_exposures_needs_these_alone():
    random = np.random.default_rng(0)

    def exposed_again(sized):
        pixels = sized.pixels * np.exp(0.25 * random.normal())
        return replace(sized, pixels=pixels.clip(0, 255).astype(np.uint8))

    assert values(decided_for(load_collection(real("fountain")), change=exposed_again)) == ("exposure", "off")


def test_too_little_to_judge_by_keeps_looks_and_says_so(tmp_path):
    taken = decided_for(known_collection(tmp_path, lit, photos=3))
    assert values(taken) == ("full", "off") and taken["sh_degree"].value == decisions.USUAL_DEGREE
    for decision in taken.values():
        assert decision.figure is None and "too" in decision.because


def test_figures_on_either_side_of_a_bound_decide():
    def evidence(**figures):
        usual = {
            "photos": 20,
            "colour_spread": 20.0,
            "spread_beyond_exposure": 9.0,
            "view_dependence": 0.9,
            "strange_share": 0.1,
        }
        return Evidence(**usual | figures)

    for seen, why in (
        (evidence(strange_share=None), "fewer than 300 places"),
        (Evidence(20), "too few points are known to be shared by photos to tell"),
    ):
        decision = decisions.judge_transients(seen)
        assert decision.value == "on" and why in decision.because
        assert "whether there are passers-by; `--transients off` leaves masks out" in decision.because
        decision = decisions.judge_transients(replace(seen, photos=19))
        assert decision.value == "off" and why in decision.because
        assert "19 photos hardly teach what these look like; `--transients on`" in decision.because
    because = decisions.judge_appearance(Evidence(3)).because
    assert "to tell whether their light differs; `--appearance off` leaves looks out" in because
    assert decisions.judge_appearance(evidence(colour_spread=decisions.LEAST_COLOUR_SPREAD - 0.01)).value == "off"
    assert (
        decisions.judge_appearance(evidence(spread_beyond_exposure=decisions.LEAST_SPREAD_BEYOND_EXPOSURE - 0.01)).value
        == "exposure"
    )
    assert decisions.judge_appearance(evidence()).value == "full"
    assert decisions.judge_transients(evidence(strange_share=decisions.LEAST_STRANGE_SHARE - 0.001)).value == "off"
    assert decisions.judge_transients(evidence(strange_share=decisions.LEAST_STRANGE_SHARE)).value == "on"
    assert decisions.judge_sh_degree(evidence(view_dependence=decisions.LEAST_VIEW_DEPENDENCE - 0.01)).value == 0
    assert decisions.judge_sh_degree(evidence()).value == 1


# --- who may overrule it


def test_what_has_a_default_that_depends_on_the_photos_may_be_left_to_them():
    assert {*automatic.LEAST, *automatic.WITHOUT_LOOKS, *automatic.WITH_LOOKS, *decisions.JUDGES} <= set(
        config.DECIDABLE
    )


def test_what_is_given_is_not_decided(tmp_path, monkeypatch):
    collection = known_collection(tmp_path, plain, photos=12)
    taken = decided_for(collection, Settings(appearance="exposure", sh_degree=2))
    assert list(taken) == ["transients"]
    monkeypatch.setattr(decisions, "gather_evidence", None)  # not even looked at
    assert decided_for(collection, Settings(appearance="full", transients="on", sh_degree=0)) == {}
    assert decided_for(collection, preset("paper")) == {}


def test_steps_and_gaussians_follow_photos_and_pixels_unless_given():
    def sizes(photos, width, **given):
        sized = [SimpleNamespace(camera=SimpleNamespace(width=width, height=100), empty=None)] * photos
        settings = Settings(appearance="off", transients="off", sh_degree=0).changed(**given)
        decided, _ = decisions.decide(settings, None, sized)
        return decided.steps, decided.max_gaussians

    # The table in the README.
    assert sizes(1, 100) == sizes(20, 768) == sizes(25, 100) == (3000, 40_000)
    assert sizes(40, 100) == (4800, 40_000)
    assert sizes(52, 768) == sizes(85, 100) == (6000, 40_000)
    assert sizes(200, 100) == (14_000, 93_000)
    assert sizes(50, 8000) == (6000, 80_000)
    assert sizes(200, 8000, steps=5, max_gaussians=7) == (5, 7)


def test_schedules_follow_the_looks_unless_given():
    for appearance, expected in (("off", (0.0, 0.02, 0.0)), ("exposure", (0.1, 0.12, 0.2)), ("full", (0.1, 0.12, 0.2))):
        settings = Settings().decided(appearance=appearance)
        assert (settings.geometry_from, settings.densify_from, settings.prune_contribution) == expected
    assert Settings(geometry_from=0.3).decided(appearance="off").geometry_from == 0.3
    assert Settings(appearance="off").decided(appearance="full").geometry_from == 0.0
    assert Settings(densify_until=0.1).decided(appearance="full").densify_from == 0.1


def test_the_fewer_steps_the_faster_scales_learn_unless_given():
    for steps, rate in ((600, 0.024), (1200, 0.024), (3000, 0.016), (6000, 0.008), (40_000, 0.008)):
        assert Settings(steps=steps).decided(appearance="full").scale_rate == rate
    assert Settings(steps=600, scale_rate=0.1).decided(appearance="full").scale_rate == 0.1


# --- nothing is left of what is off


@pytest.fixture(scope="module")
def calm(tmp_path_factory):
    return known_collection(tmp_path_factory.mktemp("calm"), plain, photos=12)


def trained(collection, folder: Path, settings: Settings) -> Trainer:
    folder.mkdir()
    return trained_to_the_end(Trainer(collection, settings, folder))


def test_a_calm_collection_trains_as_plain_3dgs_bit_for_bit(calm, tmp_path):
    """Same quality, steps and bytes: it is the same run."""
    auto = trained(calm, tmp_path / "auto", Settings(steps=20, **SMALL))
    assert [decision.value for decision in auto.decisions][:2] == ["off", "off"]
    vanilla = trained(calm, tmp_path / "vanilla", preset("vanilla").changed(steps=20, **SMALL))
    assert auto.settings == vanilla.settings
    files = [checkpoint.newest(trainer.folder) for trainer in (auto, vanilla)]
    assert_same(*(checkpoint.load(file).tensors for file in files))


def test_parts_that_are_off_have_no_weights_no_losses_and_no_bytes(calm, tmp_path, monkeypatch):
    from core.training.losses import mask_weights, objective, regularisers

    never = failing(AssertionError("a loss of a part that is off was computed"))
    monkeypatch.setattr(mask_weights, "pixel_weights", never)
    for name in ("transient_rows", "residual_norm"):
        monkeypatch.setattr(regularisers, name, never)
    monkeypatch.setattr(objective, "mask_loss", never)
    trainer = trained(calm, tmp_path / "run", Settings(steps=20, sh_degree=0, **SMALL))
    assert not list(trainer.model.parameters()) and not trainer.optimizer.learners
    tensors = checkpoint.load(checkpoint.newest(trainer.folder)).tensors
    assert tensors["gaussians.parameters.sh"].shape[1:] == tensors["gaussians.first.sh"].shape[1:] == (1, 3)
    parts = {name.partition(".")[0] for name in tensors}
    assert parts == {"gaussians", "model", "random"} and "gaussians.parameters.latents" not in tensors
    neutral = trainer.settings.embedding_size + 1  # the mean look, zeros, and how many entered it
    assert sum(t.numel() for name, t in tensors.items() if name.startswith("model.")) <= neutral


def test_the_exposure_mode_shows_held_out_photos_that_differ_only_in_exposure(tmp_path):
    collection = known_collection(tmp_path, exposed)
    changes = {"steps": 200, "resolution": 2, "held_out_checks": 1, "sh_degree": 0, "transients": "off"}
    trainer = trained(collection, tmp_path / "run", Settings(**changes, **SMALL))
    assert trainer.settings.appearance == "exposure"
    assert trainer.held_out_quality()[0] > 27  # dB: 29.8 to 31.1 by seed, and 20 without looks


# --- the run keeps what was decided


def test_decisions_are_printed_kept_and_never_taken_again(calm, tmp_path, monkeypatch):
    heard = Heard()
    monkeypatch.setattr(training, "prepared", lambda *_: calm)
    folder = pipeline.train(calm.root, Settings(steps=4, **SMALL), tmp_path / "run", heard)
    assert any(line.startswith("appearance=off: a point's colour differs by") for line in heard.lines)
    kept = json.loads((folder / "config.json").read_text())
    assert kept["settings"]["appearance"] == "off" and kept["settings"]["geometry_from"] == 0.0
    assert [decision["setting"] for decision in kept["decisions"]] == ["appearance", "transients", "sh_degree"]
    assert all(isinstance(decision["figure"], float) for decision in kept["decisions"])
    monkeypatch.setattr(decisions, "gather_evidence", None)
    _, settings, _ = run_config.read_config(folder)
    assert settings.appearance == "off" and not settings.undecided
    assert Trainer(calm, settings, folder).decisions == ()
    pipeline.bake_to_file(folder, "neutral", tmp_path / "neutral.ply")
