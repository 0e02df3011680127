"""The command line. Commands import what they need when they run, so that `--help` does not wait for Drake.

Exit codes: 0 done; 1 a run failed, an expectation was missed or the doctor found errors; 2 bad input.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from forcectl.errors import BadInputError, ForcectlError, unknown
from forcectl.runs.robots.command import robot, say_assumed
from forcectl.sweeps.commands import merge, sweep

if TYPE_CHECKING:
    from rich.console import Console

app = typer.Typer(
    name="forcectl",
    help="Robot force control as Drake diagrams: simulate, draw, check and reproduce.\n\nExample: forcectl run fig_2_7",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

tuning = typer.Typer(
    help="Make a controller from a recorded experiment: forcectl tune vrft record.csv --reference-model 1.5",
    rich_markup_mode=None,
    no_args_is_help=True,
)
app.add_typer(tuning, name="tune")

Target = Annotated[str, typer.Argument(metavar="SCENARIO", help="Name of a shipped experiment or path of a YAML file.")]
Diagrammed = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="Experiment, YAML file, or package.module:function of a Diagram.")
]
Variant = Annotated[
    str | None, typer.Option(metavar="V", help="This variant only; default all (graph, check: the first).")
]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="a.b.c=value", help="Override one value; may be repeated.")
]
Fidelity = Annotated[str | None, typer.Option(metavar="F", help="Multibody (default), Kinematic or OneDimensional.")]
Seed = Annotated[int | None, typer.Option(metavar="N", help="Seed of every random number.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the earlier run in --out.")]


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
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command("list")
def list_(
    tag: Annotated[
        str | None, typer.Argument(metavar="[!TAG]", help="Show the keys of what this tag stands for.")
    ] = None,
) -> None:
    """Show experiments, presets, slots and what fills them, and blocks; or the keys of one part.

    Example: forcectl list '!Integral'
    """
    from forcectl.runs.listing import catalog_tables, tag_tables

    console = _console()
    for table in tag_tables(tag) if tag else catalog_tables():
        console.print(table)
        console.print()


@app.command()
def schema(
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="File to write (replaced if it exists).")] = None,
) -> None:
    """Print the JSON Schema of scenario files, for completion and checks in an editor.

    Example: forcectl schema --out scenario.schema.json
    """
    import json

    from forcectl.scenario.json_schema import scenario_schema

    text = json.dumps(scenario_schema(), indent=1, ensure_ascii=False, allow_nan=False)
    if out is None:
        typer.echo(text)
        return
    try:
        out.write_text(f"{text}\n", encoding="utf-8")
    except OSError as error:
        raise BadInputError(f"--out {str(out)!r} cannot be written: {error.strerror}") from None
    typer.echo(f"wrote {out}")


@app.command()
def run(
    scenario: Target,
    variant: Variant = None,
    settings: Settings = None,
    seed: Seed = None,
    fidelity: Fidelity = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory to write; default runs/<name>-<n>.")
    ] = None,
    force: Force = False,
    replay: Annotated[
        bool, typer.Option("--replay", help="Also write a 3-D replay, one HTML page per variant.")
    ] = False,
    realtime_rate: Annotated[
        float, typer.Option(metavar="R", min=0.0, help="At most R simulated seconds per second; 0: full speed.")
    ] = 0.0,
) -> None:
    """Simulate a scenario and write log, metrics, figures and block diagram.

    Example: forcectl run fig_2_7 --set station.environment.stiffness=2e4 --seed 3
    """
    from forcectl.runs.directory import free_name
    from forcectl.runs.progress import ProgressBars
    from forcectl.runs.run import run as simulate
    from forcectl.runs.tables import metrics_table, verdict_table
    from forcectl.runs.target import parse_settings
    from forcectl.scenario.catalog import find_scenario

    file = find_scenario(scenario)
    directory = out or free_name(Path("runs"), file.name)
    with ProgressBars() as progress:
        result = simulate(
            file,
            variant=variant,
            overrides=parse_settings(settings),
            seed=seed,
            fidelity=fidelity,
            out=directory,
            force=force,
            replay=replay,
            realtime_rate=realtime_rate,
            progress=progress.show,
        )
    console = _console()
    console.print(metrics_table(result.metrics, f"{file.name}: {file.tree.get('title', '')}"))
    if result.verdicts:
        console.print()
        console.print(verdict_table(result.verdicts, "Expectations"))
        if settings:
            console.print("[dim]Expectations are about the scenario as written; with --set none fails the run.[/]")
    console.print()
    say_assumed(result.assumed)
    typer.echo(f"results in {directory}: log.nc, metrics.json, figures/, diagram.html, scenario.yaml, manifest.json")
    if not result.passed and not settings:
        raise typer.Exit(1)


@app.command()
def graph(
    scenario: Diagrammed,
    format_: Annotated[
        str | None, typer.Option("--format", metavar="svg|html|dot|png|pdf|mermaid", help="Default: as --out, or svg.")
    ] = None,
    depth: Annotated[
        int, typer.Option(metavar="N", min=0, help="Levels of nesting to unfold; the HTML page starts there.")
    ] = 1,
    machine: Annotated[bool, typer.Option("--machine", help="The state machine of the controller instead.")] = False,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="File to write (replaced if it exists).")] = None,
    variant: Variant = None,
    settings: Settings = None,
    fidelity: Fidelity = None,
) -> None:
    """Draw the block diagram of a scenario, or of your own diagram, or a state machine.

    Example: forcectl graph fig_2_7 --format html --depth 2 --out loop.html
    """
    from forcectl.graph import export
    from forcectl.runs.target import named_diagram, named_machine

    chosen = format_ or (export.format_of(out) if out is not None and out.suffix else "svg")
    if chosen not in export.FORMATS:
        raise unknown("format", chosen, export.FORMATS)
    name, content = (named_machine if machine else named_diagram)(scenario, variant, settings, fidelity)
    target = out or Path(f"{name}.{'mmd' if chosen == 'mermaid' else chosen}")
    partial = target.with_name(f".partial-{target.name}")
    try:
        export.graph(content, depth=depth).save(partial, chosen)
        partial.replace(target)
    except OSError as error:
        raise BadInputError(f"--out {str(target)!r} cannot be written: {error.strerror}") from None
    finally:
        partial.unlink(missing_ok=True)
    typer.echo(f"wrote {target}")


@app.command()
def check(
    scenario: Diagrammed,
    variant: Variant = None,
    settings: Settings = None,
    fidelity: Fidelity = None,
    source: Annotated[
        str | None, typer.Option("--from", metavar="PORT", help="Delays from here, such as station.contact_force ...")
    ] = None,
    target: Annotated[
        str | None, typer.Option("--to", metavar="PORT", help="... to here, and back; default once around the loop.")
    ] = None,
    scheme: Annotated[str | None, typer.Option(metavar="NAME", help="Integration scheme, such as cenic.")] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Also remarks and the feedthrough table.")] = False,
) -> None:
    """Examine a diagram: wiring, direct feedthrough, algebraic loops, sample periods and delays.

    Example: forcectl check fig_2_7 --from station.measured_force --to station/plant.joint_position_command
    """
    from forcectl.doctor import examine, render
    from forcectl.runs.target import named_assumptions, named_diagram

    _, diagram = named_diagram(scenario, variant, settings, fidelity)
    report = examine(diagram, sensor=source, command=target, scheme=scheme)
    render(report, _console(), verbose=verbose)
    say_assumed(named_assumptions(scenario, variant, settings, fidelity))
    if not report.ok:
        raise typer.Exit(1)


@app.command()
def reproduce(
    experiments: Annotated[list[str] | None, typer.Argument(metavar="[ID]...", help="Experiments to run.")] = None,
    all_: Annotated[bool, typer.Option("--all", help="Every shipped experiment.")] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory to write; default runs/reproduce-<n>.")
    ] = None,
    check_: Annotated[bool, typer.Option("--check", help="Exit with 1 on a miss or a drifted value.")] = False,
    fidelity: Fidelity = None,
    workers: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Processes; default one per processor.")
    ] = None,
    force: Force = False,
) -> None:
    """Run experiments of the thesis in parallel and compare with its numbers.

    Example: forcectl reproduce fig_2_7 fig_2_8 --check
    """
    from forcectl.runs.directory import free_name
    from forcectl.runs.progress import ProgressBars
    from forcectl.runs.reproduce import reproduce as compare
    from forcectl.runs.tables import verdict_table
    from forcectl.scenario.catalog import list_experiments

    if bool(experiments) == all_:
        raise BadInputError(f"reproduce: must have either names or --all, known: {', '.join(list_experiments())}")
    names = list_experiments() if all_ else list(dict.fromkeys(experiments or []))
    directory = out or free_name(Path("runs"), "reproduce")
    with ProgressBars() as progress:
        report = compare(names, out=directory, fidelity=fidelity, workers=workers, force=force, progress=progress.show)
    console = _console()
    for part in report.parts:
        console.print(verdict_table(part.verdicts, f"{part.experiment}: {part.title} [{part.fidelity}]"))
        console.print()
    missed = sum(v.passed is False for part in report.parts for v in part.verdicts)
    judged = sum(v.passed is not None for part in report.parts for v in part.verdicts)
    drifted = sum(v.drifted is True for part in report.parts for v in part.verdicts)
    typer.echo(
        f"{judged - missed} of {judged} targets met, drifted: {drifted}; results in {directory}: summary.json and "
        "one run per folder"
    )
    if check_ and not report.passed:
        raise typer.Exit(1)


for command in (robot, sweep, merge):
    app.command()(command)


@tuning.command()
def vrft(
    data: Annotated[str, typer.Argument(metavar="DATA", help="CSV with units in its header, or log.nc of a run.")],
    reference_model: Annotated[
        str,
        typer.Option(
            metavar="M",
            help="Bandwidth [rad/s], or a mapping: {bandwidth: 3, order: 2, delay: 40}, {poles: [-3, -5]} [rad/s], "
            "{numerator: [9], denominator: [1, 6, 9]} in s, with discrete: true in z.",
        ),
    ],
    form: Annotated[
        str, typer.Option(metavar="continuous|discrete|fir:N", help="PID (4.3.3), PID (4.20), N FIR coefficients.")
    ] = "continuous",
    prefilter: Annotated[bool, typer.Option(help="Filter with L = M (1 - M); without, noise biases strongly.")] = True,
    refine: Annotated[bool, typer.Option(help="Better gains where a plant model of DATA is good enough.")] = True,
    second: Annotated[
        str | None, typer.Option(metavar="FILE", help="The same experiment once more, as instrument against noise.")
    ] = None,
    input_: Annotated[str | None, typer.Option("--input", metavar="NAME", help="Column of the displacement.")] = None,
    output: Annotated[str | None, typer.Option("--output", metavar="NAME", help="Column of the force.")] = None,
    variant: Annotated[str | None, typer.Option(metavar="V", help="Variant of a log with several.")] = None,
    flip_input: Annotated[
        bool, typer.Option("--flip-input", help="The file counts displacements into the surface as positive.")
    ] = False,
    compensated: Annotated[
        bool | None,
        typer.Option(
            "--compensated/--uncompensated",
            help="Whether dx = u - C_R F was commanded (4.12); default yes, but no for displacement_command.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory to write; default tuned/<name>-<n>.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the earlier result in --out.")] = False,
) -> None:
    """Tune a PID or FIR force controller by virtual reference feedback tuning (VRFT) of an open-loop experiment.

    DATA has a column each of time, displacement and force, in any order, with units: time [s], displacement [mm],
    force [N]. Pressing is a negative displacement and a positive force.

    Example: forcectl tune vrft record.csv --reference-model 1.5 --out tuned
    """
    from forcectl.runs.directory import free_name
    from forcectl.runs.tune import CONTROLLER, tune_vrft
    from forcectl.runs.tuning_report import gains_table, report_lines

    directory = out or free_name(Path("tuned"), Path(data).stem)
    tuned = tune_vrft(
        data,
        reference_model,
        form=form,
        prefilter=prefilter,
        refine=refine,
        second=second,
        input_column=input_,
        output_column=output,
        variant=variant,
        flip_input=flip_input,
        compensated=compensated,
        out=directory,
        force=force,
    )
    console = _console()
    console.print(gains_table(tuned.fit))
    console.print()
    typer.echo("\n".join([*report_lines(tuned.fit, tuned.record), *(f"warning: {text}" for text in tuned.warnings)]))
    typer.echo(f"results in {directory}: {CONTROLLER}, summary.json, figures/")
    typer.echo(f"next: forcectl run {directory / CONTROLLER}")


def _console() -> Console:
    from rich.console import Console

    return Console()


# Typer carries its own copy of Click in newer versions, so the base of its complaints is found by name.
_Complaint: type[Exception] = next(base for base in typer.BadParameter.__mro__ if base.__name__ == "ClickException")


def main() -> None:
    """Entry point: every error a user is expected to meet is one line on standard error."""
    # NumPy's remarks on overflow would come before the one line that says which signal diverges, and when.
    warnings.simplefilter("ignore", RuntimeWarning)
    try:
        code = app(standalone_mode=False)
    except ForcectlError as error:
        code = _complain(str(error), 2 if isinstance(error, BadInputError) else 1)
    except _Complaint as error:
        context = getattr(error, "ctx", None)
        see = f" (see {context.command_path} --help)" if context else ""
        text = getattr(error, "format_message", error.__str__)()
        code = _complain(f"{text.rstrip('.')}{see}", 2)
    except typer.Abort:
        code = _complain("stopped", 1)
    except BrokenPipeError:  # the reader, for example `head`, has seen enough
        sys.stderr.close()
        code = 1
    sys.exit(code or 0)


def _complain(text: str, code: int) -> int:
    print(f"error: {' '.join(text.split())}", file=sys.stderr)
    return code


if __name__ == "__main__":
    main()
