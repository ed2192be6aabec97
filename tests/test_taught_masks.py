"""The mask network can be taught true masks."""

import torch
from click.testing import CliRunner

from core.report import Report
from samples import taught_masks
from tests.small import small_collection


def passers_by(count: int, random: torch.Generator) -> list[taught_masks.Example]:
    """Grey noise with a red square, elsewhere in each photo."""
    examples = []
    for _ in range(count):
        picture, static = (
            0.3 + 0.3 * torch.rand(1, 48, 48, generator=random).expand(3, -1, -1).clone(),
            torch.ones(96, 96, dtype=torch.bool),
        )
        left, top = (4 * int(torch.randint(0, 8, (), generator=random)) for _ in range(2))
        picture[:, top : top + 16, left : left + 16] = torch.tensor([0.9, 0.1, 0.1])[:, None, None]
        static[2 * top : 2 * top + 32, 2 * left : 2 * left + 32] = False
        examples.append(taught_masks.Example(picture, static))
    return examples


def test_passers_by_that_look_alike_are_found():
    random = torch.Generator().manual_seed(0)
    network = taught_masks.taught(passers_by(8, random), 150, 0, Report())
    test = passers_by(4, random)
    assert taught_masks.mean_iou(network, test) > 0.7
    assert taught_masks.mean_iou(taught_masks.PlainMask(), test) < 0.2  # untaught


def test_the_lowest_quarter_overlaps_with_those_who_stand_there():
    static = torch.ones(8, 6, dtype=torch.bool)
    static[6:, 3:] = False
    example = taught_masks.Example(torch.zeros(3, 4, 4), static)
    assert taught_masks.mean_iou(lambda _: taught_masks.LOWEST_QUARTER, [example]) == 0.5


def test_a_scene_without_known_masks_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(taught_masks, "load_collection", lambda scene: small_collection(scene))
    result = CliRunner().invoke(taught_masks.main, [str(tmp_path)])
    assert result.exit_code == 1 and "knows no masks" in result.output
