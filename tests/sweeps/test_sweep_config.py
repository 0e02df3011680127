import pytest

from forcectl.errors import BadInputError
from forcectl.sweeps.study import study_of
from forcectl.sweeps.sweep_config import list_sweeps, read_sweep
from tests.sweeps.small_sweeps import small


def told(tmp_path, text):
    file = tmp_path / "sweep.yaml"
    file.write_text(text)
    with pytest.raises(BadInputError) as error:
        study_of(read_sweep(file))
    assert "\n" not in str(error.value)
    return str(error.value)


START = 'scenario: fig_2_7\nvariant: "K_I = 1.5 1/s"\noverrides: {station.fidelity: OneDimensional}\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "sweep.yaml: must be a mapping with keys out of: title, description, scenario"),
        ("scenaro: fig_2_7", "sweep.yaml:1: scenaro: unknown key 'scenaro': did you mean 'scenario'?"),
        ("title: x", "scenario is missing: must be"),
        (START + "design: sobol", "sweep.yaml: trials is missing: the design sobol draws as many points"),
        (START + "design: sbol", "sweep.yaml:4: design: unknown design 'sbol': did you mean 'sobol'?"),
        (START + "trials: 5", "sweep.yaml:4: trials = 5: must be left out: a grid has"),
        (START + "design: random\ntrials: 3", "keys = {}: must be at least one key for the design random"),
        (START + "keys:\n  title: [a, b]", "sweep.yaml:5: keys.title cannot be varied: it does not affect the"),
        (START + "keys:\n  seed: [1, 2]", "sweep.yaml:5: keys.seed cannot be varied: use `seeds`"),
        (START + "seeds: 0", "sweep.yaml:4: seeds = 0: must be how many, or a list of different whole numbers"),
        (START + "seeds: [1, 1]", "sweep.yaml:4: seeds = [1, 1]: must be"),
        (START + "success: overshoot_pct <=", "sweep.yaml:4: success = 'overshoot_pct <=': must be an expression"),
        (START + "findings: {a: 'f(x)'}", "sweep.yaml:4: findings.a = 'f(x)': 'f(x)' cannot stand here"),
        (START + "repeat: {half_width: 0.1}", "success is missing: `repeat` needs a condition to count"),
        (
            START + "success: a > 1\nrepeat: {half_width: 2}",
            "sweep.yaml:5: repeat.half_width = 2.0: must be above 0 and at most 0.5",
        ),
        (
            START + "success: a > 1\nrepeat: {half_width: 0.01, at_most: 100}",
            "sweep.yaml:5: repeat.at_most = 100: must be at least 189: no interval of fewer trials has half_",
        ),
        (START + "success: overshoot_pct <= peak_force_N", "'overshoot_pct' in % and 'peak_force_N' in N: must be of"),
        (START + "findings: {a: peak_force_N - overshoot_N > rise_time_s}", "and 'rise_time_s' in s: must be of the"),
        (START + "success: max(peak_force_N, rise_time_s) < 3", "success = 'max(peak_force_N, rise_time_s) < 3': 'pea"),
        (
            START + "keys: {duration: [1], reference.force: [2]}\nconstraints: [duration < reference.force]",
            "sweep.yaml:5: constraints.0 = 'duration < reference.force': 'duration' in s and 'reference.force' in N: ",
        ),
        (START + "success: rise_time_s > 1000", "sweep.yaml:4: success = 'rise_time_s > 1000' is always false: must"),
        (START + "seeds: 3000000000", "sweep.yaml:4: seeds = 3000000000: must be at most 1000000"),
        (START + "success: '1 > 0'", "sweep.yaml:4: success = '1 > 0': must be a comparison of a name, such as"),
        (START + "success: peak_force_N == peak_force_N", "sweep.yaml:4: success = 'peak_force_N == peak_force_N' is"),
        (START + "success: peak_force_N < -1", "sweep.yaml:4: success = 'peak_force_N < -1' is always false: must dep"),
        (START + "findings: {a: inserted >= 0}", "sweep.yaml:4: findings.a = 'inserted >= 0' is always true: must"),
        (
            START + "share_over: {metric: peak_force_N, condition: peak_force_N > 1 and peg_stays > 1}",
            "sweep.yaml:4: share_over.condition = 'peak_force_N > 1 and peg_stays > 1': 'peg_stays > 1' is always fals",
        ),
        (START + "share_over: {metric: peak_force_N, condition: peek > 1}", "share_over.condition: unknown metric 'pe"),
        (START + "keys:\n  case: [1]\ncases: {a: {duration: 2}}", "sweep.yaml:5: keys.case cannot be varied: use `cas"),
        (START + "keys:\n  expect.0.metric: [a, b]", "sweep.yaml:5: keys.expect.0.metric cannot be varied: it does no"),
        (START + "keys: {fidelities: [[]]}", "sweep.yaml:4: keys.fidelities cannot be varied: it does not affect the"),
        (START + "keys: {station..period: [1]}", "sweep.yaml:4: keys = 'station..period': must be a scenario key, suc"),
        (START + "keys: {analyses.x.mode: [a, b]}", "sweep.yaml:4: analyses.x: must have a tag: one of !ForceEst"),
        ("scenario: fig_2_7\nvariant: x", "sweep.yaml:2: variant: unknown variant of fig_2_7.yaml 'x': known: K_I = 1"),
        (START + "success: overshoot_pct", "sweep.yaml:4: success = 'overshoot_pct': must be a comparison of a name"),
        (START + "success: a > 1 and b", "sweep.yaml:4: success = 'a > 1 and b': 'b': must be a comparison of a name"),
        (START + "findings: {a: ''}", "sweep.yaml:4: findings.a = '': must be an expression"),
        (START + "findings: {'': a > 1}", "sweep.yaml:4: findings: the name '' must be 1 to 200 printable characters"),
        (START + "arms: {'': {duration: 1}}", "sweep.yaml:4: arms: the name '' must be 1 to 200 printable characters"),
        (START + "arms:\n  a: {seed: 1}\n  b: {seed: 1}", "sweep.yaml:6: arms.b = {'seed': 1}: must be other values"),
        ('scenario: !Import {path: "os:system"}', "sweep.yaml:1: scenario = {'path': 'os:system'}: must be a name"),
        (START + "arms: {a: {}, A: {seed: 1}}", "sweep.yaml:4: arms: the name 'A' must differ from 'a' by more than"),
        (
            START + "arms: {a: {seed: 1, duration: 2}, b: {duration: 2, seed: 1}}",
            "arms.b = {'duration': 2, 'seed': 1}: must be other values than those of arms.a",
        ),
        (START + "arms: {a: {}, b: {}}\n", "sweep.yaml:4: arms.b = {}: must be other values than those of arms.a"),
        (START + "arms: {a: {}}\ncompare: [a, a]", "sweep.yaml:5: compare.1 = 'a': must be another one than those"),
        (START + "arms: {a: {}}\ncompare: [a]", "sweep.yaml:5: compare = ['a']: must be at least two arms"),
        (START + "shown: [peak_force_N, peak_force_N]", "sweep.yaml:4: shown.1 = 'peak_force_N': must be another one"),
        (START + "envelope: [a, a]", "sweep.yaml:4: envelope.1 = 'a': must be another one than those before it"),
        (START + "arms: {a: 3}", "sweep.yaml:4: arms.a = 3: must be a mapping of scenario keys to values"),
        (
            START + "keys: {duration: [1, 2]}\narms:\n  a: {duration: 3}",
            "sweep.yaml:6: arms.a.duration is also set by keys.duration: must be set once",
        ),
        (
            START + "keys: {station: [1]}",
            "sweep.yaml:3: overrides.station.fidelity is also set by keys.station: must be set once",
        ),
        (START + "cases: {a: 3}", "sweep.yaml:4: cases.a = 3: must be a mapping of scenario keys to values"),
        (
            START + "cases: {a: {duration: 3}}\narms:\n  b: {duration: 4}",
            "sweep.yaml:6: arms.b.duration is also set by cases.a.duration: must be set once",
        ),
        (START + "arms: {one: {}}\ncompare: [one, tow]", "compare.1: unknown arm 'tow'"),
        (START + "share_over: {metric: a, condition: a <}", "share_over.condition = 'a <': must be an expression"),
        (START + "keep: everything", "sweep.yaml:4: keep: unknown keep 'everything'"),
        (START + "keys:\n  duration: [1, 2, 1]", "sweep.yaml:5: keys.duration holds 1 twice"),
        (START + "keys:\n  duraton: [1, 2]", "sweep.yaml:5: duraton: unknown key 'duraton': did you mean 'duration'?"),
        (START + "arms:\n  a:\n    controller.gain: 3", "sweep.yaml:6: controller.gain: unknown key 'gain'"),
        (START + "envelope: [measured_froce]", "envelope: unknown signal 'measured_froce': did you mean"),
        ("scenario: fig_2_7", "sweep.yaml: variant is missing: must be one of K_I = 1.5 1/s, K_I = 3 1/s"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_told_with_file_and_line(tmp_path, text, message):
    assert message in told(tmp_path, text)


def test_a_scenario_beside_the_sweep_is_found_from_anywhere(tmp_path, monkeypatch):
    (tmp_path / "mine.yaml").write_text("station: {fidelity: OneDimensional}\nduration: 0.2\n")
    (tmp_path / "sweep.yaml").write_text("scenario: mine.yaml\nseeds: 2\n")
    monkeypatch.chdir("/")
    study = study_of(read_sweep(tmp_path / "sweep.yaml"))
    assert study.size == 2
    assert study.scenario(study.trial(1)).seed == 1


def test_a_mapping_is_a_sweep_too():
    assert study_of(read_sweep(small())).size == 8


@pytest.mark.slow
@pytest.mark.parametrize("name", list_sweeps())
def test_shipped_sweeps_can_be_planned(name):
    study = study_of(read_sweep(name))
    assert study.size > 2
    assert study.writable


def test_a_sweep_that_does_not_exist_is_told(tmp_path):
    with pytest.raises(
        BadInputError, match=r"'frist_sweep' does not exist: must be a YAML file or one of: .*first_sweep"
    ):
        read_sweep("frist_sweep")


def test_a_grid_of_too_many_points_is_refused_before_it_is_made():
    keys = {f"station.{name}": list(range(1, 5001)) for name in ("time_step", "period", "posture_period")}
    with pytest.raises(BadInputError, match="the grid has 125000000000 points: must be at most 10000000"):
        study_of(read_sweep({"scenario": "fig_2_7", "variant": "K_I = 3 1/s", "keys": keys}))
