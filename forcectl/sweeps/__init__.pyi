from forcectl.sweeps.run_sweep import Progress as Progress
from forcectl.sweeps.run_sweep import SweepResult as SweepResult
from forcectl.sweeps.run_sweep import sweep as sweep
from forcectl.sweeps.sweep_config import SweepConfig as SweepConfig
