"""An evaluation as files: results.json with the means, per_view.json with each photo;
results_full.json and so on for protocol `full`."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import core
from core.appearance.refinement import LATER_STEPS, STEPS
from core.data.made import read_mark
from core.evaluation import PROTOCOLS, RESULT_FILES, WAYS, lpips
from core.evaluation.metrics import PSNR_KIND, SSIM_KIND
from core.evaluation.protocols import ViewResult
from core.system.atomic import write_json

FORMS = {"psnr": "PSNR {:.2f} dB", "ssim": "SSIM {:.3f}", "lpips": "LPIPS {:.3f}"}
REFINEMENT_KIND = (
    f"Adam, L1 of means over cells: {STEPS} steps of the tone and the weights that the embedding gives, "
    "or of the embedding where it gives none; "
    f"where the SH transfer has hidden layers, {LATER_STEPS} more of weights and these"
)


@dataclass(frozen=True)
class Results:
    """The figures of a run, with everything that decides whether they may be compared with others.

    run: its identity, as in config.json. gaussians: of the run, with those of the sky. scale: width of the pictures
    measured / width of the photos on disk. lpips_backbone: lpips.BACKBONE, or None without weights. training_seconds,
    evaluation_seconds: wall clock. white_background: photos and renders are compared over white, so that transparent
    pixels are scored; otherwise they are not. has_looks: whether the run has more looks than one.
    """

    protocol: str
    views: tuple[ViewResult, ...]
    run: str
    gaussians: int
    train_photos: int
    test_photos: int
    scale: float
    lpips_backbone: str | None
    seed: int
    steps: int
    training_seconds: float
    evaluation_seconds: float
    white_background: bool
    has_looks: bool

    def means(self) -> dict[str, dict[str, dict[str, float | None]]]:
        """Means over the photos: [photo | clean | clean_right][zero_shot | refined][psnr | ssim | lpips].

        A metric that some photos lack is averaged over the others; None if all lack it.
        """
        found: dict[str, dict[str, dict[str, list]]] = {}
        for view in self.views:
            for against, by_look in view.scores.items():
                for look, scores in by_look.items():
                    for metric, value in asdict(scores).items():
                        found.setdefault(against, {}).setdefault(look, {}).setdefault(metric, []).append(value)
        return {
            against: {
                look: {metric: _mean(values) for metric, values in metrics.items()} for look, metrics in by_look.items()
            }
            for against, by_look in found.items()
        }

    def mask_iou(self) -> float | None:
        """Mean overlap of predicted and true passers-by over the photos where both are known."""
        return _mean([view.mask_iou for view in self.views])

    def rows(self) -> list[tuple[str, str]]:
        """The means as rows of a table: (what was compared with, which look; figures)."""
        rows: list[tuple[str, str]] = []
        for against, by_look in self.means().items():
            if against == "clean" and self.protocol == "half":
                against = "clean, whole picture"
            for look, figures in by_look.items():
                words = [form.format(figures[name]) for name, form in FORMS.items() if figures[name] is not None]
                if not rows and figures["lpips"] is not None:
                    words[-1] += " (lower is better)"
                rows.append((f"{against}, {WAYS[look]}" if self.has_looks else against, "  ".join(words)))
        overlap = self.mask_iou()
        return rows if overlap is None else [*rows, ("mask IoU", f"{overlap:.3f}")]

    def to_json(self) -> dict[str, Any]:
        """The content of results.json."""
        refined = any("refined" in by_look for view in self.views for by_look in view.scores.values())
        return {
            "wegs": core.__version__,
            "run": self.run,
            "gaussians": self.gaussians,
            "protocol": self.protocol,
            "protocol_means": PROTOCOLS[self.protocol],
            "refinement": REFINEMENT_KIND if refined else None,
            "photos": {"train": self.train_photos, "test": self.test_photos, "measured": len(self.views)},
            "scale": self.scale,
            "quantisation": "8 bit",
            "transparent_pixels": "over white" if self.white_background else "not scored",
            "psnr": PSNR_KIND,
            "ssim": SSIM_KIND,
            "lpips": self.lpips_backbone or f"absent: {lpips.ABSENT}",
            "seed": self.seed,
            "steps": self.steps,
            "training_seconds": self.training_seconds,
            "evaluation_seconds": self.evaluation_seconds,
            "averaged": "each metric over the photos",
            "means": self.means(),
            "mask_iou": self.mask_iou(),
        }

    def save(self, folder: Path) -> None:
        """Write the means and the figures of each photo into `folder`, each file whole or not at all."""
        names = RESULT_FILES[self.protocol]
        write_json(folder / names.means, _plain(self.to_json()))
        write_json(folder / names.per_view, _plain([asdict(view) for view in self.views]))


def measured_earlier(folder: Path, run: str, step: int) -> list[str]:
    """The names of results in a run folder that were not measured on the run of this identity at this step."""
    of = {files.means: read_mark(folder / files.means) for files in RESULT_FILES.values()}
    return [name for name, facts in of.items() if facts and (facts.get("run"), facts.get("steps")) != (run, step)]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return fmean(known) if known else None


def _plain(value: Any) -> Any:
    """The value with inf and NaN spelled out, because JSON has no numbers for them."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value
