"""Random mutations of scenario files: each loads, builds and runs, or is refused with one line; never a traceback."""

from __future__ import annotations

import copy
import random
from pathlib import Path

import pytest

from forcectl.errors import BadInputError
from forcectl.runs.simulate import simulate
from forcectl.scenario.catalog import list_experiments, read_scenario
from forcectl.scenario.scenario import as_file, build, resolve, resolved_tree, select_variants
from forcectl.scenario.yaml_tree import Tagged, dump

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
    loop = build(scenario)
    if scenario.duration > 0.02:
        return "fine"
    outcome = simulate(scenario, loop, variant)
    assert outcome.failure is None or "\n" not in outcome.failure
    return "fine" if outcome.failure is None else "stopped"


def mutants(count, seed):
    rng = random.Random(seed)
    trees = [full_tree(name) for name in (*list_experiments(), *OTHERS)]
    for _ in range(count):
        yield mutate(rng.choice(trees), rng), rng


def check(count, seed, tmp_path):
    path = tmp_path / "mutant.yaml"
    seen = {"fine": 0, "refused": 0, "stopped": 0}
    for text, rng in mutants(count, seed):
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
        try:
            seen[try_out(path, rng)] += 1
        except BadInputError as error:
            message = str(error)
            if "\n" in message or not 0 < len(message.strip()) < 1000:
                pytest.fail(f"not one short line: {message}\nfrom\n{text}")
            seen["refused"] += 1
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            pytest.fail(f"{type(error).__name__}: {error}\nfrom\n{text}")
    return seen


def test_random_mutations_of_every_experiment_never_give_a_traceback(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seen = check(400, 1, tmp_path)
    # Most faults must be refused, and a test of nothing but refusals would not look deep.
    assert seen["refused"] > 130
    assert seen["fine"] > 20


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3])
def test_many_more_mutations(tmp_path, monkeypatch, seed):
    monkeypatch.chdir(tmp_path)
    check(400, seed, tmp_path)
