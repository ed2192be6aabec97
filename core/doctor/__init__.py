"""`wegs doctor`: checks a .ply, a run or a scene; one line per finding, with what to do about it."""

from pathlib import Path

from core.data.photos.folder import SUFFIXES, VIDEO_SUFFIXES
from core.doctor.finding import Finding, verdict
from core.doctor.ply import examine_ply
from core.doctor.run import examine_run
from core.doctor.scene import examine_scene
from core.errors import BadInput
from core.report import Report
from core.run import run_folders

PACKED = (".sog", ".spz", ".splat", ".ksplat")  # Gaussians in other formats

__all__ = ["Finding", "examine"]


def examine(path: Path | None, report: Report) -> list[Finding]:
    """Check a .ply, a run or a scene (None: the newest run); report every finding, then a verdict.

    Raises BadInput if it cannot be read at all.
    """
    path = run_folders.find_run(None) if path is None else path
    if not (path.is_file() or path.is_dir()):  # reading a pipe might never end
        what = f"{path} is neither a file nor a folder." if path.exists() else f"There is no file or folder {path}."
        raise BadInput(what, "Give a .ply, a run, a scene or a folder of photos.")
    suffix = path.suffix.lower()
    is_run = run_folders.is_run(path)
    if not is_run and suffix != ".ply":
        run_folders.check_not_within_run(path)
    if is_run:
        findings = examine_run(path, report)
    elif path.is_file() and suffix in PACKED:
        raise BadInput(f"{path} is no .ply.", "Convert it to one, in SuperSplat say.")
    elif newest := max(path.glob(run_folders.CLOUDS), key=_step_and_date, default=None):
        findings = examine_ply(newest, report)  # a run folder of the original project or its heirs
    elif path.is_dir() or suffix in (".json", *SUFFIXES, *VIDEO_SUFFIXES):
        findings = _scene(path, report)
    else:
        findings = examine_ply(path, report)
    for finding in findings:
        if finding.advice:
            report.warn(finding.line())
        else:
            report.say(finding.line())
    report.say(f"{path}: {verdict(findings)}")
    return findings


def _scene(path: Path, report: Report) -> list[Finding]:
    """Findings about a scene or a folder of photos.
    For anything else, the BadInput says what to do, and names a .ply or a run if the folder holds one."""
    try:
        return examine_scene(path, report)
    except BadInput as problem:
        inside = (file for file in sorted(path.glob("*")) if file.suffix.lower() == ".ply" or run_folders.is_run(file))
        if not (found := next(inside, None)):
            raise
        raise BadInput(problem.what, f"{problem.fix} For what is in it, give the path, such as {found}.") from None


def _step_and_date(cloud: Path) -> tuple[int, int]:
    """The step that wrote the file, -1 if unknown, and its date. The step counts first: copying may change dates."""
    step = cloud.parent.name.removeprefix("iteration_")
    return int(step) if step.isdecimal() else -1, cloud.stat().st_mtime_ns
