from forcectl.analysis.findings.config import FindingsConfig as FindingsConfig
from forcectl.analysis.findings.finding import RunFinding as RunFinding
from forcectl.analysis.findings.finding import Severity as Severity
