"""The ablation: every variant is another run that works, figures are taken once, and the tables say what they are."""

import csv
import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from click.testing import CliRunner

from core import pipeline
from core.appearance import refinement
from core.data import load_collection
from core.errors import BadInput
from core.evaluation import lpips
from core.looks.trained import load_run
from core.pipeline import training
from core.presets import PRESETS
from core.report import QUIET
from samples import ablation, compare
from samples.measurements import finished
from samples.measurements.variants import FULL, VARIANTS
from tests.heard import Heard, StopsAtStep
from tests.paths import PLAZA
from tests.small import give_to_pipeline, small_collection, small_settings

# In three steps no mask comes down to hide a Gaussian, and nothing drifts before cameras.
NEED_LONGER_RUNS = ("no L_regTS", "veils stay (paper)", "passers-by stay (paper)")
TINY = {
    "steps": 3,
    "max_gaussians": 300,
    "densify_rounds": 1,
    "checkpoints": 3,
    "held_out_checks": 0,
    "mask_start": 0.0,
}


@pytest.fixture(scope="module", autouse=True)
def small_scene(tmp_path_factory):
    """Every scene is the small collection; nothing of what is measured here depends on long refinements or on LPIPS."""
    folder = tmp_path_factory.mktemp("scene")
    collection = small_collection(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "prepared", lambda path, *_: replace(collection, root=path))
        patch.setattr(training, "load_collection", lambda path, *_: replace(collection, root=path))
        patch.setattr(refinement, "STEPS", 2)
        patch.setattr(refinement, "LATER_STEPS", 2)
        patch.setattr(lpips, "load", lambda *_: None)
        yield folder


@pytest.fixture(scope="module")
def runs(small_scene, tmp_path_factory):
    """All variants of one seed, by both protocols, and the folder they are kept in."""
    folder = tmp_path_factory.mktemp("ablation")
    changes = {name: variant.changes for name, variant in VARIANTS.items()}
    found = ablation.ablate(small_scene, small_settings(**TINY), changes, 1, ("full", "half"), folder, Heard())
    return found, folder


def test_every_variant_trains_and_is_measured(runs):
    found, folder = runs
    full = found[FULL][0]["results"]["full"]
    for name, (one,) in found.items():
        means = one["results"]["half"]["means"]["photo"]
        assert means["zero_shot"]["psnr"] > 0 and one["bytes"] > 0, name
        # Plain 3DGS has no look to refine. All else has, a table of embeddings (GLO) too.
        assert ("refined" in means) == (name != "plain 3DGS"), name
        changed = one["settings"] != found[FULL][0]["settings"]
        if changed and name not in NEED_LONGER_RUNS:
            assert one["results"]["full"]["means"] != full["means"], name  # the switch does something
    assert sum(one[0]["settings"] != found[FULL][0]["settings"] for one in found.values()) > 15
    assert len(list(folder.glob("*.json"))) < len(VARIANTS)  # some change nothing: they are the full model


def test_a_table_of_embeddings_starts_from_its_mean(runs):
    _, folder = runs
    live = load_run(next(folder.glob("embedding-by-GLO*/")))
    look = live.model.read(torch.rand(3, 24, 32))
    assert torch.equal(look.embedding, live.model.mean_embedding) and look.embedding.abs().max() > 0


@pytest.fixture
def measured(small_scene, tmp_path):
    """A function that has a variant trained and measured, as far as that has not been done."""
    settings = small_settings(**TINY, device="auto")

    def measure(*protocols, scene=small_scene, folder=tmp_path / "run", report=QUIET, **changes):
        return finished.measured(scene, settings.changed(**changes), folder, protocols or ("full",), report)

    return measure


def test_a_stopped_variant_is_resumed(measured, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        measured(report=StopsAtStep(2))
    assert not json.loads((tmp_path / "run.json").read_text())["results"]
    heard = Heard()
    assert set(measured(report=heard)["results"]) == {"full"}
    assert any(line.startswith(f"Going on with {tmp_path / 'run'} from step 2") for line in heard.lines)


def test_a_finished_variant_is_not_trained_again(measured, monkeypatch):
    first = measured()
    monkeypatch.setattr(pipeline, "train", None)
    monkeypatch.setattr(pipeline, "resume", None)
    assert measured() == first
    both = measured("full", "half")
    assert set(both["results"]) == {"full", "half"} and both["results"]["full"] == first["results"]["full"]
    assert measured() == both


def test_a_scene_that_is_not_there_is_refused_and_the_figures_stay(measured, tmp_path):
    first = measured()
    with pytest.raises(BadInput, match="no folder"):
        measured(scene=tmp_path / "mistyped")
    assert not (tmp_path / "mistyped").exists() and measured() == first


def test_an_output_below_a_file_is_refused_and_the_figures_stay(measured, tmp_path):
    first = measured()
    with pytest.raises(BadInput, match="not a folder"):
        measured(folder=tmp_path / "run.json" / "run")
    assert measured() == first


def test_another_scene_of_the_same_name_is_refused_and_the_figures_stay(measured, small_scene, tmp_path):
    first = measured()
    (tmp_path / "elsewhere").mkdir()
    namesake = shutil.copytree(small_scene, tmp_path / "elsewhere" / small_scene.name)
    with pytest.raises(BadInput, match="of another scene"):
        measured(scene=namesake)
    assert measured() == first


def test_with_other_settings_nothing_is_left_of_the_figures(measured):
    measured("full", "half")
    other = measured(seed=1)
    assert other["results"]["full"]["seed"] == 1 and "half" not in other["results"]


@pytest.mark.parametrize("size", ["another size", "the same size"])
def test_figures_of_photos_that_changed_since_are_not_passed_on(tmp_path, monkeypatch, size):
    scene = tmp_path / "scene"
    scene.mkdir()
    give_to_pipeline(small_collection(scene), monkeypatch)
    settings, folder = small_settings(**TINY), tmp_path / "run"
    finished.measured(scene, settings, folder, ("full",), Heard())
    photo = scene / "photo_1.png"
    whole = photo.read_bytes()
    photo.write_bytes(whole[: len(whole) - 9 if size == "the same size" else len(whole)] + b"retouched")
    with pytest.raises(BadInput, match="are not those that .* was trained on: photo_1.png"):
        finished.measured(scene, settings, folder, ("full",), Heard())


def test_a_run_is_measured_again_once_lpips_is_there(small_scene, tmp_path, monkeypatch):
    settings, folder = small_settings(**TINY), tmp_path / "run"
    measured = [finished.measured(small_scene, settings, folder, ("full",), Heard())]
    monkeypatch.setattr(pipeline, "train", None)
    monkeypatch.setattr(lpips, "load", lambda: torch.nn.Identity())
    monkeypatch.setattr(pipeline, "evaluate", lambda *_: SimpleNamespace(to_json=lambda: {"lpips": lpips.BACKBONE}))
    measured += [finished.measured(small_scene, settings, folder, ("full",), Heard()) for _ in range(2)]
    assert measured[0]["results"]["full"]["lpips"].startswith("absent")
    assert measured[1]["results"]["full"] == {"lpips": lpips.BACKBONE} and measured[2] == measured[1]


def test_tables_state_protocol_steps_and_differences_from_the_full_model(runs):
    found = runs[0]
    text = ablation.table("small", "half", found)
    head, _, columns, rule, *rows = text.splitlines()
    assert "protocol half, against the test photos; 3 steps, scale 1.00, one seed" in head and "mean embedding" in head
    assert len(rows) == len(found) and {line.count("|") for line in (columns, rule, *rows)} == {columns.count("|")}
    cells = {row.split(" | ")[0].removeprefix("| "): [cell.strip(" |") for cell in row.split(" | ")] for row in rows}
    assert cells["embedding of 8"][-2:] == ["-1.09", "66.3"] and cells["no L_regTS"][-2:] == ["-0.04", "147.6"]
    assert cells["embedding of 16"][2] == "+0.00" and cells[FULL][2] == "" and cells["plain 3DGS"][3:5] == ["-", "-"]
    # Two seeds: the mean difference is that of pairs, and the spread stands beside it.
    pair = {name: [group[0], json.loads(json.dumps(group[0]))] for name, group in found.items()}
    for name, shift in ((FULL, 1.0), ("no mask", 3.0)):
        pair[name][1]["results"]["half"]["means"]["photo"]["zero_shot"]["psnr"] += shift
    row = next(line for line in ablation.table("small", "half", pair).splitlines() if line.startswith("| no mask"))
    alone = float(cells["no mask"][2])
    assert row.split(" | ")[2] == f"{alone + 1:+.2f} ± 1.41"


def test_the_program_writes_tables_and_figures(small_scene, tmp_path, monkeypatch):
    monkeypatch.setitem(
        PRESETS, "quick", {name: value for name, value in small_settings(**TINY).to_json().items() if name != "seed"}
    )
    line = [str(small_scene), "--seeds", "2", "--only", "no mask", "-o", str(tmp_path)]
    result = CliRunner().invoke(ablation.main, line, catch_exceptions=False)
    assert result.exit_code == 0
    assert (tmp_path / f"{small_scene.name}.md").read_text().strip() in result.output
    with (tmp_path / f"{small_scene.name}.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {(row["variant"], row["seed"], row["look"]) for row in rows} == {
        (name, seed, whose) for name in (FULL, "no mask") for seed in "01" for whose in ("zero_shot", "refined")
    }


def test_scenes_of_one_name_are_refused_before_the_hours(small_scene, tmp_path, monkeypatch):
    monkeypatch.setattr(ablation, "ablate", None)
    namesake = tmp_path / "elsewhere" / small_scene.name
    namesake.mkdir(parents=True)
    result = CliRunner().invoke(ablation.main, [str(small_scene), str(namesake), "-o", str(tmp_path / "out")])
    assert (
        result.exit_code == 1
        and f"scenes are called {small_scene.name}" in result.output
        and not (tmp_path / "out").exists()
    )


def test_compare_puts_all_rivals_into_one_table(small_scene, tmp_path, monkeypatch):
    monkeypatch.setitem(
        PRESETS, "quick", {name: value for name, value in small_settings(**TINY).to_json().items() if name != "seed"}
    )
    line = [str(small_scene), "-o", str(tmp_path), "--protocol", "full"]
    # The first seed is measured by one more.
    CliRunner().invoke(compare.main, [*line, "--protocol", "half"], catch_exceptions=False)
    result = CliRunner().invoke(compare.main, [*line, "--seeds", "2"], catch_exceptions=False)
    rows = [row.strip("| ").split(" | ") for row in result.output.splitlines()[-3:]]
    assert [row[:2] for row in rows] == [[name, "full"] for name in ("wegs", "affine exposure", "plain 3DGS")]
    runs = json.loads((tmp_path / f"{small_scene.name}.json").read_text())["wegs"]
    values = [one["results"]["full"]["means"]["photo"]["zero_shot"]["psnr"] for one in runs]
    assert rows[0][2].startswith(f"{sum(values) / 2:.2f} ± ") and values[0] != values[1] and rows[2][3] == "-"


@pytest.mark.parametrize("protocols", [("half", "full"), ("full", "half")])
def test_compare_shows_what_only_one_of_the_protocols_compares_with(runs, protocols):
    group = json.loads(json.dumps(runs[0][FULL]))
    means = group[0]["results"]["half"]["means"]
    means["clean_right"] = means["photo"]
    head, _, *rows = compare.table(dict.fromkeys(compare.RIVALS, group), protocols).splitlines()
    column = head.split(" | ").index("clean_right: zero-shot")
    for row in (row.split(" | ") for row in rows):
        assert row[column] == ("-" if row[1] == "full" else row[2])


def test_another_split_holds_out_other_photos(tmp_path):
    table = tmp_path / "val.tsv"
    table.write_text("filename\tid\tsplit\n0001.jpg\t1\ttrain\n0002.jpg\t2\ttest\n0003.jpg\t3\ttrain\n")
    scene = finished.with_split(PLAZA, table, tmp_path / "out")
    assert finished.with_split(PLAZA, table, tmp_path / "out") == scene  # again
    collection = load_collection(scene)
    assert {photo.name: photo.split for photo in collection.photos} == {
        "0001.jpg": "train",
        "0002.jpg": "test",
        "0003.jpg": "train",
    }
    assert (scene / "truth" / "masks").is_dir()
    namesake = tmp_path / "elsewhere" / "plaza"
    namesake.mkdir(parents=True)
    with pytest.raises(BadInput, match="of another scene"):
        finished.with_split(namesake, table, tmp_path / "out")
    table.write_text(table.read_text() + "0004.jpg\t4\ttest\n")
    with pytest.raises(BadInput, match="another split"):
        finished.with_split(PLAZA, table, tmp_path / "out")


def test_another_split_replaces_that_of_the_scene(tmp_path):
    source = shutil.copytree(PLAZA, tmp_path / "plaza", symlinks=True)
    own = (source / "plaza.tsv").rename(source / "nerfw_split.csv")
    text = own.read_text()
    table = tmp_path / "nerfw_split.csv"
    table.write_text("filename\tid\tsplit\n0001.jpg\t1\ttrain\n0002.jpg\t2\ttest\n")
    collection = load_collection(finished.with_split(source, table, tmp_path / "out"))
    assert {photo.name: photo.split for photo in collection.photos} == {"0001.jpg": "train", "0002.jpg": "test"}
    assert own.read_text() == text
    (wrong := tmp_path / "wrong.tsv").write_text("0001.jpg\n")
    with pytest.raises(BadInput, match="not a split table|names no photos"):
        finished.with_split(source, wrong, tmp_path / "out")
    assert not (tmp_path / "out" / "plaza-wrong").exists()
