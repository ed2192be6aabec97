"""The method beside its rivals on one scene: same photos, cap, steps and renderer. Prints a table for the README.

    python samples/compare.py samples/plaza --preset quick
    python samples/compare.py SCENE -r 2 --output runs/compare

The rivals: plain 3DGS (`--preset vanilla`) and the affine exposure model (`--set appearance=exposure`), the latter with
all else of the method. What is finished in the output folder is neither trained nor measured again.
"""

import json
import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does, before torch is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import click

from core.config import PRESETS, preset
from core.evaluation.protocols import PROTOCOLS
from samples.measurements.finished import measured
from samples.measurements.variants import AFFINE, FULL, PLAIN, VARIANTS
from wegs_cli.main import Told
from wegs_cli.terminal import Terminal

RIVALS = {"wegs": FULL, "affine exposure": AFFINE, "plain 3DGS": PLAIN}


@click.command(cls=Told)
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--preset", "preset_name", default="quick", show_default=True, type=click.Choice(sorted(PRESETS)))
@click.option("-r", "--resolution", default=-1, show_default=True, help="As of `wegs train`.")
@click.option("-o", "--output", default=Path("runs/compare"), show_default=True, type=click.Path(path_type=Path), help="Folder of the runs.")
@click.option("--protocol", "protocols", multiple=True, default=("half", "full"), show_default=True, type=click.Choice(list(PROTOCOLS)))
def main(scene: Path, preset_name: str, resolution: int, output: Path, protocols: tuple[str, ...]) -> None:
    """Train and measure wegs, the affine exposure model and plain 3DGS on SCENE."""
    rows = []
    with Terminal() as terminal:
        for name, variant in RIVALS.items():
            settings = preset(preset_name).changed(**VARIANTS[variant].changes, resolution=resolution)
            folder = output / f"{scene.name}-{name.replace(' ', '-')}"
            figures = measured(scene, settings, folder, protocols, terminal)
            common = {"method": name, "MB": figures["bytes"] / 1e6}
            rows += [common | {"protocol": protocol} | figures["results"][protocol] for protocol in protocols]
    (output / f"{scene.name}.json").write_text(json.dumps(rows, indent=1))
    click.echo(table(rows))


def table(rows: list[dict]) -> str:
    """Markdown: PSNR / SSIM against each truth there is, for the embedding as it is and refined."""
    against = list(rows[0]["means"])
    lines = [
        "| method | protocol | " + " | ".join(f"{name}: zero-shot | {name}: refined" for name in against)
        + " | mask IoU | training s | .ply MB |"
    ]  # fmt: skip
    lines.append("|---" * (5 + 2 * len(against)) + "|")
    for row in rows:
        cells = [row["method"], row["protocol"]]
        for name in against:
            for whose in ("zero_shot", "refined"):
                scores = row["means"].get(name, {}).get(whose)
                cells.append("-" if scores is None else " / ".join(_number(scores[key]) for key in scores))
        overlap = row.get("mask_iou")
        cells += ["-" if overlap is None else f"{overlap:.2f}", f"{row['training_seconds']:.0f}", f"{row['MB']:.1f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


if __name__ == "__main__":
    main()
