from forcectl.errors import BadInputError as BadInputError
from forcectl.errors import ForcectlError as ForcectlError
from forcectl.errors import RunFailedError as RunFailedError
from forcectl.runs.entry import check as check
from forcectl.runs.entry import graph as graph
from forcectl.runs.entry import margins as margins
from forcectl.runs.reproduce import reproduce as reproduce
from forcectl.runs.result import InterruptedRunError as InterruptedRunError
from forcectl.runs.result import RunResult as RunResult
from forcectl.runs.run import run as run
from forcectl.runs.tune import tune_vrft as tune_vrft
from forcectl.scenario.catalog import list_experiments as list_experiments
from forcectl.scenario.scenario import Scenario as Scenario
from forcectl.scenario.scenario import build as build
from forcectl.scenario.scenario import load_scenario as load_scenario
from forcectl.sweeps.run_sweep import SweepResult as SweepResult
from forcectl.sweeps.run_sweep import sweep as sweep

__version__: str
