"""Options that several commands share, and the console for tables."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from forcectl.cli import completion
from forcectl.errors import BadInputError

if TYPE_CHECKING:
    from rich.console import Console

Target = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="Name of a shipped experiment or path of a YAML file.",
        autocompletion=completion.experiments,
    ),
]
Diagrammed = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="Experiment, YAML file, or package.module:function of a Diagram.",
        autocompletion=completion.experiments,
    ),
]
Variant = Annotated[
    str | None,
    typer.Option(
        metavar="V",
        help="This variant only; default all (graph, check: the first).",
        autocompletion=completion.variants,
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="a.b.c=value", help="Override one value; may be repeated.", autocompletion=completion.settings
    ),
]
Fidelity = Annotated[
    str | None,
    typer.Option(
        metavar="F", help="Multibody (default), Kinematic or OneDimensional.", autocompletion=completion.fidelities
    ),
]
AllowImports = Annotated[
    list[str] | None,
    typer.Option(
        "--allow-imports", metavar="MODULE", help="Module that the scenario may name classes of; may be repeated."
    ),
]
Seed = Annotated[int | None, typer.Option(metavar="N", help="Seed of every random number.")]
Workers = Annotated[int | None, typer.Option(metavar="N", min=1, help="Processes; default one per processor.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the earlier run in --out.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the results as JSON.")]


class OnceCommand(TyperCommand):
    """A command that refuses an option of one value given twice: one of the values would be lost."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse as Typer does, after this check."""
        order: list[Any] = self.make_parser(ctx).parse_args(args=[*args])[2]
        for option in (each for each in order if each.param_type_name == "option" and not each.multiple):
            has_value = not option.is_flag or option.secondary_opts
            if has_value and order.count(option) > 1 and not ctx.resilient_parsing:
                raise BadInputError(f"{'/'.join([*option.opts, *option.secondary_opts])}: must stand once")
        return super().parse_args(ctx, args)


def echo_json(content: Any) -> None:
    """Print as JSON, without NaN."""
    typer.echo(json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False))


def terminal() -> Console:
    """Standard output, for tables."""
    from rich.console import Console

    return Console()
