"""Stories: commands in the order in which a reader gives them, each with what its output must show."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from tests.docs.commands.checks import (
    Check,
    draws,
    first_is,
    gains_fit_the_record,
    has_trials,
    has_variants,
    is_the_page,
    merged_is_whole,
    schema_has_slots,
    the_page_reads_the_table,
    write_parts,
    write_public_arm,
    write_record,
    write_small_sweep,
)


@dataclass(frozen=True)
class Step:
    """One command.

    Attributes:
        command: as printed.
        shows: words of its output; white space does not count.
        also: words that are added to shorten it.
        reason: why it is shortened.
        code: its exit code.
        says: of standard error; None: whatever is there.
        check: what else must hold of its folder and its output.
        equal: variants that are the same run by design; all others must differ in their metrics.
    """

    command: str
    shows: tuple[str, ...]
    also: str = ""
    reason: str = ""
    code: int = 0
    says: str | None = None
    check: Check | None = None
    equal: tuple[str, ...] = ()


@dataclass(frozen=True)
class Story:
    """Commands in one folder.

    Attributes:
        page: whose files are written first.
        steps: the commands.
        files: further files that the commands need, by name; or what writes them.
        short: of the shipped sweeps that are shortened, the reason; see `shortened`.
        pictures: whether figures and block diagrams are drawn.
        logs: whether logs are written, which takes as long as a short simulation.
    """

    steps: tuple[Step, ...]
    page: str = ""
    files: dict[str, str] = field(default_factory=dict)
    short: str = ""
    pictures: bool = False
    logs: bool = False
    prepare: Callable[[Path], object] | None = None


LONG = "minutes of simulated time on bodies"
SOON = "--set duration=0.1"  # of what is LONG
LIGHT = ("--fidelity OneDimensional", "on bodies it takes half a minute")
LONG_SWEEP = "a trial takes up to a minute"
RUN = "log.nc, metrics.json, figures/, diagram.html"
MY_DIAGRAM = """
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, ZeroOrderHold


def {name}():
    builder = DiagramBuilder()
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.002, 1))
    gain = builder.AddNamedSystem("amplifier", Gain(2.0, 1))
    builder.Connect(hold.get_output_port(), gain.get_input_port())
    builder.ExportInput(hold.get_input_port(), "value")
    builder.ExportOutput(gain.get_output_port(), "amplified")
    return builder.Build()
"""
OWN = """station: {fidelity: OneDimensional}
variants:
  fast: {controller.integral_gain: -3.0}
"""


def shortened(command: str, *shows: str, count: int = 1, shard: str = "", check: Check | None = None) -> Step:
    """A sweep of long trials, of which one point is run, see `short_sweep`; of many cases a shard."""
    also = f"--no-report --shard {shard}" if shard else "--no-report"
    return Step(command, (f"{count} done", "trials.parquet", *shows), also, LONG_SWEEP, check=check)


def soon(command: str, *shows: str, variant: str = "", check: Check | None = None) -> Step:
    """A long run, of which the beginning is simulated, of a variant where some set the duration themselves."""
    return Step(command, shows, f"{SOON} --variant '{variant}'" if variant else SOON, LONG, check=check)


STORIES = {
    "what there is": Story((
        Step("forcectl --help", ("Commands:", "reproduce", "sweep", "tune")),
        Step("forcectl --version", ("forcectl 0.",)),
        Step("forcectl list", ("Experiments", "fig_2_7", "Slots of a scenario", "!Integral")),
        Step("forcectl list controllers", ("!Integral", "!Vrft", "!Admittance")),
        Step("forcectl list scenario", ("Keys of a scenario", "scenario: station", "posture_deg", "settled_share")),
        Step("forcectl list '!Integral'", ("fills the slot controller", "integral_gain", "1/s")),
        Step("forcectl list '!Part'", ("fills the slot", "misplaced")),
        Step("forcectl explain overshoot_pct", ("overshoot_pct", "%", "force")),
        Step("forcectl explain true_overshoot_pct", ("true_overshoot_pct", "%", "true force")),
        Step("forcectl explain > docs/metrics.md", (), check=is_the_page("docs/metrics.md")),
        Step("forcectl schema --out scenario.schema.json", ("wrote scenario.schema.json",), check=schema_has_slots),
        Step("forcectl robot comau_smart_six", ("comau_smart_six: complete",)),
        Step("forcectl robot yumi", ("right_link_6", "kg in all", "yumi: complete")),
    )),
    "diagrams": Story((
        Step("forcectl check fig_2_7", ("station/drive", "Dead time once around the loop:", "0 error, 0 warning")),
        Step("forcectl check fig_2_7 --set controller.integral_gain=12",
             ("!Integral on 5900 N/m (environment): stable, and up to 7902 N/m; margins: gain 1.27",)),
        Step("forcectl check fig_2_7 --from station.measured_force --to station.joint_position_command",
             ("station.joint_position_command -> station.measured_force", "total", "Dead time once around the loop:")),
        Step("forcectl graph fig_2_7", ("fig_2_7.svg",), check=draws("fig_2_7.svg", "controller", "station")),
        Step("forcectl graph fig_2_7 --depth 2", ("fig_2_7.svg",), check=draws("fig_2_7.svg", "force_law", "guard")),
        Step("forcectl graph fig_2_7 --format pdf --depth 2 --out loop.pdf", ("loop.pdf",),
             check=draws("loop.pdf", "%PDF")),
        Step("forcectl graph fig_2_7 --format html --out loop.html", ("loop.html",),
             check=draws("loop.html", "controller", "station", "force_sensor")),
        Step("forcectl graph fig_2_7 --format html --depth 2 --out loop.html", ("loop.html",),
             check=draws("loop.html", "controller", "station", "force_sensor")),
        Step("forcectl check my_package.cell:make_diagram", ("hold", "0.002", "0 error")),
        Step("forcectl graph my_lab:diagram", ("diagram.svg",), check=draws("diagram.svg", "amplifier")),
        Step("forcectl check force_estimation", ("station/", "Sample periods", "0 error, 0 warning")),
        Step("forcectl graph peg_in_hole --machine --out peg.svg", ("peg.svg",), check=draws("peg.svg", "settle")),
        Step("forcectl graph cap_rotation --machine --out cap.svg", ("cap.svg",), check=draws("cap.svg", "rotation")),
        Step("forcectl graph pipette --machine --out pipette.svg", ("pipette.svg",),
             check=draws("pipette.svg", "take_plunger")),
    ), files={
        "my_package/__init__.py": "",
        "my_package/cell.py": MY_DIAGRAM.format(name="make_diagram"),
        "my_lab.py": MY_DIAGRAM.format(name="diagram"),
    }),
    "first run": Story((
        Step("forcectl run fig_2_7", ("K_I = 1.5 1/s", "K_I = 4.5 1/s", "overshoot", "limit cycle",
                                      f"results in runs/fig_2_7-1: {RUN}")),
        Step("forcectl list runs", ("runs/fig_2_7-1", "done")),
    ), logs=True),
    "run and show": Story((
        Step("forcectl run fig_2_7 --set station.environment.stiffness=2e4 --seed 3",
             ("overshoot", "with --set none fails the run", f"results in runs/fig_2_7-1: {RUN}"), *LIGHT),
        Step("forcectl show runs/fig_2_7-1 --all",
             ("fig_2_7: Step response of the integral force controller", "contact_loss_s", "seed 3")),
    ), logs=True),
    "readme, run": Story((
        Step('forcectl run fig_2_7 --variant "K_I = 3 1/s" --set station.environment.stiffness=2e4 --seed 3',
             ("overshoot", f"results in runs/fig_2_7-1: {RUN}"),
             check=draws("runs/fig_2_7-1/figures/force.png")),
        Step("forcectl run fig_2_8 --fidelity Kinematic --out runs/kinematic",
             ("pass", f"results in runs/kinematic: {RUN}")),
        Step("forcectl run my_scenario.yaml", ("overshoot", f"results in runs/my_scenario-1: {RUN}")),
        Step("forcectl run my_workcell.yaml", (f"results in runs/my_workcell-1: {RUN}",)),
    ), page="README.md", pictures=True),
    "reproduce": Story((
        Step("forcectl reproduce fig_2_8 --fidelity OneDimensional",
             ("fig_2_8: Integral force controller", "targets met,")),
        Step("forcectl reproduce fig_2_7 fig_2_8 --check",
             ("6 of 6 fig_2_7: Step response of the integral force controller", "10 of 10 targets met, drifted: 0"),
             "--fidelity OneDimensional", "all fidelities take half a minute"),
    )),
    "reproduce all": Story((
        Step("forcectl reproduce --all", ("fig_2_8", "targets met,"), "--fidelity OneDimensional",
             "all experiments take half an hour: with one in their place"),
    ), short="experiments"),
    "reproduce force_estimation": Story((
        Step("forcectl reproduce force_estimation", ("force_estimation", "targets met"),
             f"{SOON} --variant 'static loads'", LONG),
    )),
    "readme, tune": Story((
        Step("forcectl run fig_4_5 --out experiment", (f"results in experiment: {RUN}",), *LIGHT),
        Step("forcectl tune vrft experiment/log.nc --reference-model 1.5 --out tuned",
             ("K_P", "K_I", "predicted with a plant model", "next: forcectl run tuned/controller.yaml")),
        Step("forcectl run tuned/controller.yaml",
             ("overshoot", "steady_state_error_N", "results in runs/controller-1"), *LIGHT),
    ), logs=True),
    "tune": Story((
        Step("forcectl tune vrft record.csv --reference-model 1.5 --out tuned",
             ("predicted with a plant model from the same record", "next: forcectl run tuned/controller.yaml"),
             check=gains_fit_the_record),
        Step("forcectl tune vrft record.csv --reference-model 1.5",
             ("next: forcectl run tuned/record-1/controller.yaml",)),
    ), prepare=write_record),
    "sweep and merge": Story((
        Step("forcectl sweep robustness.yaml --out runs/robustness --workers 4", ("8 done", "report.html"),
             check=has_trials("runs/robustness", 8)),
        *(Step(f"forcectl sweep robustness.yaml --shard {i}/4 --out runs/part-{i} --no-report",
               ("2 done", f"results in runs/part-{i}")) for i in (2, 1, 4, 3)),
        Step("forcectl merge runs/part-1 runs/part-2 --out runs/whole", ("4 done", "4 pending", "--resume"), code=1),
        Step("forcectl merge runs/part-1 runs/part-2 runs/part-3 runs/part-4 --out runs/whole",
             ("8 done", "results in runs/whole: trials.parquet"), check=merged_is_whole),
        Step("forcectl sweep runs/whole --resume", ("8 done",), "--no-report", "figures take seconds",
             check=merged_is_whole),
    ), prepare=write_small_sweep),
    "arrays of jobs": Story((
        Step("forcectl sweep robustness.yaml --shard $SLURM_ARRAY_TASK_ID/20 --out runs/part-$SLURM_ARRAY_TASK_ID "
             "--workers 4", ("2 done",), "--no-report", "figures take seconds"),
        Step("forcectl sweep robustness.yaml --shard $((JOB_COMPLETION_INDEX + 1))/20 --out "
             "/data/part-$JOB_COMPLETION_INDEX", ("2 done",), "--no-report", "figures take seconds"),
    ), prepare=write_small_sweep),
    "faults": Story((
        Step('forcectl faults fig_2_7 --fidelity OneDimensional --only "nan,frozen,contact lost" --set duration=2',
             ("peak force [N]", "nan", "frozen", "contact lost", "named by")),
        Step("forcectl faults fig_2_7 --fidelity OneDimensional --set station.environment.stiffness=5e4 "
             "--set guard.maximum_force=30 --set duration=3", ("status 1: reading", "status 2: frozen"),
             "--only frozen,nan", "all faults take half a minute"),
    )),
    "public urdf": Story((
        Step("forcectl robot acme_support/urdf", ("acme_support/urdf: complete",)),
        Step("forcectl robot acme_support/urdf/arm.urdf", ("acme_support/urdf: complete",)),
        Step("forcectl run press.yaml", ("steady_state_error_N", "results in runs/press-1")),
        Step("forcectl run reach.yaml", ("reach_offset_mm", "results in runs/reach-1")),
    ), page="from_a_public_urdf.md", prepare=write_public_arm),
    "slots": Story((
        Step("forcectl run my_workcell.yaml", ("up to 7.4", "results in runs/my_workcell-1")),
    ), page="slots.md", prepare=write_parts),
    "blocks": Story((
        Step("forcectl check my_pressing:build", ("plant", "0 error, 0 warning")),
        Step("forcectl graph my_pressing:build --out pressing.svg", ("pressing.svg",),
             check=draws("pressing.svg", "MultibodyPlant", "ControllerGuard", "IntegralForceLaw")),
    ), page="blocks.md"),
    "refused": Story((
        Step("forcectl run my_admittance.yaml --set controller.damping=300 --set controller.inertia=3", (), code=2,
             says="shown"),
    ), page="admittance.md"),
    "refused in a variant": Story((
        Step("forcectl run own.yaml", (), code=2, says="shown"),
    ), page="index.md", files={"own.yaml": OWN}),
    "touch": Story((
        Step("forcectl check touch.yaml",
             ("task touch starts at x -0.0236 m, y 0.3853 m, z 0.206 m, phi 0 rad, theta 0 rad, psi 0 rad",
              "task rest starts at x 0.1046 m, y -0.2416 m, z 0.1241 m, phi 0 rad, theta 0 rad, psi 0 rad")),
        Step("forcectl run touch.yaml --out runs/touch --replay",
             ("ended", f"results in runs/touch: {RUN}, replay.html"),
             check=draws("runs/touch/replay.html", "<html")),
        Step("forcectl run touch.yaml --out runs/touch", ("ended", "results in runs/touch"), "--force",
             "the same directory as before"),
        Step("forcectl graph touch.yaml --machine", ("touch_machine.svg",),
             check=draws("touch_machine.svg", "press")),
    ), page="task_machines.md"),
    "laws side by side": Story((
        Step("forcectl run baselines", ("overshoot", "settling", f"results in runs/baselines-1: {RUN}"),
             equal=("integral", "integral, passive"),  # the energy that is allowed is not reached
             check=has_variants("runs/baselines-1", "adaptive admittance", "VRFT, governed")),
    )),
    "alignment": Story((
        Step("forcectl run fig_6_5", ("alignment", "peg", f"results in runs/fig_6_5-1: {RUN}"),  # both generators rest
             equal=("velocity-based, consistent", "position-based, consistent")),
        Step("forcectl run hybrid_alignment", ("results in runs/hybrid_alignment-1",)),
        soon("forcectl run curved_surface", "results in runs/curved_surface-1", variant="normal from the force"),
    )),
    "joint interface": Story((
        soon('forcectl run force_estimation --variant "static loads" --out runs/forces --replay',
             "results in runs/forces", "replay.html"),
        soon('forcectl run fig_5_2 --variant "readings as they are" --set station.sensors.joints.quantum=1e-5',
             "with --set none fails the run", "results in runs/fig_5_2-1"),
        soon("forcectl run fig_5_2", "readings as they are", "results in runs/fig_5_2-2"),
        soon("forcectl run usable_forces", "force_error", "results in runs/usable_forces-1", variant="posture 2"),
    )),
    "reaching": Story((
        soon("forcectl run fig_5_3", "reach_offset_mm", "results in runs/fig_5_3-1", variant="links"),
        soon("forcectl run null_space", "reached", "results in runs/null_space-1"),
    )),
    "assembly": Story((
        soon('forcectl run peg_in_hole --variant "6 mm, 10 degrees" --out runs/peg --replay', "in the mode 'settle'",
             "results in runs/peg", "replay.html", check=draws("runs/peg/replay.html", "<html")),
        soon("forcectl run peg_in_hole", "in the mode 'settle'", "results in runs/peg_in_hole-1",
             variant="3 mm, 5 degrees"),
        soon("forcectl run fig_6_10 --out runs/fig_6_10", "without the lip", "results in runs/fig_6_10"),
        soon("forcectl run fig_6_17 --out runs/fig_6_17", "thesis, 1450 N/m", "results in runs/fig_6_17"),
        soon("forcectl run cap_rotation --out runs/cap --replay", "1450 N/m", "replay.html", variant="1450 N/m"),
        soon("forcectl run pipette --out runs/pipette --replay", "replay.html", "results in runs/pipette"),
        soon("forcectl run pipette", "results in runs/pipette-1"),
    )),
    "first sweep": Story((
        Step("forcectl sweep first_sweep --out runs/first", ("24 done", "report.html"),
             check=the_page_reads_the_table),
        *(Step(f"forcectl sweep runs/first --resume{more}", ("24 done",), "--no-report", "figures take seconds")
          for more in ("", " --retry failed")),
        Step("forcectl sweep runs/first --status", (), check=first_is("first_sweep: 24 trials: 24 done")),
    )),
    "shipped sweeps": Story((
        Step("forcectl sweep robustness --out runs/robustness --shard 1/20", ("done", "results in runs/robustness"),
             "--no-report", LONG_SWEEP),
        shortened("forcectl sweep assembly_table --out runs/table", shard="1/9",
                  check=has_trials("runs/table", 1)),
        shortened("forcectl sweep runs/table --resume"),
        shortened("forcectl sweep assembly_table --shard 6/9 --out runs/table-6",
                  check=has_trials("runs/table-6", 1)),
        shortened("forcectl sweep peg_limits", shard="1/15"),
        shortened("forcectl sweep cap_rotation_lock --out runs/lock"),
        shortened("forcectl sweep cap_rotation_lock", "results in runs/cap_rotation_lock-1"),
        shortened("forcectl sweep cap_rotation_no_lock --out runs/no_lock"),
        shortened("forcectl sweep cap_rotation_thesis"),
        shortened("forcectl sweep cap_rotation_grasp"),
        shortened("forcectl sweep table_6_1 --workers 1 --out runs/table_6_1"),
        shortened("forcectl sweep table_6_1", "results in runs/table_6_1-1"),
        shortened("forcectl sweep peg_misalignments"),
        shortened("forcectl sweep pipette --workers 2 --out runs/pipettes"),
        shortened("forcectl sweep pipette", "results in runs/pipette-1"),
        shortened("forcectl sweep plywood_directions"),
        shortened("forcectl sweep touch_down", shard="3/22"),
        shortened("forcectl sweep touch_down_speeds", shard="2/5"),
    ), short="sweeps"),
}  # fmt: skip

# What a test of its own runs, because it needs more than this machine: command -> test.
ELSEWHERE = {
    "forcectl sweep robustness.yaml --out runs/robustness --scheduler tcp://scheduler:8786": (
        "tests/sweeps/test_dask_engine.py",
        "test_workers_of_a_scheduler_give_the_same_table",
    ),
}
