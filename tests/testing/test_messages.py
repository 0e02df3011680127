"""Each assertion in a user's test: how a failure reads, and that it shows the user's line, not ours."""

import pytest
import scipy.signal

import forcectl.doctor
import forcectl.testing

pytest_plugins = ["pytester"]

# pytester forgets every module that its inner run imports. Extension modules cannot be loaded twice, so they must
# have been loaded before.
LOADED = [
    scipy.signal.lsim,
    forcectl.doctor.examine,
    *(getattr(forcectl.testing, name) for name in forcectl.testing.__all__),
]

PRELUDE = """
import numpy as np
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Gain, Integrator, LinearSystem, PassThrough, ZeroOrderHold
from forcectl.testing import *

class Remembers(LeafSystem):
    '''Remembers in an attribute.

    ```
    name: Remembers
    input_ports: [v]
    output_ports: [y]
    parameters: [gain]
    ```
    '''
    def __init__(self):
        super().__init__()
        self.count = 0
        self.u = self.DeclareVectorInputPort("u", 1)
        self.DeclareVectorOutputPort("y", 1, self._calc, prerequisites_of_calc={self.time_ticket()})
    def _calc(self, context, output):
        self.count += 1
        output.SetFromVector([self.count])

first_order = lambda: LinearSystem([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
oscillator = lambda: LinearSystem([[0.0, 1.0], [-1.0, -0.2]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
kept = []
"""

CASES = {
    "assert_ports(Gain(1.0, 2), {'u0': 1, 'u1': 3}, {})": [
        "*AssertionError: ports of Gain* differ from the contract:",
        "*input 'u0' has size 2, contract: size 1*",
        "*input 'u1' is missing (contract: size 3); there are [[]'u0'[]]*",
        "*output 'y0' (size 2) is not in the contract*",
    ],
    "assert_feedthrough(Gain(1.0, 1), set())": [
        "*AssertionError: direct feedthrough of Gain* is not as stated:",
        "*y0 <- u0 is too many: declare prerequisites_of_calc of y0 without it*",
    ],
    "assert_feedthrough(Integrator(1), {('y0', 'u0')})": ["*y0 <- u0 is missing*"],
    "assert_docstring_matches(Remembers())": [
        "*AssertionError: docstring of Remembers does not match what it declares:",
        "*input_ports: docstring [[]'v'[]], declared [[]'u'[]]*",
        "*parameters: docstring [[]'gain'[]], declared 0*",
    ],
    "assert_matches_model(step_response(first_order(), 'u0', 'y0', 2.0), lambda t: 2 - 2 * np.exp(-2*t), atol=1e-3)": [
        "*AssertionError: step response u0 -> y0 differs from the model in 1000 of 1001 samples, first at t = 0.001 s, "
        "most at t = 0.693 s: response 0.999*, model 1.49*, difference 0.5, allowed 0.001*",
    ],
    "assert_no_overshoot(step_response(oscillator(), 'u0', 'y0', 1.0, 10.0, 0.01), final=1.0)": [
        "*AssertionError: step response u0 -> y0 overshoots by 0.7292* (72.92%) at t = 3.16 s: it reaches 1.729*",
    ],
    "assert_settles_within(step_response(oscillator(), 'u0', 'y0', 1.0, 60.0, 0.01), 5.0, final=1.0)": [
        "*AssertionError: step response u0 -> y0 is last outside at t = * the band is 1 +- 0.02 (2%), allowed are 5 s*",
    ],
    "assert_passes_no_nan(PassThrough(1), duration=1.0, period=0.1)": [
        "*AssertionError: PassThrough* passes NaN on silently:",
        "*NaN on 'u' from t = 0.5 s comes out of 'y' at t = 0.5 s*",
    ],
    "rng = np.random.default_rng(0); assert_deterministic(lambda: Gain(rng.random(), 1), duration=1.0, period=0.5, "
    "inputs={'u0': 1.0})": [
        "*AssertionError: two builds give different runs, first in y0[[]0[]] at t = 0 s: *; seed every random source*",
    ],
    "assert_same_after_reset_and_clone(Remembers(), duration=1.0, period=0.1)": [
        "*AssertionError: Remembers runs differently after a reset, first in y[[]0[]] at t = 0 s: "
        "*; some state is kept outside of the Context*",
    ],
    "assert_memory_released(lambda: kept.append(np.ones(1_000_000)) or Gain(1.0, 1), builds=3)": [
        "*AssertionError: the process grows by * kB per build, allowed are 1024 kB*",
    ],
}


@pytest.fixture(autouse=True)
def only_our_plugin(monkeypatch):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")


@pytest.mark.parametrize("call", CASES, ids=[call.split("(")[0] + str(i) for i, call in enumerate(CASES)])
def test_a_failure_reads_well(pytester, call):
    pytester.makepyfile(test_user=f"{PRELUDE}\ndef test_it():\n    {call}\n")
    result = pytester.runpytest_inprocess("-p", "forcectl.testing.plugin", "-W", "ignore")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines([f"*>*{call.split(';')[-1].strip()[:20].replace('[', '[[]')}*"])
    result.stdout.fnmatch_lines(["E" + line.lstrip("E") for line in CASES[call]])
    result.stdout.no_fnmatch_line("*__tracebackhide__*")


def test_the_same_assertions_pass_where_they_should(pytester):
    pytester.makepyfile(
        test_user=PRELUDE
        + """
def test_it():
    assert_ports(Gain(1.0, 2), {'u0': 2}, {'y0': 2})
    assert_feedthrough(Gain(1.0, 1), {('y0', 'u0')})
    response = step_response(first_order(), 'u0', 'y0', 2.0, 10.0, 0.01)
    assert_matches_model(response, ([1.0], [1.0, 1.0]), atol=1e-6)
    assert_no_overshoot(response, final=2.0)
    assert_settles_within(response, 4.0, final=2.0)
    assert_passes_no_nan(ZeroOrderHold(0.1, 1), duration=0.1, period=0.1)
    assert_deterministic(first_order, duration=1.0, period=0.1, inputs={'u0': np.sin})
    assert_same_after_reset_and_clone(first_order(), duration=1.0, period=0.1, inputs={'u0': np.sin})
    assert_memory_released(first_order, builds=2)
"""
    )
    pytester.runpytest_inprocess("-p", "forcectl.testing.plugin").assert_outcomes(passed=1)
