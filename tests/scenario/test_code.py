"""A scenario names code only where its user allows it, and says which; see docs/security.md."""

import sys
from pathlib import Path

import pytest

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import parse
from forcectl.scenario.catalog import ScenarioFile, find_scenario
from forcectl.scenario.code import code_in
from forcectl.scenario.gains import identifications
from forcectl.scenario.scenario import load_scenario

EVIL = 'from pathlib import Path\nPath(__file__).with_name("ran").touch()\nclass Law:\n    add_to = None.__init__\n'
IMPORT = "!Import {path: 'evil_lab:Law', parameters: {command: x}}"
WAYS = [
    f"controller: {IMPORT}",
    f"reference: {IMPORT}",
    f"motion: {IMPORT}",
    f"estimators: {{a: {IMPORT}}}",
    f"analyses: {{a: {IMPORT}}}",
    f"signals: {{measured_force: {IMPORT}}}",
    f"station: {{fidelity: {IMPORT}}}",
    f"station: {{drive: {IMPORT}}}",
    f"station: {{environment: {IMPORT}}}",
    f"station: {{sensors: {{force: {IMPORT}}}}}",
    f"station: {{loads: [{IMPORT}]}}",
    f"station: {{faults: [{IMPORT}]}}",
    f"station: {{environment: !Surface {{surface: {{heights: {{a: {IMPORT}}}}}}}}}",
    f"controller: !InvarianceRobot {{constraints: [{IMPORT}]}}",
    f"controller: !ReactiveReaching {{null_space: {IMPORT}}}",
    f"controller: !RecursiveVrft {{excitation: {IMPORT}}}",
    f"variants: {{a: {{}}, b: {{controller: {IMPORT}}}}}",
    f"controller: !Import {{path: 'own_lab:Law'}}\nestimators: {{a: {IMPORT}}}",
    f"_a: &a {IMPORT}\ncontroller: *a",
    "controller: !!python/object/apply:os.system ['touch ran']",
    "controller: !Import {path: 'os:system', parameters: {command: 'touch ran'}}",
    "controller: !Import {path: 'evil_lab'}",
    "controller: '!Import'",
    "model: {robot_compliance: !Import {path: 'evil_lab:Law'}}",
    "controller: !Vrft {gains_from: ../lab/other.yaml}",
    "controller: !Governed {law: !Vrft {gains_from: ../lab/another.yaml}}",
    "controller: !Import {path: 'own_lab:Law', parameters: {gains_from: ../lab/other.yaml}}",
    "variants: {a: {}, b: {controller: !Vrft {gains_from: ../lab/other.yaml}}}",
    "%TAG ! tag:yaml.org,2002:python/\n---\ncontroller: !object/apply:os.system ['touch ran']",
    "%TAG !p! tag:yaml.org,2002:python/\n---\ncontroller: !p!object/apply:os.system ['touch ran']",
    "controller: !<tag:yaml.org,2002:python/object/apply:os.system> ['touch ran']",
    "controller: !!python/object/new:os.system ['touch ran']",
    "controller: !!python/module:evil_lab ''",
    "controller: !python/object/apply:os.system ['touch ran']",
    "controller: !Import {path: 'forcectl.cli.app:main'}",
    "analyses: {a: !Import {path: 'forcectl.runs.run:run', parameters: {scenario: fig_2_7, out: ran}}}",
    "controller: !Import {path: 'forcectl.framework.imports:import_module', parameters: {name: evil_lab}}",
    "controller: !Import {path: '\uff4f\uff53:system', parameters: {command: 'touch ran'}}",
    "controller: !Import {path: ['os:system']}",
    "controller: !Import {path: 'yaml:unsafe_load', parameters: {stream: '!!python/module:evil_lab'}}",
    "controller: !Import {path: 'numpy:load', parameters: {file: ran.npy, allow_pickle: true}}",
    "variants: {a: {controller: '!Import', controller.path: 'evil_lab:Law'}}",
    "controller: !Import {path: 'own_lab:Law'}\nvariants: {a: {controller.path: 'evil_lab:Law'}}",
    f"preset: {IMPORT}",
    f"guard: {IMPORT}",
    f"log: [{IMPORT}]",
    f"controller: !Governed {{law: {IMPORT}}}",
    f"station: {{environment: !Parts {{parts: {{a: {IMPORT}}}}}}}",
    "reference: !File {path: '| touch ran'}",
    "expect: [{target: t, metric: \"__import__('evil_lab')\", maximum: 1}]",
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A scenario's folder; a module that leaves a mark lies in another one, which Python looks into."""
    for name in ("lab", "mine"):
        (tmp_path / name).mkdir()
    (tmp_path / "lab" / "evil_lab.py").write_text(EVIL)
    (tmp_path / "lab" / "other.yaml").write_text(f"controller: {IMPORT}\n")
    (tmp_path / "lab" / "another.yaml").write_text("controller: !Vrft {gains_from: other.yaml}\n")
    (tmp_path / "mine" / "own_lab.py").write_text(EVIL)
    monkeypatch.syspath_prepend(str(tmp_path / "lab"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    yield tmp_path
    for name in ("evil_lab", "own_lab"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("text", WAYS)
def test_code_is_refused_before_anything_is_imported(folder, text):
    file = folder / "mine" / "own.yaml"
    file.write_text(f"{text}\n")
    for call in (load_scenario, fc.check, fc.graph, fc.run):
        with pytest.raises(BadInputError, match=r"^own\.yaml") as caught:
            call(file)
        assert "\n" not in str(caught.value)
    assert not list(folder.rglob("*ran"))
    assert not {"evil_lab", "own_lab"} & set(sys.modules)


SPLIT = [
    ("controller: !Import {path: 'own_lab:Law'}\nvariants: {a: {controller.path: 'evil_lab:Law'}, b: {}}", {}),
    ("controller: !Import {path: 'own_lab:Law'}\nvariants: {a: {controller: {path: 'evil_lab:Law'}}, b: {}}", {}),
    ("reference: !Import {path: 'own_lab:L'}\n"
     "variants: {a: {controller: '!Import', controller.path: 'os:nice'}, b: {}}", {}),
    ("estimators: {e: !Import {path: 'own_lab:Law'}}\nvariants: {a: {estimators.e.path: 'evil_lab:Law'}, b: {}}", {}),
    ("station: {loads: [!Import {path: 'own_lab:L'}]}\nvariants: {a: {station.loads.0.path: 'evil_lab:L'}, b: {}}", {}),
    ("controller: !Vrft {gains_from: fig_4_5}\nreference: !Import {path: 'own_lab:Law'}\n"
     "variants: {a: {controller.gains_from: ../lab/other.yaml}, b: {}}", {}),
    ("reference: !Import {path: 'own_lab:Law'}\nvariants: {a: {controller: !Import {path: 'own_lab:Law'}}, b: {}}",
     {"controller.path": "evil_lab:Law"}),
]  # fmt: skip


@pytest.mark.parametrize(("text", "overrides"), SPLIT)
def test_a_path_that_one_variant_gives_to_a_part_is_looked_at_before_another_one_imports(folder, text, overrides):
    file = folder / "mine" / "own.yaml"
    file.write_text(f"{text}\n")
    with pytest.raises(BadInputError, match=r"^(own\.yaml:\d+|override): .*(evil_lab|os:nice)"):
        load_scenario(file, variant="b", overrides=overrides)
    assert not list(folder.rglob("*ran"))
    assert not {"evil_lab", "own_lab"} & set(sys.modules)


def test_a_path_for_a_part_that_is_not_imported_is_no_code(folder):
    """Another tag replaces the part that is imported, and what it calls its path is that of a file."""
    (folder / "mine" / "own.yaml").write_text(
        "reference: !Import {path: 'own_lab:Law'}\nvariants: {a: {reference: !File {path: own.csv}}, b: {}}\n"
    )
    found = code_in(find_scenario(folder / "mine" / "own.yaml"))
    assert found == {"reference": "own_lab:Law"}


def test_a_sweep_trusts_what_is_beside_itself_not_what_is_beside_its_scenario(folder):
    (folder / "lab" / "own.yaml").write_text(f"controller: {IMPORT}\n")
    sweep = "scenario: {}\nkeys: {{duration: [0.1, 0.2]}}\n"
    (folder / "mine" / "all.yaml").write_text(sweep.format("../lab/own.yaml"))
    (folder / "mine" / "case.yaml").write_text(
        f"scenario: fig_2_7\nvariant: K_I = 1.5 1/s\ncases: {{a: {{controller: {IMPORT}}}}}\n"
    )
    for name in ("all", "case"):
        with pytest.raises(BadInputError, match=r"'evil_lab:Law': must be of a module beside the file") as caught:
            fc.sweep(folder / "mine" / f"{name}.yaml", out=folder / "out")
        assert "\n" not in str(caught.value)
    assert not list(folder.rglob("*ran"))
    (folder / "lab" / "all.yaml").write_text(sweep.format("own.yaml"))
    with pytest.raises(BadInputError, match="takes no arguments"):  # it was imported, and called
        fc.sweep(folder / "lab" / "all.yaml", out=folder / "out")


@pytest.mark.slow
def test_a_module_is_allowed_by_keyword_option_or_settings(folder, monkeypatch, forcectl):
    file = folder / "mine" / "own.yaml"
    file.write_text("duration: 0.01\nstation: {fidelity: OneDimensional}\ncontroller: !Import {path: 'good_lab:Law'}\n")
    law = "from forcectl.force.integral import IntegralConfig\nclass Law(IntegralConfig):\n    pass\n"
    (folder / "lab" / "good_lab.py").write_text(law)
    code, _, said = forcectl("check", file)
    assert (code, said.count("\n")) == (2, 1)
    assert "own.yaml:3: controller.path = 'good_lab:Law': must be of a module beside the file that is run" in said
    assert "--allow-imports good_lab" in said
    assert type(load_scenario(file, allow_imports=["good_lab"]).controller).__name__ == "Law"
    code, said, _ = forcectl("check", file, "--allow-imports", "good_lab")
    assert code == 0
    assert "runs code that is not forcectl's own: good_lab:Law (controller)" in said
    settings = folder / "config" / "forcectl" / "settings.yaml"
    settings.parent.mkdir(parents=True)
    settings.write_text("allow_imports: [good_lab]\n")
    assert type(load_scenario(file).controller).__name__ == "Law"
    assert "beside modules in their own folder: good_lab" in forcectl("list")[1]
    settings.write_text("allow_imports: [os]\n")
    with pytest.raises(BadInputError, match=r"settings\.yaml:1: allow_imports = 'os': must be a module of your own"):
        load_scenario(file)
    sys.modules.pop("good_lab", None)


def test_code_is_read_off_the_text(monkeypatch):
    monkeypatch.setattr("forcectl.scenario.code.announced", lambda slot: {"Own": "lab:Own"} if slot == "load" else {})
    tree = parse("{controller: !Import {path: 'a:B'}, station: {loads: [!Own {}, '!Load']}, title: '!Own of x'}", "t")
    assert code_in(ScenarioFile("t", "t", tree, Path.cwd())) == {"controller": "a:B", "station.loads.0": "lab:Own"}


def test_an_experiment_that_finds_gains_may_name_what_the_scenario_may(folder, forcectl):
    law = "from forcectl.force.vrft.experiment import RecursiveVrftConfig\nclass Law(RecursiveVrftConfig):\n    pass\n"
    (folder / "mine" / "own_lab.py").write_text(law)
    (folder / "mine" / "find.yaml").write_text("controller: !Import {path: 'own_lab:Law'}\n")
    file = folder / "mine" / "own.yaml"
    file.write_text("controller: !Vrft {gains_from: find.yaml}\nstation: {fidelity: OneDimensional}\n")
    scenario = load_scenario(file)
    (one,) = identifications(scenario, scenario.experiment)
    assert type(one.scenario.controller).__name__ == "Law"
    assert identifications(load_scenario(scenario), load_scenario(scenario).experiment) == [one]
    assert code_in(find_scenario(file)) == {"controller.gains_from: find.yaml: controller": "own_lab:Law"}
    assert (
        "runs code that is not forcectl's own: own_lab:Law (controller.gains_from: find.yaml: controller)"
        in (forcectl("check", file)[1])
    )


@pytest.mark.parametrize(("body", "text"), [
    ("pass", "has no attribute 'gain_scale'"),
    ("def gain_scale(self, bandwidth): raise SystemExit(3)", "SystemExit: 3"),
    ("def gain_scale(self, bandwidth): return 'much'", "ValueError: could not convert string to float"),
    ("finds_gains = 3", "finds no gains"),
])  # fmt: skip
def test_an_experiment_whose_controller_is_unfit_to_find_gains(folder, body, text):
    law = f"class Law:\n    finds_gains = ('integral_gain',)\n    def add_to(self): ...\n    {body}\n"
    (folder / "mine" / "own_lab.py").write_text(law)
    (folder / "mine" / "find.yaml").write_text("controller: !Import {path: 'own_lab:Law'}\n")
    file = folder / "mine" / "own.yaml"
    file.write_text("controller: !Vrft {gains_from: find.yaml}\n")
    with pytest.raises(BadInputError, match=r"^own\.yaml:1: controller\.gains_from = '.*find\.yaml': ") as caught:
        load_scenario(file)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_class_for_a_slot_without_methods_has_fields_or_add_to(folder):
    (folder / "mine" / "own_lab.py").write_text("class Law:\n    def __init__(self, path): open(path, 'w')\n")
    file = folder / "mine" / "own.yaml"
    parameters = f"{{path: {folder / 'ran'}}}"
    file.write_text(f"station: {{environment: !Import {{path: 'own_lab:Law', parameters: {parameters}}}}}\n")
    with pytest.raises(BadInputError, match="must be a class that fills the slot environment, with fields or add_to"):
        load_scenario(file)
    assert not (folder / "ran").exists()


def test_a_module_that_is_allowed_must_be_there_and_is_not_imported_to_see_that(folder, forcectl):
    file = folder / "mine" / "own.yaml"
    file.write_text("duration: 0.01\n")
    code, out, said = forcectl("check", file, "--allow-imports", "no_such_lab")
    assert (code, out, said.count("\n")) == (2, "", 1)
    assert said.startswith("error: allow_imports = 'no_such_lab': must be installed, beside the file that is run or in")
    assert forcectl("check", file, "--allow-imports", "no_such_lab.laws")[0] == 2
    (folder / "mine" / "loud_lab").mkdir()
    (folder / "mine" / "loud_lab" / "__init__.py").write_text("raise SystemExit('imported')\n")
    for name in ("loud_lab", "loud_lab.laws", "numpy"):
        load_scenario(file, allow_imports=[name])
    assert "loud_lab" not in sys.modules
