"""A .ply on the table: planted faults are counted, whoever wrote the file."""

import os

import numpy as np
import pytest

from tests.doctor.examined import asked_for, examined
from tests.doctor.plies import ROWS, cameras_json, sound_rows, write


@pytest.mark.parametrize("rest, degree", [(0, 0), (9, 1), (24, 2), (45, 3)])
@pytest.mark.parametrize("kind", ["<f4", ">f8"])
def test_a_sound_file_of_any_program_is_sound(tmp_path, rest, degree, kind):
    rows = sound_rows(rest, kind)
    if rest:
        rows["f_rest_0"] = 0.5
    findings, heard = examined(write(tmp_path / "a.ply", rows))
    assert asked_for(findings) == set()
    assert f"{ROWS} Gaussians of SH degree {degree}" in findings["file"].figure
    assert findings["harmonics"].figure.startswith(f"degree {min(degree, 1)} used of {degree}")
    assert "ok invisible: none" in heard.lines
    assert heard.lines[-1].endswith(f"Verdict: sound; {len(findings)} checks, nothing to do.")
    assert len(heard.lines) == len(findings) + 1 and not any("\n" in line for line in heard.lines)


def test_planted_faults_are_counted_and_each_says_what_to_do(tmp_path):
    rows = sound_rows()
    rows["x"][0], rows["f_rest_44"][1] = np.nan, np.inf
    rows["rot_0"][2:5] = 0
    rows["opacity"][10:30] = -9.0
    rows["opacity"][30:40] = 9.0
    rows["scale_0"][100:300] += np.log(20.0)  # needles of 1 : 20
    rows["scale_2"][100:120] -= np.log(1000.0)  # discs and needles of 1 : 1000 and more
    rows["scale_1"][40:60] = rows["scale_2"][40:60] = rows["scale_0"][40:60] = 2.0
    rows["y"][60] = 5000.0
    rows["f_dc_1"][70:90] = 9.0
    rows["f_rest_15"][90] = 12.0  # of degree 1
    findings, heard = examined(write(tmp_path / "a.ply", rows))
    figures = {
        "not finite": "2 (0.5 %)",
        "zero quaternions": "3 (0.75 %)",
        "invisible": "20 (5.1 %)",
        "saturated": "10 (2.5 %)",
        "stiff": "20 (5.1 %)",
        "needles": "200 (51 %)",
        "giants": "20 (5.1 %) in the scene, 0 beyond 3 radii",
    }
    for name, figure in figures.items():
        assert findings[name].figure == figure, name
    assert "20000 (most)" in findings["axis ratios"].figure.replace("2e+04", "20000")
    assert findings["axis ratios"].meaning.endswith("up to 4e+08")
    assert "20 (5.1 %) beyond -0.5 to 1.5" in findings["colours"].figure
    assert "coefficients up to 12" in findings["harmonics"].figure
    expected = {*figures, "extent", "colours", "harmonics"} - {"saturated"}
    assert asked_for(findings) == expected
    assert heard.lines[-1].endswith(f"need attention: {', '.join(n for n in findings if n in expected)}.")


@pytest.mark.parametrize(
    "axes, name, count",
    [
        ((0.4, 0.4, 0.4), "giants", 0),  # of a radius of about 1
        ((0.6, 0.6, 0.6), "giants", 5),
        ((0.01, 0.01, 0.01 / 390), "stiff", 0),
        ((0.01, 0.01, 0.01 / 410), "stiff", 5),
        ((0.01, 0.095, 0.009), "needles", 0),
        ((0.1, 0.1, 0.009), "needles", 0),  # discs
        ((0.01, 0.105, 0.009), "needles", 5),
    ],
)
def test_what_counts_as_too_large_or_too_thin(tmp_path, axes, name, count):
    rows = sound_rows()
    for axis, length in enumerate(axes):
        rows[f"scale_{axis}"][:5] = np.log(length)
    assert examined(write(tmp_path / "a.ply", rows))[0][name].figure.split()[0] == (str(count) if count else "none")


@pytest.mark.parametrize(
    "name, share, change",
    [
        ("invisible", 0.02, {"opacity": -9.0}),
        ("stiff", 0.02, {"scale_0": np.log(0.01 / 500)}),
        ("needles", 0.5, {"scale_0": np.log(0.01 * 20)}),
        ("giants", 0.02, {f"scale_{axis}": np.log(0.6) for axis in range(3)}),
        ("colours", 0.02, {"f_dc_1": 9.0}),
    ],
)
def test_how_many_of_a_kind_ask_for_something(tmp_path, name, share, change):
    for count in (round(share * ROWS), round(share * ROWS) + 1):
        rows = sound_rows()
        for column, value in change.items():
            rows[column][:count] = value
        finding = examined(write(tmp_path / "a.ply", rows))[0][name]
        assert f"{count} (" in finding.figure and bool(finding.advice) == (count > share * ROWS)


def test_opacities_that_are_no_logits_are_reported(tmp_path):
    rows = sound_rows()
    rows["opacity"] = np.random.default_rng(1).random(ROWS)
    findings, _ = examined(write(tmp_path / "a.ply", rows))
    assert asked_for(findings) == {"opacities"} and "between 0.5 and 0.73" in findings["opacities"].meaning


def test_black_has_no_sign(tmp_path):
    rows = sound_rows()
    rows["f_dc_0"] = -1.7727  # a colour of -0.00006
    assert examined(write(tmp_path / "a.ply", rows))[0]["colours"].figure.startswith("0.00 to 0.50 (")


@pytest.mark.parametrize("column, name", [("scale", "scales"), ("f_dc", "colours")])
def test_scales_and_colours_stored_as_plain_values_are_reported(tmp_path, column, name):
    rows, random = sound_rows(), np.random.default_rng(1)
    for axis in "xyz":
        rows[axis] *= 100  # so that a length of 1 to 3 is nothing odd
    for part in range(3):
        rows[f"{column}_{part}"] = random.random(ROWS)
    findings, _ = examined(write(tmp_path / "a.ply", rows))
    assert asked_for(findings) == {name} and "stored as they are" in findings[name].meaning
    rows[f"{column}_0"][:50] -= 1.0  # a few below 0 are what they should be
    assert not asked_for(examined(write(tmp_path / "a.ply", rows))[0])


@pytest.mark.parametrize(
    "comment, own", [("wegs 1.0, run 0a, sky 0, look dusk, 5", True), ("of wegs 1.0", False), ("", False)]
)
def test_what_wegs_can_do_is_advised_for_its_own_files_alone(tmp_path, comment, own):
    rows = sound_rows()
    rows["x"][0], rows["rot_0"][1], rows["f_rest_20"][90], rows["f_dc_1"][70:90] = np.nan, 0, 12.0, 9.0
    rows["scale_0"][100:300] += np.log(20.0)
    rows["scale_1"][40:60] = rows["scale_2"][40:60] = rows["scale_0"][40:60] = 2.0
    rows["opacity"][200:220] = -9.0
    rows["y"][60] = 5000.0
    rows["y"] += 5e6
    (tmp_path / "cameras.json").write_text(cameras_json((0.0, 0.0, -4.0)))
    findings, _ = examined(write(tmp_path / "a.ply", rows, comment))
    words = {
        "not finite": "wegs bake",
        "zero quaternions": "wegs bake",
        "invisible": "prune_opacity",
        "extent": "reach",
        "needles": "scale_rate",
        "giants": "largest_scale",
        "colours": "sh_rate",
        "harmonics": "--sh-degree",
        "float32 positions": "wegs bake",
        "never seen": "prune_contribution",
    }
    assert words.keys() <= asked_for(findings)
    assert {name: word in findings[name].advice for name, word in words.items()} == dict.fromkeys(words, own)
    assert own or not any(word in finding.advice for finding in findings.values() for word in ("wegs", "_", "--"))


def test_coordinates_too_large_for_float32_are_reported_in_units_and_pixels(tmp_path):
    rows, near, far = sound_rows(), (5e6, 0, -4), (5e6, 0, -9)
    rows["x"] += 5e6
    # Half a step of float32 at five millions is a quarter; spread over a radius of about one.
    for cameras, px in (((), "1.4e+02 px where"), ((near, far), "2.7 px in the median of 2 cameras, 3.7 px")):
        (tmp_path / "cameras.json").write_text(cameras_json(*cameras))
        found = examined(write(tmp_path / "a.ply", rows))[0]["float32 positions"]
        assert found.figure.startswith(f"0.3 units, {px}") and "Recentre" in found.advice


def test_the_last_iteration_of_another_programs_run_is_examined(tmp_path):
    (tmp_path / "config.json").write_text('{"learning_rate": 1}')
    for age, (name, count) in enumerate((("30000", 40), ("7000", 50), ("best", 60))):
        path = tmp_path / "point_cloud" / f"iteration_{name}" / "point_cloud.ply"
        path.parent.mkdir(parents=True)
        write(path, sound_rows()[:count])
        os.utime(path, (1e9 + age, 1e9 + age))
    assert examined(tmp_path)[0]["file"].figure.startswith("40 Gaussians")


def test_a_sky_of_ours_is_large_and_seen_by_no_photo_and_sound_all_the_same(tmp_path):
    rows = sound_rows()
    rows["z"][-100:] = -90.0  # behind the camera
    rows["scale_0"][-100:] = rows["scale_1"][-100:] = 4.0
    (tmp_path / "cameras.json").write_text(cameras_json((0.0, 0.0, -4.0)))
    plain, own = (
        examined(write(tmp_path / "a.ply", rows, f"wegs 1.0, run 0a, sky {sky}, look dusk"))[0] for sky in (0, 100)
    )
    assert "never seen" in asked_for(plain) and asked_for(own) == set()


def test_a_sky_of_most_rows_hides_no_fault(tmp_path):
    rows = np.concatenate([sound_rows(), sound_rows(), sound_rows()])
    rows["z"][ROWS:] += 90.0
    rows["scale_0"][:60] = rows["scale_1"][:60] = rows["scale_2"][:60] = 0.0
    rows["x"][60] = 3000.0
    findings, _ = examined(write(tmp_path / "a.ply", rows, f"wegs 1.0, run 0a, sky {2 * ROWS}, look dusk"))
    assert findings["giants"].figure.startswith("60 (15 %) in the scene")
    assert asked_for(findings) == {"giants", "extent"}


def test_missing_and_uncounted_rows_are_reported(tmp_path):
    path = write(tmp_path / "a.ply", sound_rows()[:40], "wegs 1.0, run 0a, sky 50, look dusk")
    findings, _ = examined(path)
    assert asked_for(findings) == {"sky"} and findings["sky"].figure == "50 of 40 Gaussians" and "needles" in findings
    whole = write(tmp_path / "b.ply", sound_rows()).read_bytes()
    row = sound_rows().itemsize
    path.write_bytes(whole.replace(b"vertex 400", b"vertex 300"))
    findings, _ = examined(path)
    assert asked_for(findings) == {"rest of the file"} and findings["rest of the file"].figure == f"{100 * row:,} bytes"
    findings, _ = examined(write(path, sound_rows(), "wegs 1.0, run 0a, sky 0, look end_header"))
    assert "rest of the file" not in findings


def test_one_gaussian_is_counted_in_the_singular(tmp_path):
    path = write(tmp_path / "a.ply", sound_rows()[:1], "wegs 1.0, run 0a, sky 2, look dusk")
    path.write_bytes(path.read_bytes() + b" ")
    findings, _ = examined(path)
    assert findings["file"].figure.startswith("1 Gaussian of SH degree 3, ")
    assert findings["sky"].figure == "2 of 1 Gaussian" and findings["rest of the file"].figure == "1 byte"


def test_scales_that_are_no_logarithms_are_reported(tmp_path):
    rows = sound_rows()
    for axis in range(3):
        rows[f"scale_{axis}"] = 0.01
    findings, _ = examined(write(tmp_path / "a.ply", rows))
    assert asked_for(findings) == {"scales"} and "natural logarithms" in findings["scales"].advice
    assert findings["scales"].figure.startswith("400 (100 %) in the scene")


def test_the_units_of_a_file_change_nothing(tmp_path):
    rows = sound_rows()
    rows["scale_0"][40:45] = 1.0
    plain, _ = examined(write(tmp_path / "a.ply", rows))
    for axis, name in enumerate("xyz"):
        rows[name] *= 1000
        rows[f"scale_{axis}"] += np.log(1000)
    scaled, _ = examined(write(tmp_path / "b.ply", rows))
    assert plain["giants"].figure == scaled["giants"].figure == "5 (1.2 %) in the scene, 0 beyond 3 radii"
    pixels = [findings["float32 positions"].figure.partition(" units, ")[2] for findings in (plain, scaled)]
    halves = [float(findings["extent"].figure.split()[5].strip(",")) for findings in (plain, scaled)]
    assert pixels[0] == pixels[1] and pixels[0].endswith("px") and halves[1] == pytest.approx(1000 * halves[0])


def test_a_file_of_nothing_but_poison_is_read(tmp_path):
    rows = sound_rows()
    rows["x"] = np.nan
    findings, _ = examined(write(tmp_path / "a.ply", rows))
    assert asked_for(findings) == {"not finite", "drawable"}
