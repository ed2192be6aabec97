"""Photos at training size: never enlarged, the same from the cache and made again,
and nothing of what is hidden in them."""

import platform
import threading
import weakref
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from core.data.collection import GivenMask
from core.run.sized_photo import Sizes
from core.system import memory
from core.training import sized_photos as module
from core.training.sized_photos import SizedPhotos
from tests.heard import Heard
from tests.programs import run_python
from tests.small import HEIGHT, WIDTH, small_collection, small_settings

SIDE_PX = 32


def test_a_given_width_never_enlarges_photos(tmp_path):
    photo = small_collection(tmp_path, photos=1).photos[0]
    cameras = [Sizes(width, SIDE_PX).camera(photo) for width in (24, WIDTH, 640)]
    assert [(camera.width, camera.height) for camera in cameras] == [(24, 18), (WIDTH, HEIGHT), (WIDTH, HEIGHT)]


def test_by_default_the_mean_photo_gets_as_many_pixels_as_the_device_affords(tmp_path):
    photo = small_collection(tmp_path, photos=1).photos[0]
    photos = [replace(photo, camera=photo.camera.resized(*size)) for size in ((1600, 1200), (800, 600))]
    for device, mean in (("cpu", 200_000), ("cuda", 1_200_000)):  # a GPU affords more than they have, and enlarges none
        cameras = list(map(Sizes.of(small_settings(device=device), photos).camera, photos))
        assert np.mean([camera.width * camera.height for camera in cameras]) == pytest.approx(mean, rel=0.01)


def test_one_huge_photo_leaves_the_others_their_size(tmp_path):
    photo = small_collection(tmp_path, photos=1).photos[0]
    sizes = [(12_000, 9_000), *[(480, 360)] * 8, (1600, 1200)]
    photos = [replace(photo, camera=photo.camera.resized(*size)) for size in sizes]
    cameras = list(map(Sizes.of(small_settings(), photos).camera, photos))
    assert [(camera.width, camera.height) for camera in cameras[1:9]] == [(480, 360)] * 8
    assert cameras[0].width == cameras[9].width < 1600
    assert np.mean([camera.width * camera.height for camera in cameras]) == pytest.approx(200_000, rel=0.01)


def test_a_target_that_is_made_again_is_the_same(tmp_path):
    photos = small_collection(tmp_path).split("train")
    kept, small = (SizedPhotos(photos, Sizes(1, SIDE_PX)) for _ in range(2))
    small._most_bytes = 1
    for factor in (1, 2):
        for index in (0, 1, 0):
            assert torch.equal(small.target(index, factor)[1].planes, kept.target(index, factor)[1].planes)
            assert len(small._targets) == 1
        assert len(kept._targets) == 2 and kept._bytes == sum(target.nbytes for target in kept._targets.values())


def test_targets_of_an_earlier_size_are_freed(tmp_path):
    """A step that is taken back may ask for one once more."""
    photos = SizedPhotos(small_collection(tmp_path).split("train"), Sizes(1, SIDE_PX))
    first = weakref.ref(photos.target(0, 2)[1])
    again = photos.target(0, 2)[1]
    assert first() is again
    planes = again.planes.clone()
    del again
    photos.target(1, 1)
    assert first() is None and torch.equal(photos.target(0, 2)[1].planes, planes)


def test_a_shrunk_target_leaves_out_what_is_more_hidden_than_not(tmp_path):
    """Of 4 x 4 px, one column is hidden, or three."""
    photo = small_collection(tmp_path, photos=1).photos[0]
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[:, 4:5] = mask[:, 9:24] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    valid = (
        SizedPhotos((replace(photo, mask=GivenMask(tmp_path / "mask.png")),), Sizes(1, SIDE_PX)).target(0, 4)[1].valid
    )
    expected = torch.ones(HEIGHT // 4, WIDTH // 4, dtype=torch.bool)
    expected[:, 2:6] = False
    assert torch.equal(valid, expected)


def test_if_a_mask_hides_most_of_every_shrunk_pixel_the_least_hidden_ones_count(tmp_path):
    """Of 4 x 4 px, two columns less one pixel are left, or one column, or nothing."""
    photo = small_collection(tmp_path, photos=1).photos[0]
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[:, :2] = mask[:, 4] = 255
    mask[::4, 0] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    valid = (
        SizedPhotos((replace(photo, mask=GivenMask(tmp_path / "mask.png")),), Sizes(1, SIDE_PX)).target(0, 4)[1].valid
    )
    assert valid[:, :2].all() and not valid[:, 2:].any()


def test_a_shrunk_target_shows_nothing_where_its_photo_is_transparent(tmp_path):
    """A black disc on nothing, which is white as displayed."""
    photo = small_collection(tmp_path, photos=1).photos[0]
    pixels = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    cv2.circle(pixels, (24, 18), 14, (0, 0, 0, 255), -1)
    cv2.imwrite(str(tmp_path / "disc.png"), pixels)
    photos = SizedPhotos((replace(photo, path=tmp_path / "disc.png"),), Sizes(1, SIDE_PX))
    for factor in (1, 2, 4):
        target = photos.target(0, factor)[1]
        assert target.valid.any() and not target.valid.all() and not target.planes.any()
    assert not photos[0].encoder_input.any()


# What their memory holds, in photos that are being decoded, and the threads that decode.
@pytest.mark.parametrize("threads, held, decoders", [(1, None, 1), (2, None, 2), (3, 3, 3), (3, 2, 2), (2, 0, 1)])
def test_photos_stay_in_their_order_on_any_number_of_threads_and_damaged_ones_are_named(
    tmp_path, monkeypatch, many_threads, threads, held, decoders
):
    one, heard = small_collection(tmp_path, photos=1).photos[0], Heard()
    photos = []
    for number in range(40):
        path = tmp_path / f"{number:02d}.png"
        cv2.imwrite(str(path), np.full((HEIGHT, WIDTH, 3), 5 * number, np.uint8))
        photos.append(replace(one, name=path.name, path=path))
    photos[7].path.write_bytes(b"no photo")
    photos[31].path.unlink()
    each = module.DECODED_BYTES * WIDTH * HEIGHT
    monkeypatch.setattr(memory, "room", lambda: None if held is None else memory.OTHER_BYTES + held * each)
    torch.set_num_threads(threads)
    found = SizedPhotos(tuple(photos), Sizes(1, SIDE_PX), report=heard)
    assert [(sized.photo.name, sized.pixels[0, 0, 0]) for sized in found] == [
        (f"{n:02d}.png", 5 * n) for n in range(40) if n not in (7, 31)
    ]
    assert (
        found.notes[0].startswith("2 photos of the train split that cannot be used: 07.png (")
        and ", 31.png (" in found.notes[0]
    )
    assert heard.steps[-1] == (40, 40) and len(heard.steps) == -(-40 // (8 * decoders))


DECODES = """
import sys
from pathlib import Path
from core.system.process import prepare
prepare()
from dataclasses import replace
import cv2
import numpy as np
from core.run.sized_photo import Sizes
from core.system import memory
from core.training.sized_photos import SizedPhotos
from tests.small import small_collection

def taken():
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmData")) * 1024

folder = Path(sys.argv[1])
one = small_collection(folder, photos=1).photos[0]
path = folder / "all.jpg"
cv2.imwrite(str(path), np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8))
one = replace(one, path=path, camera=one.camera.resized(320, 240))
memory.hold_to(8)
SizedPhotos((one,) * 8, Sizes(1, 144))
before = taken()
found = SizedPhotos((one,) * 200, Sizes(1, 144))
print((taken() - before) / sum(sized.pixels.nbytes + sized.encoder_input.nbytes for sized in found))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can be told")
def test_where_memory_is_limited_photos_take_what_is_kept_of_them_and_hardly_more(tmp_path):
    assert float(run_python(DECODES, tmp_path).stdout) < 1.1


@pytest.mark.parametrize("room, decoders", [(1 << 20, 8), (None, 1)])  # that of a container, of an unknown system
def test_photos_are_decoded_one_by_one_where_memory_is_small_or_no_more_threads_may_decode(
    tmp_path, monkeypatch, room, decoders
):
    photos, decoding = small_collection(tmp_path).photos, set()
    load = module.load_sized_photo
    monkeypatch.setattr(
        module, "load_sized_photo", lambda *photo, **given: decoding.add(threading.get_ident()) or load(*photo, **given)
    )
    monkeypatch.setattr(module, "DECODERS", decoders)
    monkeypatch.setattr(memory, "room", lambda: room)
    assert len(SizedPhotos(photos, Sizes(1, SIDE_PX))) == 6 and decoding == {threading.get_ident()}


def sized(tmp_path, sizes_px: list[tuple[int, int]], share_canvas: bool = True) -> SizedPhotos:
    """Photos of these widths and heights, on a canvas if they share one."""
    photo = small_collection(tmp_path, photos=1).photos[0]
    photos = [
        replace(photo, name=f"{number}.png", camera=photo.camera.resized(*size)) for number, size in enumerate(sizes_px)
    ]
    found = SizedPhotos(tuple(photos), Sizes(1, SIDE_PX))
    found.share_canvas = share_canvas
    return found


def test_photos_that_share_a_canvas_have_targets_of_one_size(tmp_path):
    upright_and_wide = [(30, 40), (40, 30), (36, 36)]
    photos = sized(tmp_path, upright_and_wide)
    for factor in (1, 2):
        assert photos.canvas(factor) == (40 // factor, 40 // factor)
        for index, (width, height) in enumerate(upright_and_wide):
            camera, target = photos.target(index, factor)
            assert (camera.width, camera.height) == (width // factor, height // factor)
            assert target.planes.shape == (3, 40 // factor, 40 // factor)
            assert int(target.valid.sum()) == int(target.valid_pixels) == camera.width * camera.height
            assert target.valid[: camera.height, : camera.width].all()


def test_photos_share_no_canvas_where_it_would_not_pay(tmp_path):
    assert sized(tmp_path, [(30, 40), (40, 30)], share_canvas=False).canvas(1) is None
    assert sized(tmp_path, [(100, 10), (10, 100)]).canvas(1) is None
