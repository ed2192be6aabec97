"""The frames between two looks: their ends are those looks, and what is refused."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import core.rasterizer
from core import pipeline
from core.errors import BadInput, BadSetting, WegsError
from core.export.ply import read_ply
from core.looks import look_file
from core.looks.find_look import find_look
from core.looks.pruning import Pruned, Pruner
from core.looks.trained import bake, load_run
from core.pipeline import interpolating
from core.scene.camera_path import camera_path
from tests.failing import find_look_without_work
from tests.heard import Heard


def test_the_ends_of_a_fade_are_the_two_bakes_bit_for_bit(trained, tmp_path, few_steps):
    folder, ends = trained[0], ("neutral", "photo_4.png")
    output = pipeline.interpolate(folder, *ends, steps=3, output=tmp_path / "fade", ply=True)
    assert sorted(path.name for path in output.iterdir()) == [
        *(f"frame_{step:03d}.png" for step in range(3)),
        "sheet.png",
        *(f"step_{step:03d}.ply" for step in range(3)),
        "video.mp4",
    ]
    live = load_run(folder)
    camera = live.sized_photo(live.collection.split("test")[0]).camera
    for word, step in zip(ends, (0, 2), strict=True):
        pipeline.bake_to_file(folder, word, tmp_path / "end.ply", force=True)
        assert (tmp_path / "end.ply").read_bytes() == (output / f"step_{step:03d}.ply").read_bytes()
        baked = bake(live, find_look(live, word))
        image = core.rasterizer.create("auto").render(baked, camera)
        frame = cv2.imread(str(output / f"frame_{step:03d}.png"))[..., ::-1]
        np.testing.assert_array_equal(frame, (image.clamp(0, 1) * 255).round().byte().numpy())
    ends_sh = [read_ply(output / f"step_{step:03d}.ply").sh for step in (0, 1, 2)]
    assert not torch.equal(ends_sh[1], ends_sh[0]) and not torch.equal(ends_sh[1], ends_sh[2])


def test_the_camera_moves_from_one_view_to_the_next(trained, tmp_path):
    folder, views = trained[0], ("photo_0", "photo_2")
    fades = {
        names: pipeline.interpolate(folder, *["neutral"] * 2, 3, tmp_path / "-".join(names), views=names)
        for names in (views, views[:1], views[1:])
    }
    moved, first, last = (
        [cv2.imread(str(fade / f"frame_00{step}.png")).astype(int) for step in range(3)] for fade in fades.values()
    )
    assert (moved[0] == first[0]).all() and abs(moved[2] - last[2]).max() <= 1
    assert min(abs(moved[1] - end).mean() for end in (moved[0], moved[2])) > 1
    pipeline.interpolate(folder, "neutral", "neutral", 3, tmp_path / "three", views=("photo_0", "photo_4", "photo_2"))
    through = cv2.imread(str(tmp_path / "three" / "frame_001.png")).astype(int)
    pipeline.interpolate(folder, "neutral", "neutral", 2, tmp_path / "between", views=("photo_4",))
    between = cv2.imread(str(tmp_path / "between" / "frame_000.png")).astype(int)
    assert abs(through - between).max() <= 1


def test_a_camera_that_moves_keeps_what_most_views_show_in_the_picture(trained):
    run = load_run(trained[0])
    first, second = (run.camera(run.collection.photo(name)) for name in ("photo_0", "photo_2"))
    pivot = interpolating._shown_by_most(run, [first, second])
    assert all(camera.shows(pivot[None])[0].all() for camera in camera_path([first, second], 5, pivot))
    away = replace(second, world_to_camera=np.diag([-1.0, 1.0, -1.0]) @ second.world_to_camera)
    assert interpolating._shown_by_most(run, [first, away, second]) is None  # which has it at its back
    assert interpolating._shown_by_most(run, [first, away]) is None  # so the camera moves straight
    blind = replace(first, cx=-1e4)  # shows nothing of what lies in front of it
    assert np.array_equal(interpolating._shown_by_most(run, [first, blind, second]), pivot)


def test_a_look_that_is_both_ends_is_refined_once(trained, tmp_path, monkeypatch, few_steps):
    refined = []

    def heard(live, word, refine, **choices):
        refined.extend([word] if refine else [])
        return find_look(live, word, refine=refine, **choices)

    monkeypatch.setattr(interpolating, "find_look", heard)
    output = pipeline.interpolate(trained[0], "photo_4.png", "photo_4.png", 2, tmp_path / "fade")
    assert refined == ["photo_4.png"] and len({(output / f"frame_00{step}.png").read_bytes() for step in range(2)}) == 1


def test_the_sheet_of_a_long_fade_shows_frames_evenly_spread(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(interpolating, "MOST_ON_SHEET", 3)
    fades = [pipeline.interpolate(trained[0], "neutral", "neutral", count, tmp_path / f"{count}") for count in (3, 9)]
    sheets = [cv2.imread(str(fade / "sheet.png")) for fade in fades]
    assert np.array_equal(*sheets) and len(list(fades[1].glob("frame_*.png"))) == 9


def test_a_fade_whose_video_fails_keeps_its_frames(trained, tmp_path, monkeypatch):
    def full(path, _):
        raise WegsError(f"The disk is full: {path} was not written.", "Free some space.")

    monkeypatch.setattr(interpolating, "write_video", full)
    output = pipeline.interpolate(trained[0], "neutral", "photo_4.png", 2, tmp_path / "fade", heard := Heard())
    assert sorted(path.name for path in output.iterdir()) == ["frame_000.png", "frame_001.png", "sheet.png"]
    warning = f"! The disk is full: {output / 'video.mp4'} was not written. Free some space."
    assert heard.lines[-2:] == [warning, f"{output}: 2 frames, sheet.png"]


def test_what_the_files_of_a_fade_lack_is_told_once_whichever_frame_lacks_it(trained, tmp_path, monkeypatch, few_steps):
    def bake_broken(live, look):
        baked = bake(live, look).map(torch.clone)
        baked.sh[: 0 if look.name == "neutral" else 2] = torch.nan
        return baked

    monkeypatch.setattr(look_file, "bake", bake_broken)
    monkeypatch.setattr(Pruner, "__call__", lambda _, baked: Pruned(baked, gaussians=7))
    pipeline.interpolate(trained[0], "neutral", "photo_4.png", 3, tmp_path / "fade", heard := Heard(), ply=True)
    assert [line for line in heard.lines if "left out" in line.lower()] == [
        "Left out 7 Gaussians: no training view changes; `wegs bake --prune off` keeps all",
        "! step_001.ply: 2 Gaussians that cannot be drawn (NaN, Inf or a zero quaternion) left out.",
    ]


def test_force_replaces_a_fade_but_no_photos_that_are_called_frames(trained, tmp_path):
    fade = pipeline.interpolate(trained[0], "neutral", "photo_4.png", 3, tmp_path / "fade", ply=True)
    pipeline.interpolate(trained[0], "neutral", "photo_4.png", 2, fade, force=True)
    assert sorted(path.name for path in fade.iterdir()) == ["frame_000.png", "frame_001.png", "sheet.png", "video.mp4"]
    (photos := tmp_path / "images").mkdir()
    (photos / "frame_00001.png").write_bytes(b"a photo")
    with pytest.raises(BadInput, match="images holds other files, such as frame_00001.png"):
        pipeline.interpolate(trained[0], "neutral", "photo_4.png", 2, photos, force=True)
    assert (photos / "frame_00001.png").read_bytes() == b"a photo"


def test_what_cannot_be_is_refused_before_the_work(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(interpolating, "find_look", find_look_without_work)
    with pytest.raises(BadSetting, match="1 step cannot make a fade"):
        pipeline.interpolate(trained[0], "neutral", "photo_0.png", 1, tmp_path / "fade")
    with pytest.raises(BadInput, match="no photo bogus"):
        pipeline.interpolate(trained[0], "neutral", "photo_0.png", 2, tmp_path / "fade", views=["bogus"])
    for name in ("garbled.json", "garbled.png"):
        (tmp_path / name).write_text("nothing")
    cv2.imwrite(str(tmp_path / "tiny.png"), np.zeros((8, 8, 3), np.uint8))
    for word, words in (
        ("bogus.png", "is neither a photo file"),
        ("bogus.json", "no saved look"),
        (str(tmp_path / "garbled.json"), "is not a saved look"),
        (str(tmp_path / "garbled.png"), "garbled.png is not a photo"),
        (str(tmp_path / "tiny.png"), "8 x 8 px, too small"),
    ):
        with pytest.raises(BadInput, match=words):
            pipeline.interpolate(trained[0], "photo_0.png", word, 2, tmp_path / "fade")
    monkeypatch.chdir(tmp_path)
    Path("photo_0-to-dusk.2").symlink_to("gone")
    with pytest.raises(BadInput, match="photo_0-to-dusk.2 is not a folder"):
        pipeline.interpolate(trained[0], "photo_0.png", "looks/dusk.2.json", 2)
    for suffix in (".mp4", ".png", ".ply"):
        with pytest.raises(BadSetting, match="a folder of frames.*Type: -o .*fade$"):
            pipeline.interpolate(trained[0], "neutral", "photo_0.png", 2, tmp_path / f"fade{suffix}")
