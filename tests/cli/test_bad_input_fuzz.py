"""Random mutations of scenario files: each loads, builds and runs, or is refused with one line; never a traceback.

The line has the file, the line in it, the full key, the value or what is wrong with it, and what is allowed.
"""

import copy
import random
import re
from pathlib import Path

import pytest

from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import Tagged, dump, parse, plain
from forcectl.runs.simulate import simulate
from forcectl.scenario.catalog import SLOTS, list_experiments, read_scenario
from forcectl.scenario.gains import asks_for_gains
from forcectl.scenario.layers import select_variants
from forcectl.scenario.scenario import as_file, build, origins, resolve, resolved_tree

NONSENSE = (
    None,
    True,
    False,
    -1,
    0,
    1,
    -3.5,
    1e-300,
    1e300,
    -1e300,
    10**400,
    float("nan"),
    float("inf"),
    "",
    "x",
    "1e5",
    "nan",
    "../..",
    "/",
    "!Integral",
    "a: b",
    "\u2028",
    "é" * 40,
    [],
    [[]],
    [1, "a", None],
    [0.0] * 6,
    ["x"] * 3,
    [1e9] * 6,
    {},
    {"a": 1},
    {"": {"": {}}},
    {"station": {"station": {}}},
    "Kinematic",
    "Multibody",
    "friction",
    0.003,
    1e-9,
    2**63,
)
PARTS = ("station", "model", "controller", "reference", "motion", "estimators", "signals", "analyses")
BREAKS = (
    "{",
    "}",
    "[",
    "]",
    ":",
    "\t",
    "&a ",
    "*a",
    "!",
    "!!python/name:os.system ",
    "|",
    ">",
    "%",
    "@",
    "`",
    "\x00",
    "'",
    '"',
    "- ",
    "\n\n  ",
    "<<: 3\n",
    "? ",
    "---\n",
    "\ufeff",
)
OTHERS = sorted(map(str, (Path(__file__).parents[1] / "data").glob("slots_of_*.yaml")))
TAGS = ("Wall", "Evasive", "Integral", "AdaptiveIntegral", "Import", "Step", "Ramp", "Sequence", "File", "Nothing", "")


def full_tree(name):
    """Every key of a scenario, so that every key can be hit."""
    file = as_file(name)
    tree = resolved_tree({variant: resolve(file, variant) for variant in select_variants(file)})
    tree["expect"] = tree["expect"][-2:]  # two lines have all there is to get wrong in them
    return tree


def places(tree, path=()):
    """Every (container, key) in a tree."""
    if isinstance(tree, dict):
        items = list(tree.items())
    elif isinstance(tree, list):
        items = list(enumerate(tree))
    else:
        return
    for key, value in items:
        yield tree, key
        yield from places(value, (*path, key))


def fillers():
    """A scenario for every tag of every slot, with all its keys, as far as one stands alone."""
    robot = {"robot": "yumi/left", "fidelity": "Multibody", "environment": Tagged({}, "Parts"), "sensors": {}}
    robot["drive"] = {"position_loop": {"delay": 0.0}}  # which its period divides
    moves = {"station": robot, "controller": Tagged({}, "JointMoves"), "duration": 0.01}
    wall = {"point": [0.0, 0.0, -1.0], "normal": [0.0, 0.0, 1.0]}
    wholes = {"estimator": "estimators", "signal": "signals", "analysis": "analyses"}
    needed = {
        "From": {"part": "station"},
        "Load": {"wrenches": [[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]]},
        "ArmTask": {"arm": "arm"},
        "RelativeTask": {"leader": "arm", "follower": "arm"},
        "ProfileFile": {"path": "profile.csv"},
        "VelocityAlongSurface": {"times": [0.0, 0.002], "velocities": [0.001, 0.0]},
        "Wall": wall,
        "Range": {"task": Tagged({"arm": "arm"}, "ArmTask")},
        "SpeedLimit": {"task": Tagged({"arm": "arm"}, "ArmTask"), "limit": [0.5]},
        "Robust": {"of": Tagged(wall, "Wall"), "braking": 2.0},
        "ForceBand": {
            "task": Tagged({"arm": "arm", "coordinates": ["z"]}, "ArmTask"),
            "force": [0.2, 0.5],
            "stiffness": [1300.0, 1600.0],
            "braking": 0.05,
        },
        "Evasive": {"potentials": [Tagged({}, "AwayFromLinks")]},
        "AwayFrom": {"constraint": Tagged(wall, "Wall")},
    }
    for slot, tags in SLOTS.items():
        for tag in tags:
            part = Tagged(needed.get(tag, {}), tag)
            if slot in ("fidelity", "drive", "environment"):
                yield {"station": {slot: part}, "duration": 0.01}
            elif slot in ("controller", "reference", "motion"):
                yield {slot: part, "duration": 0.01}
            elif slot in wholes:
                yield moves | {wholes[slot]: {"mine": part}}
            elif slot == "sensor":
                yield moves | {"station": robot | {"sensors": {"mine": part}}}
            elif slot in ("load", "fault"):
                yield moves | {"station": robot | {f"{slot}s": [part]}}
            elif slot == "excitation":
                yield {"controller": Tagged({"excitation": part}, "RecursiveVrft"), "duration": 0.01}
            elif slot == "task":
                yield moves | {"controller": Tagged({"tasks": {"mine": part}}, "ReactiveReaching")}
            elif slot == "surface":
                yield {"station": {"environment": {"surface": {"heights": {"mine": part}}}}, "duration": 0.01}
            elif slot == "constraint":
                yield moves | {"controller": Tagged({"constraints": [part]}, "ReactiveReaching")}
            elif slot == "null_space":
                yield moves | {"controller": Tagged({"null_space": part}, "ReactiveReaching")}
            elif slot == "potential":
                evasive = Tagged({"potentials": [part]}, "Evasive")
                yield moves | {"controller": Tagged({"null_space": evasive}, "ReactiveReaching")}


def misspell(word, rng):
    i = rng.randrange(len(word) + 1)
    return rng.choice([word[:i] + word[i + 1 :], word[:i] + rng.choice("aexz_. ") + word[i:], word.upper(), word[::-1]])


def mutate(tree, rng):
    """The text of a scenario with one to three random faults."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.randint(1, 3)):
        # Single keys of the parts that matter as often as the many lines of `expect`.
        part = rng.choice([tree, *(tree[part] for part in PARTS if part in tree), tree])
        found = list(places(part)) if isinstance(part, dict | list) else []
        if not found:
            break
        container, key = rng.choice(found)
        kind = rng.choice(
            ["delete", "misspell", "replace", "replace", "scale", "scale", "negate", "nest", "tag", "swap"]
        )
        if kind == "delete":
            del container[key]
        elif kind == "misspell" and isinstance(container, dict):
            container[misspell(str(key), rng)] = container.pop(key)
        elif kind == "negate" and isinstance(container[key], int | float):
            container[key] = -container[key]
        elif kind == "scale" and isinstance(container[key], int | float):
            container[key] = container[key] * 10 ** rng.uniform(-9, 9) if rng.random() < 0.9 else rng.uniform(-1, 1)
        elif kind == "nest":
            container[key] = rng.choice(
                [[container[key]], Tagged({"value": container[key]}), {str(key): container[key]}]
            )
        elif kind == "tag":
            container[key] = Tagged(
                container[key] if isinstance(container[key], dict) else {}, rng.choice(TAGS) or None
            )
        elif kind == "swap":
            other, other_key = rng.choice(found)
            container[key] = copy.deepcopy(other[other_key])
        else:
            container[key] = copy.deepcopy(rng.choice(NONSENSE))
        if not all(name in tree for name in ("station", "controller")):
            break
    text = dump(tree)
    if rng.random() < 0.25:
        for _ in range(rng.randint(1, 3)):
            i = rng.randrange(len(text) + 1)
            text = rng.choice(
                [text[:i] + rng.choice(BREAKS) + text[i:], text[:i] + text[i + rng.randint(1, 40) :], text[:i]]
            )
    return text


def try_out(path, rng):
    """Load every variant, build one, and now and then simulate an instant of it; returns what happened."""
    file = read_scenario(path, "mutant")
    changes = {"duration": 0.01} if rng.random() < 0.5 else {}
    scenarios = {variant: resolve(file, variant, changes) for variant in select_variants(file)}
    variant = rng.choice(list(scenarios))
    scenario = scenarios[variant]
    loop = build(scenario, origins(file, variant, changes))
    if scenario.duration > 0.02 or asks_for_gains(scenario):  # those take a whole experiment to find
        return "fine"
    outcome = simulate(scenario, loop, variant)
    assert outcome.failure is None or "\n" not in outcome.failure
    return "fine" if outcome.failure is None else "stopped"


def mutants(count, seed, trees=None):
    rng = random.Random(seed)
    trees = [full_tree(name) for name in (*list_experiments(), *OTHERS)] if trees is None else trees
    for _ in range(count):
        tree = rng.choice(trees)
        if len(tree.get("fidelities") or ()) > 1:
            tree["station"]["fidelity"] = Tagged({}, rng.choice(tree["fidelities"]))
        yield mutate(tree, rng), rng


def complete(error, text):
    """Whether a message has file, line, key and what is allowed, in this order; no line of a key that is left out."""
    message = str(error)
    if not error.key:  # about the text as a whole
        return re.match(r"mutant\.yaml(:| is )", message) and (
            "must be a mapping" in message or "not usable" in message or re.search(r"\(line \d+, column \d+\)", message)
        )
    line = r":\d+" if error.key.partition(".")[0] in parse(text, "mutant").lines else r"(:\d+)?"
    place = re.match(rf"(mutant\.yaml{line}: (variant .*?: )?|override: )", message)
    told = "must " in message or "known: " in message or "cannot be " in message or "is no longer a key" in message
    return place and message[place.end() :].startswith(error.key) and told


def check(count, seed, tmp_path, trees=None):
    path = tmp_path / "mutant.yaml"
    seen = {"fine": 0, "refused": 0, "stopped": 0}
    for text, rng in mutants(count, seed, trees):
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
        try:
            seen[try_out(path, rng)] += 1
        except BadInputError as error:
            message = str(error)
            if "\n" in message or len(message) > 1000 or not complete(error, text):
                pytest.fail(f"not one complete short line: {message}\nfrom\n{text}")
            seen["refused"] += 1
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            pytest.fail(f"{type(error).__name__}: {error}\nfrom\n{text}")
    return seen


@pytest.mark.slow
def test_random_mutations_of_every_experiment_never_give_a_traceback(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seen = check(400, 1, tmp_path)
    # Most faults must be refused, and a test of nothing but refusals would not look deep.
    assert seen["refused"] > 130
    assert seen["fine"] > 20


def complete_trees():
    """Of every filler that can be read, the scenario with every key written out."""
    for scenario in fillers():
        try:
            yield resolved_tree({"default": resolve(as_file(scenario))})
        except BadInputError:  # a file that it needs is not there: as it is
            yield plain(scenario)


@pytest.mark.slow
def test_every_slot_gives_a_line_or_a_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    trees = list(complete_trees())
    assert len(trees) == sum(map(len, SLOTS.values()))
    seen = check(200, 2, tmp_path, trees)
    assert seen["refused"] > 60
    assert seen["fine"] > 10


@pytest.mark.slow
def test_many_more_mutations(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    check(100, 3, tmp_path)
