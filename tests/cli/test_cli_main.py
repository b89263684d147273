"""The command line: start-up, global options, and how errors are shown."""

from __future__ import annotations

import subprocess
import sys

import pytest

import stereomate
from stereomate.cli import main
from stereomate.cli.logs import LOGGER, log_to_file, log_to_stderr
from stereomate.cli.settings import Settings, bytes_from_text
from stereomate.errors import InputError, StorageError

HEAVY = ("numpy", "numba", "rasterio", "cv2", "scipy", "pyproj", "matplotlib", "shapely", "pydantic")


def stereomate_command(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "stereomate", *arguments], capture_output=True, text=True, check=False
    )


def test_help_imports_nothing_heavy():
    code = (
        "import sys\n"
        "from stereomate.cli import main\n"
        "try:\n    main.run(['--help'])\n"
        "except SystemExit as end:\n    assert end.code == 0, end.code\n"
        f"print('LOADED', [name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.rstrip().endswith("LOADED []")
    for name in main.COMMANDS:
        assert f"  {name}" in done.stdout


def test_package_itself_is_light():
    code = "import sys, stereomate; print([name for name in ('numpy', 'numba') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_version():
    done = stereomate_command("--version")
    assert (done.returncode, done.stdout.strip()) == (0, f"stereomate {stereomate.__version__}")


def test_error_is_one_line_and_exit_code_2():
    done = stereomate_command("check", "no-such-project.toml")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: ")
    assert "no-such-project.toml" in done.stderr


def test_debug_shows_the_traceback():
    done = stereomate_command("check", "no-such-project.toml", "--debug")
    assert done.returncode == 2
    assert "Traceback" in done.stderr


def test_unknown_option_is_refused():
    assert stereomate_command("check", "--nonsense", "x.toml").returncode == 2


@pytest.mark.parametrize(
    ("given", "ordered"),
    [
        (["check", "a.toml", "--threads", "3"], ["--threads", "3", "check", "a.toml"]),
        (["check", "-v", "a.toml", "--memory=2G"], ["-v", "--memory=2G", "check", "a.toml"]),
        (["-q", "check", "a.toml", "--debug"], ["-q", "--debug", "check", "a.toml"]),
        (["check", "--", "-v"], ["check", "--", "-v"]),
    ],
)
def test_global_options_may_stand_anywhere(given, ordered):
    assert main.global_options_first(given) == ordered


@pytest.mark.parametrize(
    ("text", "size"),
    [("500MB", 500 * 1024**2), ("2G", 2 * 1024**3), ("1.5GiB", 3 * 1024**3 // 2), ("100000000", 10**8)],
)
def test_memory_sizes(text, size):
    assert bytes_from_text(text) == size


@pytest.mark.parametrize("text", ["much", "-1G", "1M", ""])
def test_memory_that_is_no_size_is_refused(text):
    with pytest.raises(InputError, match="--memory"):
        bytes_from_text(text)


def test_threads_come_from_the_environment(monkeypatch):
    monkeypatch.setenv("STEREOMATE_THREADS", "7")
    assert Settings.from_options(None, None, 0, False).threads == 7
    assert Settings.from_options(2, None, 0, False).threads == 2
    monkeypatch.setenv("STEREOMATE_THREADS", "many")
    with pytest.raises(InputError, match="STEREOMATE_THREADS"):
        Settings.from_options(None, None, 0, False)


def test_full_disk_of_a_library_is_one_line(monkeypatch, capsys):
    def application():
        def fails(**_):
            raise OSError(28, "No space left on device", "out.tif")

        return fails

    monkeypatch.setattr(main, "application", application)
    with pytest.raises(SystemExit) as end:
        main.run(["check"])
    assert end.value.code == 2
    assert capsys.readouterr().err == "error: out.tif: No space left on device\n"


def test_a_bug_keeps_its_traceback(monkeypatch):
    def application():
        def fails(**_):
            raise ZeroDivisionError

        return fails

    monkeypatch.setattr(main, "application", application)
    with pytest.raises(ZeroDivisionError):
        main.run(["check"])


def test_log_file_has_what_was_said_before_it_was_open(tmp_path, capsys):
    log_to_stderr(0)
    LOGGER.getChild("project").info("read early")
    path = tmp_path / "out" / "run.log"

    def work() -> None:
        with log_to_file(path):
            LOGGER.warning("half way")
            raise InputError("must be better", field="x")

    with pytest.raises(InputError):
        work()
    text = path.read_text()
    first = f"stereomate {stereomate.__version__}, Python"
    places = [
        text.index(word) for word in (first, "command line:", "read early", "half way", "ended by InputError")
    ]
    assert places == sorted(places)
    assert "Traceback" in text
    # The terminal gets the warning; the error is said once, by whoever ends the program.
    assert capsys.readouterr().err == "WARNING: half way\n"
    LOGGER.info("after")
    assert "after" not in path.read_text()


def test_log_file_below_a_regular_file(tmp_path):
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(StorageError, match=r"file.run\.log: cannot write"),
        log_to_file(tmp_path / "file" / "run.log"),
    ):
        pass


@pytest.mark.parametrize(("verbosity", "expected"), [(-1, 0), (0, 1), (1, 2), (2, 3)])
def test_verbosity(verbosity, expected, capsys):
    log_to_stderr(verbosity)
    LOGGER.debug("detail")
    LOGGER.info("progress")
    LOGGER.warning("doubt")
    assert len(capsys.readouterr().err.splitlines()) == expected
