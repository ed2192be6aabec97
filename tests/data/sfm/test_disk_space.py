"""Whether what pycolmap writes has room is asked before, as it does not tell."""

import errno

import pycolmap
import pytest

from core.data.sfm import disk_space
from core.data.sfm.disk_space import check_growth, check_room, write_model
from tests.failing import leave_on_disk


@pytest.mark.parametrize("needed", [0, 1])
def test_some_of_the_disk_is_left(tmp_path, monkeypatch, needed):
    leave_on_disk(disk_space.SPARE_BYTES, monkeypatch)
    if not needed:
        check_room(tmp_path, needed)
        return
    with pytest.raises(OSError) as caught:
        check_room(tmp_path, needed)
    assert caught.value.errno == errno.ENOSPC


@pytest.mark.skipif(disk_space.resource is None, reason="this system limits no files")
def test_a_file_may_grow_as_far_as_its_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(disk_space.resource, "getrlimit", lambda _: (1000, -1))
    (tmp_path / "a.db").write_bytes(bytes(600))
    check_growth(tmp_path / "a.db", 400)
    check_growth(tmp_path / "b.db", 1000)
    with pytest.raises(OSError) as caught:
        check_growth(tmp_path / "a.db", 401)
    assert caught.value.errno == errno.EFBIG
    monkeypatch.setattr(disk_space.resource, "getrlimit", lambda _: (-1, -1))
    check_growth(tmp_path / "a.db", 401)


def test_a_model_takes_no_more_than_was_asked_for(tmp_path, monkeypatch):
    options = pycolmap.SyntheticDatasetOptions(num_points3D=500, num_frames_per_rig=10)
    model, asked = pycolmap.synthesize_dataset(options), []
    monkeypatch.setattr(disk_space, "check_room", lambda folder, needed, largest: asked.append((needed, largest)))
    write_model(model, tmp_path)
    sizes = [(tmp_path / name).stat().st_size for name in ("points3D.bin", "images.bin")]
    assert asked[0][0] / 2 < sum(sizes) <= asked[0][0] and max(sizes) <= asked[0][1]
