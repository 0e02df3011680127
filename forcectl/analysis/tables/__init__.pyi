from forcectl.analysis.tables.metric import Metric as Metric
from forcectl.analysis.tables.metric_tables import is_metric as is_metric
from forcectl.analysis.tables.metric_tables import metric_unit as metric_unit
from forcectl.analysis.tables.reference import explanation as explanation
from forcectl.analysis.tables.reference import page as page
