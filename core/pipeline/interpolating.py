"""A trained run and two looks -> the frames between them: what `wegs interpolate` does."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from core.data.collection import spread_over
from core.data.made import FADE, is_of_wegs
from core.data.photos.folder import SUFFIXES
from core.errors import BadSetting, WegsError
from core.export.pictures import KeptPictures, contact_sheet, to_8_bit, write_png, write_video
from core.looks.find_look import find_look, find_view
from core.looks.look_file import write_look
from core.looks.pruning import pruner_of
from core.looks.trained import Look, TrainedRun, bake, blend, drawn
from core.pipeline.opened import ONE_LOOK, open_run
from core.report import QUIET, Report
from core.scene.camera import Camera
from core.scene.camera_path import camera_path
from core.system.atomic import filling
from core.system.outputs import check_apart, check_fillable, check_named_as_folder, holds_others
from core.words import counted

MOST_ON_SHEET = 100  # frames, evenly spread: so browsers show the sheet of the longest fade


def interpolate(
    folder: Path | None,
    first: str,
    last: str,
    steps: int = 10,
    output: Path | None = None,
    report: Report = QUIET,
    *,
    views: Sequence[str] = (),
    ply: bool = False,
    force: bool = False,
    refine: bool = True,
) -> Path:
    """Fade from one look to another in `steps` frames (2 or more); returns their folder.

    The first and the last frame show the two looks themselves, bit for bit. views: the photo whose camera is used or,
    if there are more, those from camera to camera of which it moves, about what most of them show; none: as
    `find_view`. ply: write each look as a .ply, too. refine: as in `bake_to_file`. Raises BadSetting for fewer steps
    (than 2 or views) and an output with the suffix of a file, BadInput for a run, look, view or output that cannot be
    used; DiskFull.
    """
    _check_asked(steps, views, output)
    trained = open_run(folder, report)
    photos = [find_view(trained, view) for view in views or (None,)]
    seen_from = f"seen from {' to '.join(photo.name for photo in photos)}"
    output = output or Path(f"{_short(first)}-to-{_short(last)}")
    check_apart(output, [Path(first), Path(last)])
    old = check_fillable(output, FADE, force)
    if old and not is_of_wegs(output):  # photos may be called frame_*.png, too, as nerfstudio's are
        raise holds_others(output, old[0])
    ends = _ends(trained, first, last, refine, report)
    report.say(f"{trained.folder}{trained.on_device_in_words}: {counted(steps, 'frame')}, {seen_from}")
    for which, end in zip(("from", "to"), ends, strict=True):
        report.say(f"  {which} {end.source}")
    if not trained.has_looks:
        report.warn(ONE_LOOK)
    seen_by = [trained.camera(photo) for photo in photos]
    path = camera_path(seen_by, steps, _shown_by_most(trained, seen_by))
    with filling(output, FADE, force) as work:
        frames = _write_frames(trained, ends, path, ply, work, report)
        on_sheet = KeptPictures(spread_over(frames.paths, MOST_ON_SHEET))
        write_png(work / "sheet.png", contact_sheet(f"{_short(first)} to {_short(last)}, {seen_from}", on_sheet))
        try:
            write_video(work / "video.mp4", frames)
        except WegsError as problem:  # the frames, which took the time, are kept
            report.warn(str(problem).replace(str(work), str(output)))
    files = [counted(steps, "frame"), "sheet.png"]
    if ply:
        files.append(counted(steps, ".ply file"))
    if (output / "video.mp4").is_file():
        files.append("video.mp4")
    report.say(f"{output}: {', '.join(files)}")
    return output


def _check_asked(steps: int, views: Sequence[str], output: Path | None) -> None:
    """Raise BadSetting for what no run could do."""
    if steps < 2:
        raise BadSetting(
            f"{counted(steps, 'step')} cannot make a fade from one look to another.", "Take 2 steps or more."
        )
    if steps < len(views):
        raise BadSetting(f"{counted(steps, 'step')} cannot lead through {len(views)} views.", "Take more --steps.")
    if output is not None:
        check_named_as_folder(
            output, (".mp4", ".gif", ".ply", *SUFFIXES), "a fade is a folder of frames, with video.mp4 among them"
        )


def _ends(trained: TrainedRun, first: str, last: str, refine: bool, report: Report) -> tuple[Look, Look]:
    """The looks that `first` and `last` name; both are found before either is refined, which takes seconds."""
    named = dict.fromkeys((first, last))
    if refine:
        for name in named:
            find_look(trained, name, refine=False)
    looks = {name: find_look(trained, name, refine=refine, report=report) for name in named}
    return looks[first], looks[last]


def _shown_by_most(trained: TrainedRun, cameras: Sequence[Camera]) -> np.ndarray | None:
    """The middle (3,) of the place that most of the cameras show, in front of all of them; None if there is none that
    two of them show."""
    place = trained.splats.means[: trained.solid_count].cpu().double().numpy()
    place = place[np.isfinite(place).all(axis=1)]
    shown, depths = map(np.array, zip(*(camera.shows(place) for camera in cameras), strict=True))
    showing = shown.sum(axis=0) * (depths > 0).all(axis=0)
    most = showing.max(initial=0)
    return np.median(place[showing == most], axis=0) if most > 1 else None


def _write_frames(
    trained: TrainedRun, ends: tuple[Look, Look], path: Sequence[Camera], ply: bool, folder: Path, report: Report
) -> KeptPictures:
    """Draw the looks from one end to the other, each as its camera sees it, and write them as pictures and, with `ply`,
    as files; returns the pictures."""
    pruner = pruner_of(trained, report) if ply else None
    told, steps = _OnceEach(report), len(path)
    digits = max(3, len(str(steps - 1)))
    frames = [folder / f"frame_{step:0{digits}d}.png" for step in range(steps)]
    for step, (camera, frame) in enumerate(zip(path, frames, strict=True)):
        look = blend(*ends, step / (steps - 1))
        if ply:
            write_look(trained, look, folder / f"step_{step:0{digits}d}.ply", told, pruner)
        write_png(frame, to_8_bit(drawn(trained, bake(trained, look), camera)))
        report.progress("Frames", step + 1, steps)
    return KeptPictures(frames)


class _OnceEach(Report):
    """Passes on only the first line and the first warning about the files of a fade:
    the others would differ in nothing but numbers."""

    def __init__(self, report: Report):
        self.report, self.has_said, self.has_warned = report, False, False

    def say(self, line: str) -> None:
        if not self.has_said:
            self.report.say(line)
        self.has_said = True

    def warn(self, line: str) -> None:
        if not self.has_warned:
            self.report.warn(line)
        self.has_warned = True


def _short(appearance: str) -> str:
    """A look's name for a folder: without path and without a file's suffix."""
    path = Path(appearance)
    return path.stem if path.suffix.lower() in (*SUFFIXES, ".json") else path.name
