"""What becomes of exceptions: one line and the right exit code for a user's mistake,
a traceback for a defect of ours."""

import errno
import shlex
import sys
import textwrap
from pathlib import Path

import click
import cv2
import pytest
from click.testing import CliRunner

from core.errors import BadInput, BadSetting, TrainingStopped, command
from tests.failing import opencv_error
from tests.programs import run_python
from wegs_cli import main
from wegs_cli.main import Group


def outcome_of(problem: BaseException):
    """Run a command that raises."""

    @click.group(cls=Group)
    def group():
        pass

    @click.command()
    def fail():
        raise problem

    group.get_command = lambda context, name: fail
    return CliRunner().invoke(group, ["fail"])


@pytest.mark.parametrize(
    "problem, words, code",
    [
        (BadInput("photo.jpg is broken.", "Remove it."), "photo.jpg is broken. Remove it.", 1),
        (BadInput("There is no folder a\nb."), r"There is no folder a\nb.", 1),
        (BadSetting("steps=0 is too small."), "steps=0 is too small.", 1),
        (TrainingStopped("It diverged.", "Resume."), "It diverged. Resume.", 1),
        (KeyboardInterrupt("Step 7 is kept."), "Stopped. Step 7 is kept.", 130),
        (KeyboardInterrupt(), "Stopped.", 130),
        (OSError(errno.ENOSPC, "No space left on device", "a.ply"), "The disk is full: a.ply was not written.", 1),
        (OSError(errno.EROFS, "Read-only file system", "a.ply"), "a.ply: Read-only file system.", 1),
        (OSError(errno.ENAMETOOLONG, "File name too long", "aaa"), "aaa: File name too long.", 1),
        (
            OSError(errno.EIO, "Input/output error", "history.csv"),
            "history.csv: Input/output error. Check its disk, or",
            1,
        ),
        (UnicodeEncodeError("utf-8", "photos \udcfe", 7, 8, "no"), r"'photos \udcfe' cannot be written as utf-8", 1),
        (MemoryError(), "not enough memory", 1),
        (opencv_error(cv2.Error.StsNoMem), "not enough memory", 1),
        (RuntimeError("cannot cache function 'f': no locator available for file 'f.py'"), "Set NUMBA_CACHE_DIR", 1),
        (RuntimeError("Symlink loop from '/photos'"), "Symlink loop from '/photos'. Choose another path.", 1),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried 9 bytes"), "not enough memory", 1),
    ],
)
def test_a_users_problem_is_one_line_and_an_exit_code(problem, words, code):
    result = outcome_of(problem)
    assert result.exit_code == code
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("wegs: ") and words in lines[0]
    assert result.stdout == ""


@pytest.mark.parametrize("problem", [ValueError("ours"), OSError(errno.EIO, "ours"), RuntimeError("ours")])
def test_a_defect_keeps_its_traceback(problem):
    assert outcome_of(problem).exception is problem


@pytest.mark.parametrize(
    "arguments",
    [
        ["bogus"],
        ["--bogus"],
        ["train", "--bogus"],
        ["train", "--steps", "many"],
        ["train", "--steps", "0"],
        ["train", "--preset", "best"],
        ["train", "a", "b"],
        ["bake", "-o", "a.ply"],
        ["bake", "--appearance", "neutral"],
        ["interpolate", "a.jpg"],
        ["interpolate", "a.jpg", "b.jpg", "--steps", "1"],
        ["eval", "--protocol", "third"],
        ["sfm"],
    ],
)
def test_a_wrong_command_line_is_one_line_and_exit_code_2(arguments):
    result = CliRunner().invoke(main.wegs, arguments)
    assert result.exit_code == 2
    assert len(result.stderr.strip().splitlines()) == 1 and "--help" in result.stderr


@pytest.mark.parametrize("wanted", [True, False])
def test_errors_are_red_unless_the_user_wants_no_colour(monkeypatch, wanted):
    monkeypatch.setenv("NO_COLOR", "" if wanted else "1")
    result = CliRunner().invoke(main.wegs, ["eval", "--run", "nowhere"], color=True)
    assert result.exit_code == 1 and ("\x1b[31m" in result.stderr) == wanted


def test_a_foreign_core_is_named(tmp_path):
    (tmp_path / "core").mkdir()
    (tmp_path / "core" / "__init__.py").write_text("")
    program = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from wegs_cli.main import run; run()"
    done = run_python(program, check=False)
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1 and str(tmp_path / "core") in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="Windows removes no folder that a program is in")
def test_a_folder_that_was_removed_is_named(tmp_path):
    program = (
        f"import os; from wegs_cli.main import run; os.chdir({str(tmp_path)!r}); os.rmdir({str(tmp_path)!r}); run()"
    )
    done = run_python(program, check=False)
    assert done.returncode == 1 and "The folder you are in was removed" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_our_core_is_recognised():
    assert main.foreign_core() is None


def test_a_command_to_type_can_be_pasted():
    line = command("wegs", "train", Path("my photos"), "-o", Path("runs/a"))
    assert line == "wegs train 'my photos' -o runs/a"
    assert shlex.split(line)[2] == "my photos"
    assert command("wegs", "train", Path("-x"), "-o", "a") == "wegs train ./-x -o a"


def stopped(folder: Path, body: str, name: str = "SIGINT", before: str = "SIG_DFL") -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command whose function has this body. In it, `stop()` sends the signal `name`
    to the process, in which it was handled as `before` when the process began."""
    code = (
        "import os, signal, click, core.data",  # pycolmap, which core.data imports, handles SIGTERM by itself
        "from wegs_cli.terminal import Terminal",
        f"stop = lambda: os.kill(os.getpid(), signal.{name})",
        "@click.command()",
        "def command():",
        textwrap.indent(textwrap.dedent(body), "    "),
    )
    (folder / "stopped.py").write_text("\n".join(code))
    # A shell's jobs and nohup leave signals ignored.
    program = (
        f"import signal, sys; sys.path.insert(0, {str(folder)!r}); signal.signal(signal.{name}, signal.{before})\n"
    )
    program += "from wegs_cli import main; main.COMMANDS['stop'] = 'stopped:command'; main.run()"
    done = run_python(program, "stop", check=False)
    return done.returncode, done.stdout, done.stderr.strip()


SIGNALS = [
    pytest.param(name, marks=pytest.mark.skipif(sys.platform == "win32", reason="Windows knows no such signals"))
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
]


@pytest.mark.parametrize("name", SIGNALS)
def test_a_signal_during_the_work_lets_it_tidy_up(tmp_path, name):
    body = """
        with Terminal() as terminal:
            try: stop()
            finally: terminal.say('tidied')
    """
    assert stopped(tmp_path, body, name) == (130, "tidied\n", "wegs: Stopped.")


@pytest.mark.parametrize("name", SIGNALS)
def test_a_signal_while_torch_loads_ends_the_program_at_once(tmp_path, name):
    """Parts of torch swallow a KeyboardInterrupt, or end the program by it with C++ addresses."""
    body = """
        try: stop()
        except KeyboardInterrupt: print('goes on')
    """
    assert stopped(tmp_path, body, name) == (130, "", "wegs: Stopped.")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGHUP")
@pytest.mark.parametrize(("before", "code", "said"), [("SIG_DFL", 130, "wegs: Stopped."), ("SIG_IGN", 0, "")])
def test_a_closed_terminal_is_a_single_ctrl_c_and_none_under_nohup(tmp_path, before, code, said):
    """It sends two signals, from the shell and from the system."""
    body = """
        with Terminal() as terminal:
            try: stop()
            finally: stop(); terminal.say('tidied')
    """
    assert stopped(tmp_path, body, "SIGHUP", before) == (code, "tidied\n", said)


def test_what_the_terminal_cannot_show_appears_as_its_code(tmp_path):
    (tmp_path / "shown.py").write_text("import click\n@click.command()\ndef show():\n    print('caf\\xe9.jpg')")
    program = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
    program += "from wegs_cli import main; main.COMMANDS['show'] = 'shown:show'; main.run()"
    done = run_python(program, "show", check=False, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stdout) == (0, "caf\\xe9.jpg\n")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_while_the_engine_loads_is_a_ctrl_c(tmp_path, name):
    """pycolmap would take it for a broken installation."""
    (tmp_path / "pycolmap.py").write_text(f"import os, signal\nos.kill(os.getpid(), signal.{name})\nloaded = True")
    (tmp_path / "stopped.py").write_text("import click\n@click.command()\ndef stop():\n    import core.data")
    program = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
    # A shell's background jobs ignore it.
    program += "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    program += "from wegs_cli import main; main.COMMANDS['stop'] = 'stopped:stop'; main.run()"
    done = run_python(program, "stop", check=False)
    assert (done.returncode, done.stdout, done.stderr.strip()) == (130, "", "wegs: Stopped.")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_second_signal_does_not_change_the_last_words(tmp_path, name):
    lines = ("import os, signal, click, core.words", "line_of = core.words.on_one_line")
    lines += (
        "def signalled(line):",
        f"    os.kill(os.getpid(), signal.{name})",
        "    return line_of(line)",
        "core.words.on_one_line = signalled",
    )
    lines += ("@click.command()", "def stop():", "    raise KeyboardInterrupt")
    (tmp_path / "stopped.py").write_text("\n".join(lines))
    program = f"import signal, sys; sys.path.insert(0, {str(tmp_path)!r})\n"
    program += "from wegs_cli import main; main.COMMANDS['stop'] = 'stopped:stop'; main.run()"
    done = run_python(program, "stop", check=False)
    assert (done.returncode, done.stdout, done.stderr.strip()) == (130, "", "wegs: Stopped.")


def test_a_stop_in_the_first_moments_is_silent(tmp_path):
    (tmp_path / "click.py").write_text("raise KeyboardInterrupt")  # while even the command line still loads
    program = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from wegs_cli.__main__ import run; run()"
    done = run_python(program, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_a_program_without_a_terminal_works_all_the_same():
    program = "import sys; sys.stdout = sys.stderr = None; from wegs_cli.main import run; run()"
    done = run_python(program, "--version", check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_program_runs_where_another_program_catches_what_it_prints():
    program = "import io, sys; sys.stdout = io.StringIO(); from wegs_cli.main import run; run()"
    done = run_python(program, "--version", check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    "typed, advice",
    [
        (["tarin", "photos"], "No such command 'tarin'. Did you mean 'train'?"),
        (["quit"], "No such command 'quit'. Try: wegs --help"),
        (["train", "photos", "--stps", "3"], "'--steps'?) Try: wegs train --help"),
        (["evla"], "No such command 'evla'. Did you mean 'eval'? Try: wegs --help"),
        (["eval", "runs/x"], "Got unexpected extra argument (runs/x). A run is named by --run. Try: wegs eval --help"),
        (["doctor", "runs/x", "runs/y"], "Got unexpected extra argument (runs/y). Try: wegs doctor --help"),
        (
            ["train", "photos", "--memory", "4"],
            "No such option '--memory'. It goes before the command: wegs --memory GIB train",
        ),
        (["--memory", "much", "train"], "'much' is not a valid number. Try: wegs --help"),
        (
            ["interpolate", "a.jpg", "b.jpg", "--steps", "few"],
            "'few' is not a valid whole number. Try: wegs interpolate --help",
        ),
        (
            ["train", "photos", "--steps", "few"],
            "'--steps': steps=few is not a whole number. Give one of at least 1, or auto. Try: wegs train --help",
        ),
        (
            ["train", "photos", "--sh-degree", "7"],
            "'--sh-degree': sh_degree=7 is too large. Give one from 0 to 3, or auto. Try: wegs train --help",
        ),
        (
            ["train", "photos", "--set", "masks=people"],
            "masks is no setting but an option of the command line. Type: --masks ...",
        ),
        (
            ["train", "photos", "--set", "resume=1"],
            "resume is no setting but an option of the command line. Type: --resume",
        ),
        (
            ["train", "photos", "--config", "x.toml"],
            "x.toml: masks is no setting but an option of the command line. Type: --masks ...",
        ),
        (
            ["train", "a.mp4"],
            "a.mp4 is a file, not a folder. Take pictures out of it: mkdir photos; ffmpeg -i a.mp4 -vf fps=2 photos/%04d.png",
        ),
        (["train", "transforms.json"], "transforms.json is a file, not a folder. Give the folder it is in: ."),
        (["doctor", "transforms.json"], "transforms.json is a file, not a folder. Give the folder it is in: ."),
    ],
)
def test_a_command_line_that_is_nearly_right_is_corrected(typed, advice, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a.mp4", "transforms.json"):
        Path(name).touch()
    Path("x.toml").write_text('masks = "people"\n')
    result = CliRunner().invoke(main.wegs, typed, prog_name="wegs")
    assert result.exit_code in (1, 2) and advice in result.stderr
