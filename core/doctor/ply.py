"""A .ply of Gaussians, made by wegs or by any other program."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from core.data.collection import spread_over
from core.doctor import views
from core.doctor.finding import Finding
from core.doctor.gaussians import examine_gaussians
from core.errors import BadInput
from core.export.ply import read_ply, sky_count_in
from core.ply_file import bytes_beyond
from core.report import Report
from core.scene.frame import SceneFrame
from core.scene.splats import Splats
from core.words import counted

MOST_CAMERAS = 100  # evenly spread over those known
AGAIN = "Copy or export it again."


def examine_ply(path: Path, report: Report) -> list[Finding]:
    """Findings about the file; also about its cameras if it lies in a run folder. BadInput if unreadable."""
    stated_sky, splats = sky_count_in(path), read_ply(path)
    sky_count = stated_sky if stated_sky and stated_sky <= len(splats) else 0
    findings = [*_file(path, splats, stated_sky or 0), *_gaussians_and_cameras(path, splats, sky_count, report)]
    if stated_sky is not None:
        return findings
    return [replace(found, advice=found.elsewhere or found.advice) if found.advice else found for found in findings]


def _file(path: Path, splats: Splats, stated_sky: int) -> list[Finding]:
    """What the file holds, and whether its header fits that."""
    size = path.stat().st_size
    figure = f"{counted(len(splats), 'Gaussian')} of SH degree {splats.degree}, {size / 1e6:.1f} MB"
    findings = [Finding("file", figure, "")]
    if beyond := bytes_beyond(path):
        findings.append(
            Finding("rest of the file", counted(beyond, "byte"), "after the last row that its header counts", AGAIN)
        )
    if stated_sky > len(splats):
        figure = f"{stated_sky:,} of {counted(len(splats), 'Gaussian')}"
        findings.append(
            Finding(
                "sky",
                figure,
                "rows were removed since wegs wrote the file; the sky now counts as part of the scene",
                AGAIN,
            )
        )
    return findings


def _gaussians_and_cameras(path: Path, splats: Splats, sky_count: int, report: Report) -> list[Finding]:
    centres = views.centres_of(splats, sky_count)
    if not len(centres):
        return examine_gaussians(splats, SceneFrame(np.zeros(3), 1.0), sky_count)
    # Not the radius that holds 97 %: other programs' files may hold a sky, too, of more than 3 % of the Gaussians.
    half = SceneFrame.around(centres, quantile=0.5)
    frame = SceneFrame(half.centre, 2 * half.radius)
    in_scene = splats.in_scene(frame)
    findings, cameras = examine_gaussians(in_scene, frame, sky_count), []
    try:
        cameras = views.cameras_beside(path)
    except BadInput as problem:
        findings.append(Finding("cameras", "damaged", problem.what.rstrip("."), problem.fix))
    cameras = [camera.in_scene(frame) for camera in spread_over(cameras, MOST_CAMERAS)]
    findings.append(views.float32_error(frame, frame.to_scene(centres), cameras))
    if cameras:
        findings.append(views.never_seen(in_scene, cameras, sky_count, report))
    return findings
