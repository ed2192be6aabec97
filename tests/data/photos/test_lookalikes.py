"""One picture stored twice is told from two pictures."""

import cv2
import numpy as np
import pytest

from core.data.photos.lookalikes import SAME_COLOURS, Pictures, Thumbnail


def picture(seed, contrast=1.0, height=300, width=400):
    """Blobs of several sizes."""
    random = np.random.default_rng(seed)
    shapes = ((12, 16), (50, 66), (100, 133))
    blobs = sum(
        cv2.resize(random.normal(0, 30 * contrast, shape), (width, height), interpolation=cv2.INTER_CUBIC)
        for shape in shapes
    )
    return np.clip(128 + blobs[..., None] * (1.1, 1.0, 0.8), 0, 255).astype(np.uint8)


def stored_again(pixels, quality=60, factor=0.5):
    small = cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    return cv2.imdecode(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)


def same(first, second) -> bool:
    found = {Thumbnail.of(first).shows_same(Thumbnail.of(second)), Thumbnail.of(second).shows_same(Thumbnail.of(first))}
    assert len(found) == 1
    return found.pop()


@pytest.mark.parametrize("contrast", [1.0, 0.8])
def test_a_picture_is_known_again_and_others_are_not(contrast):
    a, b = picture(1, contrast), picture(2, contrast)
    assert same(a, a) and same(a, stored_again(a)) and same(b, stored_again(b)) and not same(a, b)
    assert not same(a, np.roll(a, 4, axis=1))  # 1% of the width, as from a step aside
    assert not same(a, a[:250])
    # Squeezed by a hundredth, and by more.
    assert same(a, cv2.resize(a, (404, 300))) and not same(a, cv2.resize(a, (430, 300)))
    assert not same(a, np.clip(a * 1.2, 0, 255).astype(np.uint8))  # in other light


def test_a_column_seen_from_two_sides_is_no_copy():
    """Nearly all its contrast is at the outline, which stays the same."""
    stone = picture(3, 0.2, 300, 4000)

    def seen_from(degrees):
        view = np.full((300, 400, 3), (230, 180, 120), np.uint8)
        view[240:] = (40, 90, 60)
        start = round(degrees / 360 * 4000)
        view[30:270, 140:260] = stone[30:270, start : start + 120]
        return view

    first, second = Thumbnail.of(seen_from(0)), Thumbnail.of(seen_from(40))
    assert np.sqrt(np.square(first.colours - second.colours).mean()) < 0.1 * first.colours.std()
    assert not first.shows_same(second) and same(seen_from(0), stored_again(seen_from(0)))


def test_pictures_without_content_are_not_taken_for_one():
    for level in (0, 128):
        assert not same(np.full((30, 40, 3), level, np.uint8), np.full((30, 40, 3), level, np.uint8))


def test_of_many_pictures_the_one_is_met_again_that_comparing_them_all_finds():
    """Some are brighter by nearly as much as one picture may be, others by a little more."""
    versions = [picture(seed, 1.8) for seed in range(5)]
    limits = [SAME_COLOURS * Thumbnail.of(pixels).colours.std() for pixels in versions]
    versions += [
        np.clip(np.rint(a + share * b), 0, 255).astype(np.uint8)
        for share in (0.9, 1.3)
        for a, b in zip(versions[:5], limits[:5], strict=True)
    ]
    versions += [stored_again(pixels) for pixels in versions]
    pictures, thumbnails, found = Pictures(), [Thumbnail.of(pixels) for pixels in versions], []
    for number, thumbnail in enumerate(thumbnails):
        new = (earlier for earlier in range(number) if found[earlier] is None)
        found.append(next((earlier for earlier in new if thumbnail.shows_same(thumbnails[earlier])), None))
        assert pictures.meet(number, versions[number]) == found[number]
    assert found[:15] == [None] * 5 + [0, 1, 2, 3, 4] + [None] * 5 and found[15:20] == [0, 1, 2, 3, 4]
