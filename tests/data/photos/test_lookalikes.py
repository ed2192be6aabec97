"""One picture stored twice is told from two pictures."""

import cv2
import numpy as np
import pytest

from core.data.photos.lookalikes import Lookalikes


def picture(seed, contrast=1.0, height=300, width=400):
    blobs = np.random.default_rng(seed).normal(0, 60 * contrast, (12, 16, 1)) * (1.1, 1.0, 0.8)
    return np.clip(cv2.resize(128 + blobs, (width, height), interpolation=cv2.INTER_CUBIC), 0, 255).astype(np.uint8)


def stored_again(pixels, quality=60, factor=0.5):
    small = cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    return cv2.imdecode(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)


@pytest.mark.parametrize("contrast", [1.0, 0.6])
def test_a_picture_is_known_again_and_others_are_not(contrast):
    seen = Lookalikes()
    a, b = picture(1, contrast), picture(2, contrast)
    assert seen.earlier("a", a) is None and seen.earlier("b", b) is None
    assert seen.earlier("small a", stored_again(a)) == "a" and seen.earlier("small b", stored_again(b)) == "b"
    assert seen.earlier("a, moved", np.roll(a, 4, axis=1)) is None  # 1% of the width, as from a step aside
    assert seen.earlier("a, cut", a[:250]) is None


def test_pictures_without_content_are_not_taken_for_one():
    seen = Lookalikes()
    for level in (0, 1, 128, 128):
        assert seen.earlier(str(level), np.full((30, 40, 3), level, np.uint8)) is None
