from forcectl.sweeps.at_work import SweepProgress as SweepProgress
from forcectl.sweeps.run_sweep import SweepResult as SweepResult
from forcectl.sweeps.run_sweep import sweep as sweep
from forcectl.sweeps.sweep_config import SweepConfig as SweepConfig
