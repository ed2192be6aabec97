"""Which photo or look a word stands for, what is said of one that was left out, and how a light is put into words."""

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import pytest
import torch

from core.data.sfm import originals
from core.errors import BadInput
from core.looks.find_look import find_look, find_view
from core.looks.outside import light_in_words
from core.looks.trained import TrainedRun
from core.system.atomic import write_json
from tests.small import finished, small_collection, small_settings


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> TrainedRun:
    return finished(
        small_collection(tmp_path_factory.mktemp("scene")),
        small_settings(steps=2),
        tmp_path_factory.mktemp("runs") / "small",
    )


def test_a_photo_is_known_without_its_suffix_where_only_one_is_called_so(trained):
    assert find_look(trained, "photo_1", refine=False).source == "training photo photo_1.png"
    assert find_view(trained, "photo_1").name == trained.collection.photo("photo_1").name == "photo_1.png"
    first, second, *rest = trained.collection.photos
    twins = replace(
        trained.collection, photos=(first, replace(second, name="photo_0.jpg"), replace(rest[0], name="photo_0"))
    )
    assert twins.called("photo_0").name == "photo_0"
    twins = replace(twins, photos=twins.photos[:2])
    assert twins.called("photo_0") is None
    made = replace(
        trained.collection,
        photos=tuple(replace(photo, name=f"{photo.name}.jpg") for photo in trained.collection.photos),
    )
    assert made.called("photo_1").name == made.called("photo_1.png").name == "photo_1.png.jpg"
    with pytest.raises(
        BadInput, match=r"photo_0 may be 2 photos: photo_0.png, photo_0.jpg\. Give the whole name of one"
    ):
        find_look(replace(trained, collection=twins), "photo_0")
    with pytest.raises(BadInput, match="photo_0 may be 2 photos"):
        twins.photo("photo_0")


def test_photos_that_were_moved_are_known_by_name_and_size(trained, tmp_path):
    photos = [replace(photo, path=tmp_path / "gone" / photo.name) for photo in trained.collection.photos]
    moved = replace(trained, collection=replace(trained.collection, photos=tuple(photos)))
    for number in (0, 2):  # a training photo and a held-out one
        there = trained.collection.photos[number]
        here, known = find_look(moved, str(there.path), refine=False), find_look(trained, str(there.path), refine=False)
        assert here.source == f"{known.source} (whose file is gone; this one has its name and size)"
        assert torch.equal(here.colouring.embedding, known.colouring.embedding)
    pixels = cv2.imread(str(there.path))
    cv2.imwrite(str(tmp_path / there.name), pixels[:-2])
    assert "from outside" in find_look(moved, str(tmp_path / there.name), refine=False).source


@pytest.mark.parametrize(
    "changes, name",
    [({"embedding": "glo"}, "photo_0"), ({"appearance": "off"}, "photo_0"), ({"appearance": "off"}, "photo_2")],
)
def test_a_look_that_the_run_holds_needs_no_photo(changes, name, tmp_path_factory):
    """A training photo's in a table; any photo's where there is one look for all."""
    scene, runs = tmp_path_factory.mktemp("scene"), tmp_path_factory.mktemp("runs")
    run = finished(small_collection(scene), small_settings(steps=2, **changes), runs / "small")
    photos = tuple(replace(photo, path=scene / "gone" / photo.name) for photo in run.collection.photos)
    look = find_look(replace(run, collection=replace(run.collection, photos=photos)), name)
    held = run.model.mean_embedding if run.model.embedding_table is None else run.model.embedding_table[0]
    assert torch.equal(look.colouring.embedding, held) and ("not refined" in look.source) == ("embedding" in changes)


def test_a_photo_that_a_table_does_not_know_is_refused(tmp_path):
    scene = tmp_path / "scene"
    scene.mkdir()
    run = finished(small_collection(scene), small_settings(steps=2, embedding="glo"), tmp_path / "run")
    outside = shutil.copyfile(scene / "photo_0.png", tmp_path / "photo_0.png")
    for word in ("photo_2.png", str(outside)):  # held out, and from outside though named as one of the table's
        with pytest.raises(BadInput, match="is not a training photo, and a run with embedding=glo"):
            find_look(run, word)
    assert find_look(run, "photo_0.png", refine=False).source == "training photo photo_0.png"


def test_a_photo_may_have_the_longest_name_there_is(trained, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (trained.folder / "appearance").mkdir()  # where a saved look of that name would lie
    name = f"{'x' * 251}.png"
    Path(name).write_bytes(trained.collection.photos[0].path.read_bytes())
    assert "from outside" in find_look(trained, name, refine=False).source
    first, *others = trained.collection.photos
    called_so = replace(trained, collection=replace(trained.collection, photos=(replace(first, name=name), *others)))
    Path(name).unlink()
    assert (
        find_look(called_so, name, refine=False).source.endswith(f"photo {name}")
        and find_view(called_so, name).name == name
    )


def test_a_view_is_named_as_a_look_is(trained):
    photo = trained.collection.photos[4]
    assert find_view(trained, str(photo.path)) is photo
    assert find_view(trained, None).name == trained.collection.photo(None).name == "photo_2.png"
    with pytest.raises(BadInput, match="no photo bogus in this run. Choose another, such as photo_0.png"):
        find_view(trained, "bogus")


def test_the_nearest_name_is_quoted_where_it_has_a_space(trained):
    named = tuple(replace(photo, name=f"my {photo.name}") for photo in trained.collection.photos)
    with pytest.raises(BadInput, match="a name such as 'my photo_0.png', or neutral"):
        find_look(replace(trained, collection=replace(trained.collection, photos=named)), "my photo_0.pgn")


def test_a_photo_that_got_no_camera_is_said_to_be_left_out(trained, tmp_path):
    names = [*(photo.name for photo in trained.collection.photos), "lost.jpg"]
    for name in ("lost.jpg", "garbled.jpg"):
        (tmp_path / name).touch()
    write_json(tmp_path / originals.MADE_OF, {f"{tmp_path}/{name}": [1, 1] for name in (*names, "garbled.jpg")})
    write_json(tmp_path / originals.NAMES, {f"{tmp_path}/{name}": name for name in names})
    made = replace(trained, collection=replace(trained.collection, root=tmp_path))
    for word, name in (
        ("lost.jpg", "lost.jpg"),
        ("lost", "lost.jpg"),
        ("elsewhere/lost.jpg", "lost.jpg"),
        ("garbled.jpg", "garbled.jpg"),
    ):
        said = f"{name} was left out when the cameras were found."
        with pytest.raises(BadInput, match=f"{said} Give its path, as of a photo from outside: {tmp_path}/{name}"):
            find_look(made, word)
        with pytest.raises(BadInput, match=f"{said} Choose another, such as photo_0.png"):
            find_view(made, word)
    (tmp_path / "lost.jpg").unlink()
    with pytest.raises(BadInput, match=f"a photo from outside: no longer {tmp_path}/lost.jpg"):
        find_look(made, "lost.jpg")
    with pytest.raises(BadInput, match="lust.jpg is neither a photo file"):
        find_look(made, "lust.jpg")
    Path(tmp_path / originals.NAMES).unlink()  # by a version that did not keep it: nothing can be told
    with pytest.raises(BadInput, match="lost.jpg is neither a photo file"):
        find_look(made, "lost.jpg")


@pytest.mark.parametrize(
    "place, sky, words",
    [
        ((0.6, 0.5, 0.5), (0.02, 0.02, 0.02), "darker"),
        ((0.3, 0.4, 0.6), (0.3, 0.4, 0.7), "darker, bluer"),
        ((1.4, 1.2, 1.0), (1.4, 1.3, 1.0), "brighter, redder"),
        ((1.0, 1.3, 1.0), (0.9, 1.2, 0.9), "greener"),
        ((1.02, 1.0, 0.98), (1.0, 1.0, 1.0), ""),
    ],
)
def test_a_light_is_described_in_a_few_words(place, sky, words):
    assert light_in_words(torch.tensor([place, sky])) == words
