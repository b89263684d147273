"""The `stereomate` command: global options, the list of commands, and how errors are shown.

A command is a module of this folder with a function ``register(app: typer.Typer) -> None`` that adds itself
to the application. Its module imports nothing heavy at its top (numpy, numba, rasterio, cv2): what a
command needs is imported inside its function, so that ``stereomate --help`` answers at once.
"""

from __future__ import annotations

import atexit
import errno
import gc
import importlib
import sys
import traceback
from typing import Annotated, Final

import typer

from stereomate import __version__
from stereomate.cli.logs import log_to_stderr
from stereomate.cli.settings import Settings
from stereomate.errors import StereomateError

# One line per command, in the order of `stereomate --help`: the name of a module of stereomate.cli.
COMMANDS: Final = (
    "init",
    "check",
    "interior",
    "orient",
    "surface",
    "run",
    "mosaic",
    "report",
    "demo",
    "view",
    "publish",
    "measure",
    "heights",
    "laws",
    "homogeneity",
    "overcorrection",
    "empirical",
    "relative",
    "georef",
    "convert",
)

# Global options may stand before or after the command; the value says whether an argument follows.
_GLOBAL: Final = {"--threads": True, "--memory": True, "--verbose": False, "--quiet": False, "--debug": False}
_GLOBAL_SHORT: Final = ("-v", "-vv", "-vvv", "-q")
_STORAGE_ERRNO: Final = {
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EROFS,
    errno.EACCES,
    errno.EPERM,
    errno.ENOTDIR,
}


def application() -> typer.Typer:
    """The typer application with every command of `COMMANDS`."""
    app = typer.Typer(
        name="stereomate",
        help="Orient aerial and drone photographs rigorously in your map projection, and make orthophotos "
        "anyone can view and measure in stereo.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        epilog="Global options may stand before or after the command.",
    )
    app.callback()(_global_options)
    for name in COMMANDS:
        importlib.import_module(f"stereomate.cli.{name}").register(app)
    return app


def run(arguments: list[str] | None = None) -> None:
    """Entry point: exit code 0 done, 1 a bug, 2 wrong input or a place that cannot be written."""
    given = sys.argv[1:] if arguments is None else arguments
    if arguments is None:
        _collect_seldom()
    debug = "--debug" in given
    try:
        application()(args=global_options_first(given), prog_name="stereomate")
    except StereomateError as error:
        _fail(str(error), debug)
    except OSError as error:
        # A disk that fills in the middle of a library's own write arrives as a bare OSError.
        if error.errno not in _STORAGE_ERRNO:
            raise
        place = f"{error.filename}: " if error.filename else ""
        _fail(f"{place}{error.strerror or error}", debug)


def _collect_seldom() -> None:
    """Save half a second of every command: collections during imports, and one of everything at the end."""
    gc.set_threshold(100_000, 50, 50)
    atexit.register(gc.freeze)


def global_options_first(arguments: list[str]) -> list[str]:
    """The command line with its global options moved before the command."""
    front: list[str] = []
    rest: list[str] = []
    remaining = iter(arguments)
    for argument in remaining:
        name = argument.split("=", 1)[0]
        if argument == "--":
            rest += ["--", *remaining]
        elif argument in _GLOBAL_SHORT or name in _GLOBAL:
            front.append(argument)
            if _GLOBAL.get(name) and "=" not in argument:
                front += [value for value in [next(remaining, None)] if value is not None]
        else:
            rest.append(argument)
    return front + rest


def _global_options(
    context: typer.Context,
    threads: Annotated[
        int | None, typer.Option("--threads", help="Threads to use [default: STEREOMATE_THREADS, else all].")
    ] = None,
    memory: Annotated[
        str | None, typer.Option("--memory", help="Memory for working buffers, as 500MB or 2G.")
    ] = None,
    verbose: Annotated[
        int, typer.Option("--verbose", "-v", count=True, help="Say more; -vv says everything.")
    ] = 0,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=lambda value: _show_version(value), is_eager=True)
    ] = False,
) -> None:
    verbosity = -1 if quiet else verbose
    settings = Settings.from_options(threads, memory, verbosity, debug)
    settings.apply_to_environment()
    log_to_stderr(verbosity)
    context.obj = settings


def _show_version(value: bool) -> None:
    if value:
        typer.echo(f"stereomate {__version__}")
        raise typer.Exit


def _fail(message: str, debug: bool) -> None:
    if debug:
        traceback.print_exc()
    sys.stdout.flush()
    # One line, whatever a library put into its text.
    print("error: " + " ".join(message.split()), file=sys.stderr)
    sys.stderr.flush()
    sys.exit(2)
