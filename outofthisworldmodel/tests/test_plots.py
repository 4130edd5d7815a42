import numpy as np
import pytest

from owm.report.learning import ERRORS, learning_figure
from owm.report.plots import calibration_figure, loss_figure
from owm.scores.calibration import LEVELS, Calibration


def calibrated(name):
    shape, ones = (3, 4), np.ones((3, 4))
    return Calibration(name, (1, 4, 16), 0.25, "truth", LEVELS, np.full((*shape, 3), 0.7), ones, ones, 2.0 * ones)


@pytest.mark.parametrize("models", [1, 7])
def test_a_calibration_panel_holds_one_curve_a_model(models):
    figure = calibration_figure({"a": [calibrated(f"m{n}") for n in range(models)], "none": []})
    assert len(figure.axes) == 2 * (len(LEVELS) + 1)
    for axes, nominal in zip(figure.axes, [50, 90, 99, 1] * 2):
        *curves, as_it_should_be = axes.lines
        assert len({curve.get_color() for curve in curves}) == len(curves) == models
        assert as_it_should_be.get_ydata()[0] == pytest.approx(nominal)
        np.testing.assert_allclose(curves[0].get_ydata(), 0.5 if nominal == 1 else 70)


def test_the_step_at_which_a_loss_changes_is_marked():
    curves = {"loss": ([1, 2, 3], [1.0, 1.0, 2.0])}
    training, validation = loss_figure(curves, curves, {"teacher forcing ends": 2}).axes
    assert [text.get_text() for text in training.texts] == ["teacher forcing ends"]
    assert training.lines[-1].get_xdata()[0] == training.texts[0].get_position()[0] == 2
    assert not validation.texts and len(validation.lines) == 1


def test_a_training_is_drawn_beside_what_needs_none():
    errors = dict.fromkeys(ERRORS, 2.0)
    lines = [
        {"step": 0, "seconds": 0.0} | errors,
        {"step": 10, "seconds": 60.0, "flow_loss": 1.0, "decode_loss": 0.5, "round_trip_loss": 0.4},
        {"step": 20, "seconds": 240.0, "flow_loss": 0.9, "decode_loss": 0.3, "round_trip_loss": 0.2} | errors,
    ]
    losses, *validated = learning_figure(lines, {"constant velocity": dict.fromkeys(ERRORS, 1.5)}).axes
    assert [list(line.get_xdata()) for line in losses.lines] == [[10, 20]] * 3
    for axes in validated:
        curve, level = axes.lines
        assert list(curve.get_xdata()) == [0, 20] and list(level.get_ydata()) == [1.5, 1.5]
        assert level.get_label() == "constant velocity"
    (minutes,) = losses.child_axes
    losses.figure.draw_without_rendering()
    assert losses.get_xlim() == (0, 20) and minutes.get_xlim() == pytest.approx((0, 4))
