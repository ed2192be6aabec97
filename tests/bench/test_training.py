"""Training curves: what the history says, also of runs that differ in the seed."""

import pytest

from core.bench.training import Course, checks, training_figure
from core.errors import BadInput
from core.run import checkpoint
from tests.bench.conftest import CHECKS

HEAD = "step,seconds,gaussians,loss,picture_loss,mask_mean,residual,held_out_psnr,held_out_ssim"


def test_a_run_records_psnr_and_ssim_at_every_check(small_run):
    rows = checks(small_run)
    assert [row["steps"] for row in rows] == [10, 20, 30, 40]
    assert len(rows) == CHECKS
    for row in rows:
        assert 5 < row["psnr"] < 60 and 0 < row["ssim"] < 1 and row["seconds"] > 0
    made = training_figure([Course("small", (small_run,), is_default=True)], "A title", ("More.",))
    assert [point.label for point in made.points] == [f"step {step}" for step in (10, 20, 30, 40)]
    assert [point.is_default for point in made.points] == [False, False, False, True]
    assert len(made.panels) == 4 and made.notes[-1] == "More."


def test_runs_that_differ_in_the_seed_are_one_curve_with_a_spread(small_run, tmp_path):
    other = copied(small_run, tmp_path, lambda text: text)
    rows = (other / "history.csv").read_text().splitlines()
    cells = rows[-1].split(",")
    column = rows[0].split(",").index("held_out_psnr")
    mine = float(cells[column])
    cells[column] = str(mine + 2)
    (other / "history.csv").write_text("\n".join([*rows[:-1], ",".join(cells)]) + "\n")
    made = training_figure([Course("both", (small_run, other))], "T")
    spread = made.points[-1].values["psnr"]
    assert (spread.low, spread.median, spread.high) == pytest.approx((mine + 0.5, mine + 1, mine + 1.5))
    assert made.points[0].values["psnr"].low == made.points[0].values["psnr"].high


@pytest.mark.parametrize(
    "text", ["", "step,held_out_psnr\n5,21.0\n", f"{HEAD}\n5,1.0,9,1,1,1,0,,\n", f"{HEAD}\n5,x,9,1,1,1,0,3,0.5\n"]
)
def test_a_history_that_says_nothing_is_refused(small_run, tmp_path, text):
    with pytest.raises(BadInput, match="history.csv"):
        training_figure([Course("bad", (copied(small_run, tmp_path, lambda _: text),))], "T")


@pytest.mark.parametrize(
    "step, fix",
    [
        (0, "type: wegs train --resume -o "),
        (3, "type: wegs train --resume -o "),
        (40, "It was removed or damaged after the training"),
    ],
)
def test_a_run_stopped_before_its_first_check_can_go_on(small_run, tmp_path, step, fix):
    stopped = copied(small_run, tmp_path, lambda _: f"{HEAD}\n3,1.0,9,1,1,1,0,,\n")
    saved = checkpoint.load(checkpoint.newest(small_run))
    if not step:  # killed before the first of either
        (stopped / "history.csv").unlink()
    else:
        checkpoint.save(stopped, checkpoint.Checkpoint(saved.tensors, saved.facts | {"step": step}))
    with pytest.raises(BadInput, match=f"history.csv holds no held-out quality. .*{fix}"):
        checks(stopped)


def test_a_run_that_measures_nothing_is_told_what_to_train(small_run, tmp_path):
    bare = copied(small_run, tmp_path, lambda _: f"{HEAD}\n3,1.0,9,1,1,1,0,,\n")
    config = bare / "config.json"
    config.write_text(config.read_text().replace('"split": "test"', '"split": "train"'))
    with pytest.raises(BadInput, match="Train without --all-photos on a scene with test photos"):
        checks(bare)


def copied(folder, where, change):
    """A run folder with another history."""
    (where / "config.json").write_bytes((folder / "config.json").read_bytes())
    (where / "history.csv").write_text(change((folder / "history.csv").read_text()))
    return where
