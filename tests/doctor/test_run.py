"""A run on the table: a sound one is sound, what is wrong is named; and what the command line says."""

import os
import shutil
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from click.testing import CliRunner

from core import pipeline
from core.doctor import Finding, examine
from core.doctor import run as module
from core.errors import BadInput
from core.run import checkpoint
from core.run.claim import held
from tests.data.small_scene import HEIGHT, WIDTH, SmallScene
from tests.doctor.examined import asked_for, examined
from tests.doctor.plies import refuse
from tests.doctor.test_scene import mark_as_made
from tests.heard import Heard
from tests.small import small_settings, unfinished
from wegs_cli.main import wegs


def test_a_sound_run_is_described_by_its_gaussians_looks_masks_and_history(trained):
    findings, heard = examined(trained)
    assert {
        "steps",
        "skipped steps",
        "held-out quality",
        "settings",
        "not finite",
        "needles",
        "float32 positions",
    } < findings.keys()
    assert {"never seen", "residuals", "looks", "masks"} < findings.keys()
    assert findings["steps"].figure.startswith("30 of 30 in ")
    assert "(60 of them sky) of SH degree 1" in findings["file"].figure
    assert "sky_gaussians=60" in findings["settings"].figure and "steps=30" in findings["settings"].figure
    assert "over 7 looks" in findings["residuals"].figure  # of nine photos two are held out
    assert findings["giants"].figure == "none"  # the sky is no giant
    assert heard.steps[-1] == (7, 7)
    # So short a run has learned no looks, and two of its 80 Gaussians may be too dark, as the processor rounds; it is
    # sound all the same.
    assert asked_for(findings) <= {"looks", "colours"}


@pytest.mark.parametrize("sky", ["dome", "none"])
def test_a_run_whose_place_is_gone_is_not_sound_and_training_on_would_not_help(tmp_path, sky):
    scene = SmallScene().write(tmp_path / "scene")
    settings = small_settings(steps=30, sky=sky, prune_opacity=1.0)
    with nullcontext() if sky == "dome" else pytest.raises(BadInput, match="none of 0 Gaussians can be drawn"):
        pipeline.train(scene, settings, tmp_path / "run")
    findings, _ = examined(tmp_path / "run")
    assert "settings prune_opacity, largest_scale and reach" in findings["file"].advice and not findings["steps"].advice


@pytest.mark.parametrize(
    "weight, advice", [(0.1, "sh_regularisation=0.1 holds looks at the base"), (0.001, "appearance=off")]
)
def test_looks_that_are_all_one_are_blamed_on_what_holds_them(tmp_path, weight, advice):
    scene = SmallScene().write(tmp_path / "scene")
    folder = pipeline.train(
        scene, small_settings(steps=1, sh_regularisation=weight, network_rate=0.0), tmp_path / "run"
    )
    assert advice in examined(folder)[0]["looks"].advice


def test_looks_are_summed_up_by_how_much_they_add_and_differ():
    added = module._Residuals(small_settings(appearance="full", residual_bound=4.0))
    for dc in (1.0, -3.9):
        residual = torch.zeros(5, 4, 3)
        residual[:, 0] = dc
        added.add(residual)
        if dc == 1.0:
            assert [finding.name for finding in added.findings()] == ["residuals"]  # one look differs from no other
    residuals, looks = added.findings()
    assert residuals.figure == "up to 3.9, 12.5 % of them near the bound of 4, over 2 looks"
    assert looks.figure == "DC coefficients vary by 2.45"
    added.settings = small_settings(appearance="exposure")  # which has no bound
    assert added.findings()[0].figure == "up to 3.9, over 2 looks" and not added.findings()[0].advice


@pytest.mark.parametrize(("other", "collapsed"), [(0.9, False), (0.5, True)])
def test_the_photo_whose_mask_hides_most_is_named(other, collapsed):
    masks = {"b.jpg": other, "c.jpg": 0.3, "a.jpg": other}
    trained = SimpleNamespace(step=60, settings=small_settings(steps=100), state=SimpleNamespace(collapse_told=False))
    found = module._masks(masks, trained)
    assert found.figure.endswith("0.30 (least: c.jpg)") and bool(found.advice) == collapsed
    trained.step = 59  # masks do not hide yet, and may be anything
    found = module._masks(masks, trained)
    assert found.meaning == "they hide nothing before step 60" and not found.advice


def test_faults_of_a_run_are_reported_with_a_way_to_go_on(trained, tmp_path):
    folder = tmp_path / "run"
    saved = checkpoint.load(checkpoint.newest(trained))
    saved.tensors["gaussians.parameters.means"][3] = float("nan")
    saved.tensors["model.sh_transfer.last.bias"][:] = 100.0
    state = saved.facts["trainer"] | {"skipped": 7, "collapse_told": True}
    facts = saved.facts | {"step": 20, "trainer": state}
    folder.mkdir()
    (folder / "config.json").write_bytes((trained / "config.json").read_bytes())
    (folder / "history.csv").write_text("step,held_out_psnr\n5,21.0\n6,\ngarbage\n9,18.5\n")
    checkpoint.save(folder, checkpoint.Checkpoint(saved.tensors, facts))
    findings, _ = examined(folder)
    assert "wegs train --resume -o" in findings["steps"].advice
    assert findings["skipped steps"].figure == "7 (35 %)"
    assert findings["held-out quality"].figure == "18.50 dB, 21.00 at best"
    assert findings["not finite"].figure.startswith("1 (")
    assert "up to 4, 100 % of them near the bound of 4" in findings["residuals"].figure
    assert {"steps", "skipped steps", "held-out quality", "not finite", "residuals", "masks"} <= asked_for(findings)


@pytest.mark.parametrize(("last", "fell"), [(20.6, False), (20.4, True)])
def test_by_how_much_held_out_quality_may_fall(trained, tmp_path, last, fell):
    folder = shutil.copytree(trained, tmp_path / "run")
    (folder / "history.csv").write_text(f"step,held_out_psnr\n5,21.0\n9,{last}\n")
    assert bool(examined(folder)[0]["held-out quality"].advice) == fell


@pytest.mark.parametrize(
    "content", [None, "", "garbage", "step,seconds\n9,1.0\n", "step,held_out_psnr\n9,\n", "\0\0\0\n"]
)
def test_a_run_whose_history_is_lost_is_not_sound(trained, tmp_path, content):
    folder = shutil.copytree(trained, tmp_path / "run")
    (folder / "history.csv").unlink() if content is None else (folder / "history.csv").write_text(content)
    found = examined(folder)[0]["held-out quality"]
    assert found.figure == "not recorded" and found.advice == f"Measure it: wegs eval --run {folder}"


@pytest.mark.parametrize(("checks", "held_out"), [(0, True), (4, False)])
def test_no_history_is_asked_of_a_run_without_checks(tmp_path, checks, held_out):
    scene = SmallScene().write(tmp_path / "scene")
    folder = pipeline.train(
        scene, small_settings(steps=1, held_out_checks=checks, all_photos=not held_out), tmp_path / "run"
    )
    assert "held-out quality" not in examined(folder)[0]


def test_a_run_without_its_results_is_not_sound(trained, tmp_path):
    unfinished(shutil.copytree(trained, tmp_path / "run"))
    steps = examined(tmp_path / "run")[0]["steps"]
    assert "the results were not written" in steps.meaning and "wegs train --resume -o" in steps.advice
    with held(tmp_path / "run"):
        steps = examined(tmp_path / "run")[0]["steps"]
    assert "it is still being trained" in steps.meaning and not steps.advice
    assert not examined(trained)[0]["steps"].advice


@pytest.mark.parametrize("changes", [{"appearance": "off", "transients": "off"}, {"appearance": "exposure"}])
def test_what_a_run_did_not_learn_is_not_reported(tmp_path, changes):
    scene = SmallScene().write(tmp_path / "scene")
    findings, _ = examined(pipeline.train(scene, small_settings(steps=3, **changes), tmp_path / "run"))
    assert ("masks" in findings) == ("transients" not in changes)
    assert ("residuals" in findings) == (changes["appearance"] != "off")


def test_a_run_without_its_photos_is_examined_all_the_same(trained):
    hidden = trained.parent / "scene" / "images"
    hidden.rename(hidden.with_name("hidden"))
    try:
        findings, _ = examined(trained)
    finally:
        hidden.with_name("hidden").rename(hidden)
    assert findings["photos"].figure.startswith("7 of 7, such as photo_1.png (")
    assert findings["photos"].advice.startswith("Copy it again")
    assert "masks" not in findings and "never seen" in findings


def test_a_run_whose_gaussians_are_too_large_to_draw_is_examined_all_the_same(trained, monkeypatch):
    monkeypatch.setattr("core.doctor.views.largest_contributions", refuse)
    findings, _ = examined(trained)
    assert findings["never seen"].figure == "not measured" and "-r" not in findings["never seen"].advice
    assert "residuals" in findings


def test_what_is_never_seen_is_asked_at_a_small_size(trained, monkeypatch):
    sizes = []
    monkeypatch.setattr("core.doctor.views.WIDEST_PX", WIDTH // 4)
    monkeypatch.setattr(
        "core.doctor.views.largest_contributions",
        lambda splats, cameras, *_: (
            sizes.extend((camera.width, camera.height) for camera in cameras),
            torch.ones(len(splats)),
        )[1],
    )
    assert examined(trained)[0]["never seen"].figure == "none"
    assert set(sizes) == {(WIDTH // 4, HEIGHT // 4)}


def test_a_run_of_a_poor_scene_names_the_cause(trained, tmp_path):
    assert "photos placed" not in examined(trained)[0] and "odd focal lengths" not in asked_for(examined(trained)[0])
    scene = SmallScene(names=[f"photo_{index}.png" for index in range(9)], params=[9e3, 9e3, 80, 60]).write(
        tmp_path / "poor"
    )
    mark_as_made(scene, 9, 20, 9e3)
    run = pipeline.train(scene, small_settings(steps=1, prune_contribution=0.0), tmp_path / "run")
    findings, _ = examined(run)
    assert findings["photos placed"].figure == "9 of 20"
    assert (
        findings["odd focal lengths"].figure.startswith("9 of 9 (photo_0.png: 56.2,")
        and "add photos from in between" in findings["odd focal lengths"].advice
    )
    assert {"photos placed", "odd focal lengths"} <= asked_for(findings)


# --- the command line


@pytest.mark.parametrize(
    "name", ["config.json", "history.csv", "cameras.json", "cfg_args", "preview.png", "masks/photo_1.png"]
)
def test_given_a_file_of_a_run_the_doctor_asks_for_the_run(trained, name):
    assert (trained / name).is_file()
    with pytest.raises(BadInput, match=f"{name} is a file in a run. Give the folder of the run: {trained}$"):
        examine(trained / name, Heard())


@pytest.mark.parametrize("name", ["masks", "point_cloud"])
def test_given_a_folder_of_a_run_the_doctor_asks_for_the_run(trained, name):
    assert (trained / name).is_dir()
    with pytest.raises(BadInput, match=f"{name} is a folder in a run. Give the folder of the run: {trained}$"):
        examine(trained / name, Heard())  # masks are no photos to train on


def test_a_run_is_found_from_a_folder_within_it(trained, monkeypatch):
    monkeypatch.chdir(trained / "masks")
    with pytest.raises(BadInput, match=f"is a folder in a run. Give the folder of the run: {trained}$"):
        examine(Path(), Heard())


@pytest.mark.parametrize(("advice", "code", "mark"), [("", 0, "ok"), ("Copy it again.", 1, "!!")])
def test_the_command_prints_findings_and_exits_with_1_if_anything_needs_doing(monkeypatch, trained, advice, code, mark):
    monkeypatch.setattr("core.doctor.examine_run", lambda *_: [Finding("steps", "30 of 30", "complete", advice)])
    result = CliRunner().invoke(wegs, ["doctor", str(trained)])
    assert result.exit_code == code, result.output
    lines = result.output.strip().splitlines()
    assert lines[0].startswith(f"{mark} steps: 30 of 30") and "Verdict: " in lines[-1]


A_LIST = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n1 2\n"


@pytest.mark.parametrize("content", [None, b"", b"ply\n", A_LIST])
def test_what_cannot_be_read_is_reported_in_one_line_with_exit_code_1(tmp_path, content):
    path = tmp_path / "a.ply"
    if content is not None:
        path.write_bytes(content)
    result = CliRunner().invoke(wegs, ["doctor", str(path)])
    assert result.exit_code == 1 and len(result.stderr.strip().splitlines()) == 1 and "a.ply" in result.stderr


def test_without_a_path_the_newest_run_is_examined(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput, match="There is no run"):
        examine(None, Heard())
    taken = []
    monkeypatch.setattr("core.doctor.examine_run", lambda path, _: taken.append(path) or [])
    for name, begun in (("a", 1e9), ("b", 1e9 + 5), ("c", 1e9)):
        config = tmp_path / "runs" / name / "config.json"
        config.parent.mkdir(parents=True)
        config.write_text('{"wegs": "0.1.0"}', encoding="utf-8")
        os.utime(config, (begun, begun))
    examine(None, heard := Heard())
    assert taken == [Path("runs/b")] and heard.lines[-1].startswith("runs/b: ")
