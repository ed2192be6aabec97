"""Reports: plain lines in a log file, a bar and a table where someone watches."""

import errno
import io
import subprocess
import sys
from pathlib import Path

import pytest
from numba import njit
from rich.console import Console

from wegs_cli import terminal
from wegs_cli.terminal import Terminal


@pytest.fixture(autouse=True)
def nothing_set(monkeypatch):
    """What rich reads of the user's environment, and follows before it looks at what it writes to."""
    for name in ("FORCE_COLOR", "NO_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE", "COLUMNS", "LINES", "TERM"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def clock(monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    return now


def test_a_log_file_gets_a_line_now_and_then_and_the_last_one(clock, capsys):
    with Terminal() as plain:
        for step in range(1, 101):
            clock[0] += 1.0
            plain.progress("Training", step, 100, f"loss {step}")
        plain.say("[bold] is no markup here")
        plain.warn(long := "as long as it is, " * 20 + "on one line")
        plain.table("Done", [("run", "runs/a")])
    lines = capsys.readouterr().out.splitlines()
    steps = [int(line.split()[1].split("/")[0]) for line in lines if line.startswith("Training")]
    assert steps == [1, 16, 31, 46, 61, 76, 91, 100]
    assert lines[-3:] == ["[bold] is no markup here", long, "run: runs/a"]
    assert not any("\x1b" in line for line in lines)


def test_a_log_file_says_what_time_is_left_also_where_parts_differ(clock, capsys):
    with Terminal() as plain:
        for step in range(1, 101):
            clock[0] += 1.0 if step <= 50 else 3.0
            plain.progress("Training", step, 100, share=step / 200 if step <= 50 else (3 * step - 100) / 200)
    lines = [line for line in capsys.readouterr().out.splitlines() if "left" in line]
    assert lines[0] == "Training 16/100, 0:03:04 left" and lines[2] == "Training 46/100, 0:02:34 left"
    assert lines[-1] == "Training 99/100, 0:00:04 left"


def test_compiling_the_kernels_is_announced(capsys):
    with Terminal():
        njit(lambda x: x + 1)(1.0)
    assert capsys.readouterr().out.startswith("Compiling the kernels")


@pytest.mark.parametrize("done", [1, 2])
def test_a_full_bar_stays_above_what_is_said_after_it_and_another_goes_on(done):
    with Terminal() as watched:
        watched.console = Console(file=io.StringIO(), force_terminal=True, width=120)
        for tell in (watched.say, watched.warn):
            watched.progress("Refinement", done, 2)
            tell("look.ply: 100 Gaussians")
            assert (watched.bar is None) == (done == 2)


def test_the_same_work_on_another_thing_gets_a_bar_of_its_own():
    with Terminal() as watched:
        watched.console = Console(file=io.StringIO(), force_terminal=True, width=120)
        for done in (1, 2, 1):
            watched.progress("Refinement", done, 2)
        assert not watched.bar.finished and watched.bar.tasks[0].finished_time is None


@pytest.mark.parametrize("width", [40, 79, 80])
def test_a_narrow_terminal_gets_what_is_done_and_the_time_left(width):
    screen = io.StringIO()
    with Terminal() as watched:
        watched.console = Console(file=screen, force_terminal=True, width=width)
        watched.progress("Training", 5, 6000, "loss 0.349, 11650 Gaussians")
    assert "5/6000" in screen.getvalue() and "left" in screen.getvalue()
    assert ("loss" in screen.getvalue()) == (width >= 80)


def test_a_terminal_gets_a_bar_with_an_estimate_and_a_table():
    screen = io.StringIO()
    with Terminal() as watched:
        watched.console = Console(file=screen, force_terminal=True, width=120)
        for done in (1, 2):
            watched.progress("Training", done, 2, "loss 0.5")
        watched.progress("Frames", 1, 3)  # another kind of work: a bar of its own
        watched.table("Done", [("run", "runs/a")])
        assert watched.bar is None
    drawn = screen.getvalue()
    for words in ("Training", "2/2", "left", "loss 0.5", "Frames", "1/3", "Done", "runs/a"):
        assert words in drawn


def test_a_table_with_a_header_has_its_columns_below_each_other(capsys):
    rows = [("a", "long choice", "1"), ("longer curve", "b", "2")]
    with Terminal() as plain:
        plain.table("Figures", rows, ("curve", "choice", "ms"))
    title, *lines = capsys.readouterr().out.splitlines()
    assert (
        title == "Figures"
        and [line.index(word) for line, word in zip(lines, ("ms", "1", "2"), strict=True)] == [27] * 3
    )
    screen = io.StringIO()
    with Terminal() as watched:
        watched.console = Console(file=screen, force_terminal=True, width=120)
        watched.table("Figures", rows, ("curve", "choice", "ms"))
    assert all(word in screen.getvalue() for word in ("Figures", "choice", "long choice"))


def test_a_line_break_in_a_name_makes_no_second_line(capsys):
    with Terminal() as watched:
        watched.say("runs/a\nb: \x1b[2J")
        watched.warn("photo\r.jpg\u2028")
        watched.progress("Photos", 1, 1, "a\nb.jpg")
        watched.progress("Refinement of a\nb", 1, 1)
        watched.table("Done", [("run", "a\nb")])
        watched.table("Training: a\nb", [("a\nb", "default", "1")], ("curve", "choice", "s"))
    assert capsys.readouterr().out.splitlines() == [
        r"runs/a\nb: \x1b[2J",
        r"photo\r.jpg\u2028",
        r"Photos 1/1  a\nb.jpg",
        r"Refinement of a\nb 1/1",
        r"run: a\nb",
        r"Training: a\nb",
        "curve  choice   s",
        r"a\nb   default  1",
    ]


@pytest.mark.parametrize("path", ["runs/Rome [old]", "runs/[/c]", "runs/trip:sun:2020"])
def test_paths_are_shown_as_they_are(path, monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    ways = (
        lambda watched: watched.say(path),
        lambda watched: watched.warn(path),
        lambda watched: watched.table("Done", [("run", path)]),
        lambda watched: watched.table("Done", [("1", "2")], (path, "ms")),
        lambda watched: watched.progress("Photos", 1, 1, path),
    )
    for way in ways:
        with Terminal() as watched:
            assert watched.console.is_terminal
            way(watched)
        assert path in capsys.readouterr().out


@pytest.mark.parametrize("width", [40, 120])
def test_a_table_too_wide_for_the_terminal_breaks_no_number(width):
    screen = io.StringIO()
    with Terminal() as narrow:
        narrow.console = Console(file=screen, force_terminal=True, width=width, highlight=False)
        cells = ("runs/a", "default", "0.00403 (0.0037 to 0.0043)", "21.345 (21.3 to 21.4)")
        narrow.table("Baking", [cells], ("curve", "choice", "error", "PSNR dB"))
    assert all(cell in screen.getvalue() for cell in cells)
    assert ("    error: 0.00403 (0.0037 to 0.0043)\n    PSNR dB: 21.345" in screen.getvalue()) == (width == 40)


def test_long_paths_in_a_narrow_terminal_are_folded_and_not_cut(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "80")
    path = "/home/somebody/" + "reconstruction/" * 8 + "point_cloud.ply"
    with Terminal() as watched:
        watched.table("Done", [("run", path)])
    lines = [line.split("│")[2].strip() for line in capsys.readouterr().out.splitlines() if line.count("│") == 3]
    assert "".join(lines) == path


SPEAKS = """
import sys
from wegs_cli.terminal import Terminal

with Terminal() as terminal:
    terminal.say("one")
    sys.stdout.flush()
    sys.stdin.readline()  # until nobody listens
    for _ in range(3):
        terminal.warn("two")
        terminal.table("three", [("a", "b")])
        terminal.progress("four", 1, 1)
print("worked", file=sys.stderr)
"""


def test_work_goes_on_after_its_output_is_closed():
    """As `wegs bake ... | head -1`."""
    ways = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", SPEAKS], cwd=Path(__file__).parents[2], **ways) as speaker:
        assert speaker.stdout.readline() == "one\n"
        speaker.stdout.close()
        speaker.stdin.close()
        assert (speaker.stderr.read(), speaker.wait()) == ("worked\n", 0)


def test_output_to_a_full_disk_is_an_error():
    class Full(io.StringIO):
        def write(self, _):
            raise OSError(errno.ENOSPC, "No space left on device")

    terminal = Terminal()
    terminal.console.file = Full()
    with pytest.raises(OSError, match="No space left"):
        terminal.say("Step 5: held-out PSNR 20.00 dB")


def test_a_bar_on_a_terminal_that_was_closed_ends_without_a_word(monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.StringIO())  # whose file is not led to nowhere, as that of pytest would be

    class Gone:
        def stop(self):
            raise OSError(errno.EIO, "Input/output error")

    with pytest.raises(KeyboardInterrupt), Terminal() as watched:
        watched.bar = Gone()
        raise KeyboardInterrupt
