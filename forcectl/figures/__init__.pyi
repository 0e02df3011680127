from forcectl.figures.alignment import alignment_figure as alignment_figure
from forcectl.figures.force import run_figures as run_figures
from forcectl.figures.force import write_figures as write_figures
from forcectl.figures.motion import motion_figures as motion_figures
from forcectl.figures.reaching import null_space_figure as null_space_figure
from forcectl.figures.reaching import reach_figure as reach_figure
from forcectl.figures.tuning import experiment_figure as experiment_figure
from forcectl.figures.tuning import prediction_figure as prediction_figure
