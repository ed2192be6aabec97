"""What is said of photos and their cameras when they meet."""

import cv2
import numpy as np
import pycolmap
import pytest

from core.data.placing import Placing
from core.data.posed import PosedPhoto


def placed_at(centre, placing, name: str, path, focal_px: float = 80.0):
    lens = pycolmap.Camera(model="SIMPLE_PINHOLE", width=80, height=60, params=[focal_px, 40, 30])
    return placing.place(PosedPhoto(name, path, lambda width, height: lens, np.eye(3), np.array(centre)))


@pytest.mark.parametrize("broken", [np.nan, np.inf, -1e300])
def test_one_broken_number_of_a_pose_is_enough_to_leave_a_photo_out(tmp_path, broken):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((60, 80, 3), np.uint8))
    placing = Placing("missing")
    assert placed_at([0.0, broken, 0.0], placing, "a", tmp_path / "a.png") is None
    assert [note.text for note in placing.notes()] == ["1 photo with a camera or pose that is broken, not used: a"]


@pytest.mark.parametrize(
    "odd, words",
    [(2, "2 photos with an unusual focal length, used"), (3, "3 photos of 4 with a focal length that no lens has")],
)
def test_unusual_focal_lengths_are_harmless_unless_most_are(tmp_path, odd, words):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((60, 80, 3), np.uint8))
    placing = Placing("missing")
    for number in range(4):
        focal_px = 80 * 17.0 if number < odd else 80 * 16.0  # 610 and 580 mm on a frame 36 mm wide
        assert placed_at(np.zeros(3), placing, f"{number}", tmp_path / "a.png", focal_px)
    (note,) = placing.notes()
    assert note.text.startswith(words) and note.harmless == (odd == 2)
