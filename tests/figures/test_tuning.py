"""Figures of a tuned controller show what they are given."""

import numpy as np
import pytest

from forcectl.figures.tuning import experiment_figure, prediction_figure

TIME = np.linspace(0.0, 2.0, 50)


def lines(axes):
    return {line.get_label(): np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()}


def test_experiment_has_displacement_in_millimetres_and_both_forces():
    figure = experiment_figure(TIME, -1e-3 * TIME, 5 * TIME, 4 * TIME, "a title with $ signs $")
    above, below = figure.axes
    np.testing.assert_allclose(above.get_lines()[0].get_ydata(), -TIME)
    assert above.get_ylabel() == "displacement [mm]"
    shown = lines(below)
    np.testing.assert_allclose(shown["recorded"], 5 * TIME)
    np.testing.assert_allclose(shown["plant model, from the displacement"], 4 * TIME)
    assert above.get_title(loc="left") == "a title with $ signs $"


def test_prediction_has_both_responses_and_their_difference():
    figure = prediction_figure(TIME, 1.1 * TIME, TIME)
    above, below = figure.axes
    np.testing.assert_allclose(lines(above)["tuned loop, predicted"], 1.1 * TIME)
    np.testing.assert_allclose(lines(above)["reference model"], TIME)
    np.testing.assert_allclose(below.get_lines()[-1].get_ydata(), 0.1 * TIME)


def test_rounding_errors_are_not_drawn_as_a_difference():
    _, below = prediction_figure(TIME, TIME + 1e-11 * np.sin(TIME), TIME).axes
    assert below.get_ylim() == (-2e-3, 2e-3)
    _, below = prediction_figure(TIME, 1.01 * TIME, TIME).axes
    assert below.get_ylim()[1] == pytest.approx(0.02, rel=0.2)


def test_a_loop_that_runs_away_does_not_hide_the_model():
    predicted = 10 * (1 - np.exp(-TIME))
    predicted[20:] *= -1e6
    predicted[40:] = np.nan
    above, _ = prediction_figure(TIME, predicted, 10 * (1 - np.exp(-TIME))).axes
    assert above.get_ylim()[1] < 50
