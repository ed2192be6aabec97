"""Photos in one light are held out, and gains of sky and place bring their looks closer."""

import numpy as np
import pytest
from click.testing import CliRunner

from core.errors import BadInput
from samples import unlike
from tests.small import small_collection
from tests.training.known_scene import exposed, known_collection


def in_the_dark(index, picture):
    """Every fifth photo is taken at night, the others each in an exposure of its own."""
    day, hidden = exposed(index, picture)
    return day * (0.12 if index % 5 == 0 else 1.0), hidden


def test_the_darkest_quarter_is_held_out_and_comes_nearer_by_gains(tmp_path, monkeypatch):
    collection = known_collection(tmp_path, in_the_dark)
    split = unlike.without(collection, "dark")
    assert len(split.photos) == 20 and len(split.split("test")) == 5
    nights = {photo.name for photo in collection.split("train") if int(photo.name[6:8]) % 5 == 0}
    assert nights <= {photo.name for photo in split.split("test")}
    assert {photo.name for photo in unlike.without(collection, "bright").split("train")} >= nights
    monkeypatch.setattr(unlike, "load_collection", lambda scene: collection)
    told = CliRunner().invoke(unlike.main, [str(tmp_path), "--steps", "150"], catch_exceptions=False).output
    beyond = next(line for line in told.splitlines() if line.startswith("beyond the known range"))
    drawn_in, gains = (float(part.split(" dB")[0].split()[-1]) for part in beyond.split(": ")[1].split(", "))
    assert len(nights) == int(beyond.split(", ")[1].split()[0]) and gains > drawn_in + 3
    assert np.isfinite(gains)


def test_a_quarter_of_too_few_photos_is_refused(tmp_path):
    with pytest.raises(BadInput, match="has 2 training photos, too few"):
        unlike.without(small_collection(tmp_path, photos=3), "dark")


def test_a_run_that_would_read_nothing_from_photos_is_refused_before_it_is_trained(tmp_path, monkeypatch):
    monkeypatch.setattr(unlike, "load_collection", lambda scene: small_collection(tmp_path, photos=9))
    monkeypatch.setattr(unlike.Trainer, "train", None)
    result = CliRunner().invoke(unlike.main, [str(tmp_path), "--preset", "vanilla", "--steps", "1"])
    assert result.exit_code == 1 and "have one look only" in result.output
