"""All commands, and how their errors are reported."""

from __future__ import annotations

import errno
import io
import os
import sys
import warnings
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any

import typer

from forcectl.cli.catalog import explain, list_, schema
from forcectl.cli.diagrams import check, graph
from forcectl.cli.faults import faults
from forcectl.cli.memory import check_memory
from forcectl.cli.net import DEBUG
from forcectl.cli.options import OnceCommand
from forcectl.cli.reproduce import reproduce
from forcectl.cli.robot import robot
from forcectl.cli.run import StrictCommand, run, show
from forcectl.cli.sweep import merge, sweep
from forcectl.cli.tune import vrft
from forcectl.errors import BadInputError, ForcectlError

app = typer.Typer(
    name="forcectl",
    help="Robot force control as Drake diagrams: simulate, draw, check and reproduce.\n\nExample: forcectl run fig_2_7",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

tuning = typer.Typer(
    help="Make a controller from a recorded experiment: forcectl tune vrft record.csv --reference-model 1.5",
    rich_markup_mode=None,
    no_args_is_help=True,
)


def _version(wanted: bool) -> None:
    if wanted:
        import forcectl

        typer.echo(f"forcectl {forcectl.__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
    debug: Annotated[bool, typer.Option(DEBUG, help="Show the traceback of an error; may stand anywhere.")] = False,
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


_LONGEST = 2000  # [characters] of an error message; the middle of a longer one is cut out
_COMMANDS: tuple[Callable[..., None], ...] = (
    schema,
    explain,
    show,
    graph,
    check,
    reproduce,
    robot,
    sweep,
    merge,
    faults,
)
app.command("list", cls=OnceCommand)(list_)
app.command(cls=StrictCommand)(run)
for command in _COMMANDS:
    app.command(cls=OnceCommand)(command)
app.add_typer(tuning, name="tune")
tuning.command(cls=OnceCommand)(vrft)

# Newer versions of Typer carry their own copy of Click, so the base class of usage errors is found by name.
_UsageError: type[Exception] = next(base for base in typer.BadParameter.__mro__ if base.__name__ == "ClickException")


@cache
def _commands() -> Any:
    """All commands, which Typer builds from the signatures of the functions; cached, because that is slow."""
    return typer.main.get_command(app)


def call(look: Callable[[BaseException], None] = lambda error: None) -> int:
    """Run the command of `sys.argv`; returns the exit code.

    Args:
        look: called with an error of forcectl or of a full disk, before its line is printed.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):  # Latin-1 or ASCII: print ? for what it lacks, do not end the command
        sys.stdout.reconfigure(errors="replace")
    # NumPy's overflow warnings would precede the line that names the diverging signal and its time.
    warnings.simplefilter("ignore", RuntimeWarning)
    warnings.filterwarnings("ignore", "Glyph .* missing from font")  # drawn as an empty box
    try:
        os.getcwd()
    except OSError:
        return _print_error("the working directory is gone: must be one that exists", 2)
    try:
        check_memory()
        return _commands()(standalone_mode=False, prog_name="forcectl") or 0
    except MemoryError:
        return _print_error("not enough memory: only results that were reported as written are kept", 1)
    except ForcectlError as error:
        look(error)
        return _print_error(str(error), 2 if isinstance(error, BadInputError) else 1)
    except _UsageError as error:
        context = getattr(error, "ctx", None)
        see = f" (see {context.command_path} --help)" if context else ""
        text = getattr(error, "format_message", error.__str__)()
        return _print_error(f"{text.rstrip('.')}{see}", 2)
    except typer.Abort:
        return _print_error("stopped", 1)
    except (BrokenPipeError, SystemExit) as error:  # the reader of a pipe, such as `head`, has ended
        # Rich turns a broken pipe into SystemExit.
        if isinstance(error, SystemExit) and not isinstance(error.__context__, BrokenPipeError):
            raise
        sys.stderr.close()
        return 1
    except OSError as error:
        if error.errno != errno.ENOSPC or error.filename is not None:
            raise
        look(error)
        return _print_error(f"the output of this command cannot be written: {error.strerror}", 1)


def _print_error(text: str, code: int) -> int:
    line = " ".join(text.split())
    line = line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 2 :]}"
    print(f"error: {line}", file=sys.stderr)
    return code
