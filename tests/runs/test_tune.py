"""`forcectl tune vrft` from outside: a run is exported, tuned on, and the controller it writes is run."""

import json

import numpy as np
import pytest
from scipy.signal import lfilter

from forcectl.errors import BadInputError
from forcectl.runs.logs import read_netcdf
from forcectl.runs.run import run
from forcectl.runs.tune import reference_model_config, tune_vrft
from forcectl.runs.tuning_report import inputs_lines, summary
from forcectl.scenario.scenario import load_scenario
from forcectl.tuning.controller_basis import continuous_pid
from forcectl.tuning.reference_model import first_order
from forcectl.tuning.vrft import fit_vrft
from tests.examples.vrft_records import TS, contact, trapezoidal_moves
from tests.runs.records.test_recorded import good, write
from tests.tuning.test_motor_positions import C_R, MOVES, record

pytestmark = [pytest.mark.usefixtures("plants_identified_once"), pytest.mark.slow]


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    """The directory of a run of the open-loop experiment of Fig. 4.5."""
    directory = tmp_path_factory.mktemp("runs") / "experiment"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("forcectl.runs.run._write_pictures", lambda *_: None)
        run("fig_4_5", overrides={"expect": []}, fidelity="OneDimensional", out=directory)
    return directory


def test_help_has_an_example(forcectl):
    for arguments in (("tune", "--help"), ("tune", "vrft", "--help")):
        code, out, _ = forcectl(*arguments)
        assert code == 0
        assert "forcectl tune vrft record.csv --reference-model 1.5" in " ".join(out.split())


def test_log_of_a_run_gives_a_controller_that_runs_as_predicted(forcectl, experiment, tmp_path, request):
    code, out, err = forcectl("tune", "vrft", experiment / "log.nc", "--reference-model", 1.5, "--out", "tuned")
    assert (code, err) == (0, "")
    for part in ("K_P", "K_I", "K_D", "standard error", "R^2", "predicted with a plant model", "results in tuned"):
        assert part in out
    names = {str(path.relative_to(tmp_path / "tuned")) for path in (tmp_path / "tuned").rglob("*") if path.is_file()}
    assert names == {"controller.yaml", "summary.json"} | {
        f"figures/{stem}.{kind}" for stem in ("experiment", "prediction") for kind in ("svg", "png")
    }
    report = json.loads((tmp_path / "tuned" / "summary.json").read_text())
    continuous = report["controller"]["continuous"]
    assert continuous["K_I"] == pytest.approx(-1.5 / 5.9e3, rel=0.02)
    assert continuous["K_P"] == pytest.approx(-5.40e-5, rel=0.08)
    assert report["prediction"]["plant_static_gain_N_m"] == pytest.approx(-5.9e3, rel=0.01)

    request.getfixturevalue("without_pictures")  # the figures of the tuning were looked at above
    assert forcectl("run", "tuned/controller.yaml", "--fidelity", "OneDimensional", "--out", "run")[0] == 0
    log = read_netcdf(tmp_path / "run" / "log.nc")
    step = float(log["desired_force"][-1])
    difference = (log["measured_force"] - log["model_force"]).values
    missed = np.linalg.norm(difference) / np.linalg.norm(step - log["model_force"].values)
    # Friction and contact make the real loop differ from the linear prediction by a few percent.
    assert missed == pytest.approx(report["prediction"]["model_mismatch"], abs=0.05)


def test_the_controller_fits_into_another_scenario(forcectl, experiment, tmp_path, without_pictures):
    tuned = tune_vrft(experiment / "log.nc", 1.5, out=tmp_path / "tuned")
    scenario = load_scenario(tmp_path / "tuned" / "controller.yaml")
    assert scenario.controller.proportional_gain == tuned.fit.pid.proportional
    assert scenario.controller.derivative_filter == 2 * TS
    assert scenario.controller.robot_compliance_error == 1.0
    assert scenario.reference_model == 1.5
    again = load_scenario("fig_2_8", overrides={"controller": scenario.controller})
    assert again.controller.integral_gain == tuned.fit.pid.integral


def exported(experiment, path, missing=()):
    """The log as a CSV file with shuffled columns and other units."""
    log = read_netcdf(experiment / "log.nc")
    columns = {
        "Contact Force [N]": log["contact_force"].values,
        "Measured Force [mN]": 1e3 * log["measured_force"].values,
        "mode": log["mode"].values,
        "u_hat [um]": 1e6 * log["controller_output"].values,
        "Time [ms]": 1e3 * log["time"].values,
    }
    return write(path, {name: np.delete(values, list(missing)) for name, values in columns.items()}, "exported.csv")


def test_exported_csv_with_shuffled_columns_and_other_units_gives_the_same_gains(
    forcectl, experiment, tmp_path, without_pictures
):
    """Acceptance 5 of issue 4, as far as the record is complete."""
    path = exported(experiment, tmp_path)
    code, _, err = forcectl(
        "tune", "vrft", path, "--reference-model", "{bandwidth: 1.5}", "--output", "measured force", "--out", "csv"
    )
    assert (code, err) == (0, "")
    from_csv = json.loads((tmp_path / "csv" / "summary.json").read_text())
    from_log = tune_vrft(experiment / "log.nc", 1.5)
    for name, gain in zip(("K_P", "K_I", "K_D"), from_log.fit.gains, strict=True):
        assert from_csv["controller"]["gains"][name]["value"] == pytest.approx(gain, rel=1e-6)


def test_exported_csv_with_missing_rows_is_refused_by_row(forcectl, experiment, tmp_path):
    """Acceptance 5 of issue 4, with rows taken out: row 1 is the header."""
    path = exported(experiment, tmp_path, missing=(1000, 1001))
    code, out, err = forcectl("tune", "vrft", path, "--reference-model", 1.5)
    assert (code, out) == (2, "")
    assert err.startswith("error: exported.csv row 1002: 2 rows are missing before it")
    assert err.count("\n") == 1
    assert "record without gaps, or cut the record there" in err
    assert not (tmp_path / "tuned").exists()


def record_file(folder, name="record.csv", noise=0.0, seed=0, sign=1.0, delay=3, rows=None):
    u = trapezoidal_moves()
    y = lfilter(*contact(5.9e3, (75.4, 75.4, 12.6, 12.6), delay), u)
    y = y + noise * np.random.default_rng(seed).normal(size=u.size)
    columns = {"force [N]": y, "displacement [mm]": 1e3 * sign * u, "time [s]": TS * np.arange(u.size)}
    return write(folder, {key: values[:rows] for key, values in columns.items()}, name)


def test_json_is_the_summary_and_quiet_says_nothing(forcectl, tmp_path, without_pictures):
    record_file(tmp_path)
    given = ("tune", "vrft", "record.csv", "--reference-model", "1.5", "--no-refine", "--out", "tuned", "--force")
    code, out, err = forcectl(*given, "--json")
    assert (code, err) == (0, "")
    written = json.loads((tmp_path / "tuned" / "summary.json").read_text(encoding="utf-8"))
    assert json.loads(out) == {"directory": "tuned", **written}
    assert forcectl(*given, "--quiet") == (0, "", "")


@pytest.mark.parametrize("refine", [False, True])
def test_gains_are_those_of_the_fit_on_the_same_data(tmp_path, refine):
    u = trapezoidal_moves()
    y = lfilter(*contact(5.9e3, (75.4, 75.4, 12.6, 12.6), 3), u)
    tuned = tune_vrft(record_file(tmp_path), 1.5, refine=refine)
    expected = fit_vrft(u, y, first_order(1.5, TS), continuous_pid(TS), refine=refine)
    np.testing.assert_allclose(tuned.fit.gains, expected.gains, rtol=1e-6)


@pytest.mark.parametrize(
    ("form", "keys"),
    [
        ("continuous", {"K_P", "K_I", "K_D"}),
        ("discrete", {"K_P", "K_I", "K_D"}),
        ("fir:8", {f"theta_{i}" for i in range(8)}),
    ],
)
def test_every_form_gives_a_scenario_that_can_be_read(tmp_path, form, keys):
    tuned = tune_vrft(record_file(tmp_path), 1.5, form=form)
    assert set(summary(tuned.fit, tuned.record, ())["controller"]["gains"]) == keys
    controller = load_scenario(tuned.scenario).controller
    assert len(controller.fir) == (8 if form == "fir:8" else 0)
    if tuned.fit.pid is not None:
        assert controller.integral_gain == pytest.approx(-1.5 / 5.9e3, rel=0.01)


def test_a_second_experiment_is_used_as_instrument(tmp_path):
    first, second = (record_file(tmp_path, f"{seed}.csv", 0.05, seed) for seed in (1, 2))
    tuned = tune_vrft(first, 1.5, second=second)
    assert tuned.fit.instrumented
    short = record_file(tmp_path, "short.csv", rows=9000)
    with pytest.raises(BadInputError, match="must have"):
        tune_vrft(first, 1.5, second=short)
    with pytest.raises(BadInputError, match=r"1.csv is the record of .*1.csv again: repeat the experiment"):
        tune_vrft(first, 1.5, second=first)


def test_a_contact_that_no_surface_has_is_refused(tmp_path):
    columns = good()
    tiny = write(tmp_path, columns | {"displacement [m]": 1e-9 * columns["displacement [m]"]}, "tiny.csv")
    with pytest.raises(BadInputError, match=r"tiny.csv: column displacement \[m\] moves by 4e-12 m in all"):
        tune_vrft(tiny, 1.5, refine=False)


@pytest.mark.parametrize("column", ["displacement [m]", "force [N]"])
def test_a_second_record_of_another_experiment_is_refused(tmp_path, column):
    columns = good()
    other = write(tmp_path, columns | {column: 2 * columns[column]}, "other.csv")
    with pytest.raises(BadInputError, match=r"other.csv: column .* differs from that of data.csv by 100 %"):
        tune_vrft(write(tmp_path, columns), 1.5, second=other)


def test_where_friction_misleads_the_plant_model_the_rests_say_how_stiff_the_contact_is(tmp_path, without_pictures):
    """The moves of Fig. 4.10, where the drive sticks: no linear model predicts the loop, but the record shows it."""
    run("fig_4_8", variant="plastic", overrides={"expect": []}, fidelity="OneDimensional", out=tmp_path / "run")
    tuned = tune_vrft(tmp_path / "run" / "log.nc", 1.5)
    assert tuned.stiffness == pytest.approx(2.1e5, rel=0.06)
    assert not tuned.fit.trusted
    assert any("the prediction is not to be trusted" in line for line in tuned.warnings)
    assert tuned.fit.vrft_gains is None
    log = run(tuned.scenario, overrides={"duration": 6.0}, fidelity="OneDimensional").log
    difference = (log["measured_force"] - log["model_force"]).values
    missed = np.linalg.norm(difference) / np.linalg.norm((log["desired_force"] - log["model_force"]).values)
    assert missed == pytest.approx(tuned.fit.record_mismatch, rel=0.2)


def test_a_record_that_does_not_tell_the_stiffness_is_refused(tmp_path):
    """One move, after which the force creeps back towards the other side."""
    columns = good()
    u = columns["displacement [m]"]
    columns["force [N]"] = -5e3 * (u - 1.5 * lfilter([0.001], [1.0, -0.999], u))
    columns = {name: values[:680] for name, values in columns.items()}
    with pytest.raises(BadInputError, match="does not determine the stiffness of the contact") as caught:
        tune_vrft(write(tmp_path, columns), 1.5)
    assert "\n" not in str(caught.value)


def test_a_record_of_noise_alone_is_refused(forcectl, tmp_path):
    rng = np.random.default_rng(0)
    u, y = rng.normal(size=5000), np.abs(rng.normal(scale=5.0, size=5000))
    columns = {"time [s]": TS * np.arange(u.size), "displacement [mm]": u, "force [N]": y}
    code, out, err = forcectl("tune", "vrft", write(tmp_path, columns), "--reference-model", 1.5)
    assert (code, out) == (2, "")
    assert "a model of the contact explains nothing of force [N]: must be a force that follows displacement" in err
    assert err.count("\n") == 1


def test_noise_is_reported_with_what_it_takes(forcectl, tmp_path, without_pictures):
    code, out, _ = forcectl("tune", "vrft", record_file(tmp_path, noise=0.05), "--reference-model", 1.5)
    assert code == 0
    assert "warning: K_D is not identifiable" in out
    assert "noise 0.05 N rms" in out
    assert "results in tuned/record-1" in out
    assert forcectl("tune", "vrft", "record.csv", "--reference-model", 1.5)[1].count("results in tuned/record-2") == 1


@pytest.mark.parametrize("kind", ["continuous", "discrete"])
def test_a_pi_controller_has_no_derivative_gain_and_says_nothing_of_one(forcectl, tmp_path, without_pictures, kind):
    path = record_file(tmp_path, noise=0.05)
    code, out, _ = forcectl("tune", "vrft", path, "--reference-model", 1.5, "--form", f"{kind}:pi", "--out", "pi")
    assert code == 0
    assert "K_D m" not in out
    assert "K_D is" not in out
    controller = load_scenario(tmp_path / "pi" / "controller.yaml").controller
    assert controller.derivative_gain == 0.0
    whole = tune_vrft(path, 1.5, form=kind, refine=False).fit.pid
    assert controller.proportional_gain == pytest.approx(whole.proportional, rel=0.02)
    assert controller.integral_gain == pytest.approx(whole.integral, rel=0.01)


def test_a_model_out_of_reach_is_called_so_and_a_loop_that_would_diverge_is_drawn(forcectl, tmp_path):
    path = record_file(tmp_path, delay=60)
    code, out, _ = forcectl("tune", "vrft", path, "--reference-model", 60, "--out", "hasty")
    assert code == 0
    assert "warning: reference model out of reach" in out
    assert json.loads((tmp_path / "hasty" / "summary.json").read_text())["prediction"]["out_of_reach"]
    assert (tmp_path / "hasty" / "figures" / "prediction.png").stat().st_size > 5000


def test_data_without_compensation_run_without_it(tmp_path):
    renamed = {name.replace("displacement", "displacement_command"): values for name, values in good().items()}
    tuned = tune_vrft(write(tmp_path, renamed), 1.5)
    assert not tuned.compensated
    scenario = load_scenario(tuned.scenario)
    assert scenario.controller.robot_compliance_error == 0.0
    assert not scenario.station.elastic_joints
    assert tune_vrft(write(tmp_path, renamed), 1.5, compensated=True).compensated


def test_displacements_of_the_other_sign_are_refused_or_turned(tmp_path):
    path = record_file(tmp_path, sign=-1.0)
    with pytest.raises(BadInputError, match=r"force \[N\] rises with displacement \[mm\].*--flip-input"):
        tune_vrft(path, 1.5, out=tmp_path / "tuned")
    assert not (tmp_path / "tuned").exists()
    assert (tune_vrft(path, 1.5, flip_input=True).fit.gains[:2] < 0).all()


def test_a_result_is_replaced_only_on_request(tmp_path, without_pictures):
    path = record_file(tmp_path)
    tune_vrft(path, 1.5, out=tmp_path / "tuned")
    with pytest.raises(BadInputError, match="--force"):
        tune_vrft(path, 3.0, out=tmp_path / "tuned")
    assert load_scenario(tmp_path / "tuned" / "controller.yaml").reference_model == 1.5
    tune_vrft(path, 3.0, out=tmp_path / "tuned", force=True)
    assert load_scenario(tmp_path / "tuned" / "controller.yaml").reference_model == 3.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fast", "must be a bandwidth"),
        ("[1, 2]", "must be a bandwidth"),
        ("{bandwith: 2}", "did you mean 'bandwidth'"),
        ("!Fast {bandwidth: 2}", "must be a bandwidth"),
        ("{poles: [-2], order: 3}", "--reference-model: order = 3: must be left out without a bandwidth"),
        ("{bandwidth: -2}", "positive"),
        ("-2", "positive"),
        ("{numerator: [1, 1], denominator: [1, 2]}", "strictly proper"),
        ("{numerator: [1, 0, 0], denominator: [1, -0.9], discrete: true}", "not causal"),
        ("{numerator: [900], denominator: [1, 6, 9]}", "reference model ends at 100 of the reference: must end at 1"),
        ("{poles: [2]}", "stable"),
        ("{}", "exactly one"),
        ("200", "sampled every 0.002 s: must be at most 0.000783 s"),
        ("0.05", "must last at least 40 s"),
        ("{bandwidth: 2, order: 40}", "must last at least 40"),
        ("{bandwidth: 2, order: 2000}", "order = 2000: must be a whole number from 1 to 100"),
    ],
)
def test_reference_models_that_cannot_be_used(forcectl, tmp_path, text, words):
    code, out, err = forcectl("tune", "vrft", record_file(tmp_path), "--reference-model", text)
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--form", "pid"), "form = 'pid': must be continuous, discrete, continuous:pi, discrete:pi or fir:N"),
        (("--form", "continuous:pd"), "form = 'continuous:pd': must be"),
        (("--form", "discrete:"), "form = 'discrete:': must be"),
        (("--form", "fir:0"), "fir:N"),
        (("--input", "way"), "unknown column of displacement 'way'"),
        (("--variant", "a"), "--variant"),
        (("--second", "none.csv"), "does not exist"),
    ],
)
def test_arguments_that_cannot_be_used(forcectl, tmp_path, arguments, words):
    code, out, err = forcectl("tune", "vrft", record_file(tmp_path), "--reference-model", 1.5, *arguments)
    assert (code, out) == (2, "")
    assert words in err


def test_the_data_must_exist_and_the_model_be_given(forcectl):
    assert "does not exist" in forcectl("tune", "vrft", "none.csv", "--reference-model", 1.5)[2]
    code, _, err = forcectl("tune", "vrft", "none.csv")
    assert code == 2
    assert "--reference-model" in err


def test_models_of_higher_order_are_tuned_for(tmp_path):
    tuned = tune_vrft(record_file(tmp_path), "{poles: [-3, -6], delay: 5}")
    assert tuned.fit.model.delay == 6
    assert len(tuned.fit.model.poles) == 2
    assert tuned.bandwidth == pytest.approx(2.5, abs=0.2)
    assert reference_model_config(2.0).bandwidth == 2.0


def test_one_variant_of_a_log_with_several_is_picked(tmp_path, without_pictures):
    run("fig_2_7", overrides={"expect": [], "duration": 3.0}, fidelity="OneDimensional", out=tmp_path / "run")
    log = tmp_path / "run" / "log.nc"
    with pytest.raises(BadInputError, match=r"several variants.*K_I = 3 1/s"):
        tune_vrft(log, 1.5)
    with pytest.raises(BadInputError, match="unknown variant"):
        tune_vrft(log, 1.5, variant="K_I = 9")
    tuned = tune_vrft(log, 1.5, variant="K_I = 3 1/s")
    assert tuned.record.input_name.startswith("displacement_command")
    assert not tuned.compensated


def sticking_csv(tmp_path, **columns):
    """A record of drives that stick, with these columns beside time and force."""
    force, motor = record(2e-5)
    values = {"time [s]": TS * np.arange(MOVES.size), "force [N]": force}
    known = {"u_hat [m]": MOVES, "displacement_command [m]": MOVES - C_R * force, "motor_displacement [m]": motor}
    values |= {name: known[name] for name in known if columns.get(name.split()[0], True)}
    return write(tmp_path, values, name="sticking.csv")


def test_both_gains_are_reported_and_drives_that_stuck_are_told(tmp_path):
    on_command = tune_vrft(sticking_csv(tmp_path), 1.5, refine=False)
    on_motor = tune_vrft(sticking_csv(tmp_path), 1.5, refine=False, learn_from="motor")
    assert on_command.record.fed_back == pytest.approx(C_R, rel=1e-6)
    assert on_command.by_input == on_motor.by_input
    assert on_command.by_input["command"]["K_P"] == on_command.fit.gains[0]
    assert on_motor.by_input["motor"]["K_P"] == on_motor.fit.gains[0]
    for tuned in (on_command, on_motor):
        assert tuned.stick > 0.05
        assert any("stick-slip" in text for text in tuned.warnings)
    (line,) = inputs_lines(on_motor.by_input, on_motor.stick)
    assert line.startswith("VRFT on commands: K_P -")


def test_what_vrft_on_motor_positions_needs_is_said(tmp_path):
    with pytest.raises(BadInputError, match=r"no column of the motors' displacement: must have a column motor_disp"):
        tune_vrft(sticking_csv(tmp_path, motor_displacement=False), 1.5, learn_from="motor")
    file = sticking_csv(tmp_path, displacement_command=False)
    with pytest.raises(BadInputError, match="not both of u_hat and dx_bar"):
        tune_vrft(file, 1.5, learn_from="motor")
    for wrong in (-1e-6, 2.0, float("nan")):
        with pytest.raises(BadInputError, match=f"robot_compliance = {wrong}: must be from 0 to 1 m/N"):
            tune_vrft(file, 1.5, learn_from="motor", robot_compliance=wrong)
    with pytest.raises(BadInputError, match="no motor positions, which --robot-compliance needs: leave it out"):
        tune_vrft(sticking_csv(tmp_path, motor_displacement=False), 1.5, robot_compliance=C_R)
    file = sticking_csv(tmp_path, displacement_command=False)
    known = tune_vrft(file, 1.5, learn_from="motor", robot_compliance=C_R, refine=False)
    assert known.by_input["motor"]["K_P"] == pytest.approx(known.fit.gains[0])
    with pytest.raises(BadInputError, match="learn_from = 'motors': must be one of command, motor"):
        tune_vrft(file, 1.5, learn_from="motors")


def test_a_tuned_controller_shows_itself_in_one_line(tmp_path):
    tuned = tune_vrft(record_file(tmp_path), 1.5)
    shown = "K_P = {:.4g} m/N, K_I = {:.4g} m/(N s), K_D = {:.4g} m s/N".format(*tuned.fit.gains)
    assert repr(tuned).splitlines() == [f"<controller tuned on {tuned.record.origin!r}: {shown}>"]
