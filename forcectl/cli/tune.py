"""The command `forcectl tune vrft`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from forcectl.cli.options import AsJson, Quiet, echo_json, terminal
from forcectl.interrupts import set_interrupt_message


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
        str,
        typer.Option(
            metavar="continuous|discrete|fir:N",
            help="PID (4.3.3), PID (4.20), both with :pi without K_D, or N FIR coefficients.",
        ),
    ] = "continuous",
    prefilter: Annotated[bool, typer.Option(help="Filter with L = M (1 - M); else noise biases the gains.")] = True,
    refine: Annotated[
        bool, typer.Option(help="Improve the gains on a plant model, where it fits DATA well enough.")
    ] = True,
    second: Annotated[
        str | None, typer.Option(metavar="FILE", help="Record of a repetition, as instrumental variable against noise.")
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
    learn_from: Annotated[
        str,
        typer.Option(
            metavar="command|motor",
            help="Input signal of VRFT: the command, or motor positions, which friction does not disturb.",
        ),
    ] = "command",
    robot_compliance: Annotated[
        float | None,
        typer.Option(metavar="C_R", help="Compliance fed back in DATA [m/N], if u_hat or dx_bar is missing there."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory to write; default tuned/<name>-<n>.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the earlier result in --out.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Tune a PID or FIR force controller by virtual reference feedback tuning (VRFT) of an open-loop experiment.

    DATA has a column each of time, displacement and force, in any order, with units: time [s], displacement [mm],
    force [N]. Pressing is a negative displacement and a positive force.

    Example: forcectl tune vrft record.csv --reference-model 1.5 --out tuned
    """
    from forcectl.runs.claims.claim import Numbered
    from forcectl.runs.tune import CONTROLLER, tune_vrft
    from forcectl.runs.tuning_report import gains_table, inputs_lines, report_lines

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
        learn_from=learn_from,
        robot_compliance=robot_compliance,
        out=out or Numbered(Path("tuned"), Path(data).stem),
        force=force,
    )
    directory = Path(tuned.directory or ".")
    set_interrupt_message(f"interrupted: the results are in {directory}")
    if as_json:
        echo_json({"directory": str(directory), **tuned.summary()})
        return
    if quiet:
        return
    console = terminal()
    console.print(gains_table(tuned.fit))
    console.print()
    both = inputs_lines(tuned.by_input, tuned.stick)
    typer.echo(
        "\n".join([*report_lines(tuned.fit, tuned.record), *both, *(f"warning: {text}" for text in tuned.warnings)])
    )
    typer.echo(f"results in {directory}: {CONTROLLER}, summary.json, figures/")
    typer.echo(f"next: forcectl run {directory / CONTROLLER}")
