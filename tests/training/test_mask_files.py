"""The masks of a run as pictures: one for each photo, and its own."""

import cv2
import numpy as np
import torch

from core.training.mask_files import write_masks
from tests.heard import Heard


def test_every_photo_is_written_with_its_own_mask(trainer_of, tmp_path):
    trainer = trainer_of(mask="mlp")
    torch.nn.init.normal_(trainer.model.mask_network.last.weight, std=0.2)
    torch.nn.init.zeros_(trainer.model.mask_network.last.bias)
    report = Heard()
    assert write_masks(tmp_path, trainer.model, trainer.photos, report) == 4
    assert report.steps == [(1, 4), (2, 4), (3, 4), (4, 4)]
    for index, sized in enumerate(trainer.photos):
        written = cv2.imread(str(tmp_path / "masks" / sized.photo.name), cv2.IMREAD_GRAYSCALE)
        mask = trainer.model.read(sized.encoder_input, index).mask[0].detach().numpy()
        expected = cv2.resize(mask, written.shape[::-1]) * 255
        assert np.abs(written - expected).max() <= 1.5
    assert len({path.read_bytes() for path in (tmp_path / "masks").iterdir()}) == 4
