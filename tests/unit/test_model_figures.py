"""Pictures of a model: every kind of block can be drawn, and the axes say what they show."""

import numpy as np
import pytest
from hypothesis import given, settings

from hident.block_chain import BlockChain
from hident.fitted_model import FittedModel
from hident.linear_blocks import TransferFunction
from hident.reports.model_figures import comparison, figures
from hident.reports.style import style
from hident.static_functions import PiecewiseLinear, Saturation, StaticFunction
from tests.unit.model_maker import models

VALVE = StaticFunction(PiecewiseLinear((1.0, 2.0, 4.0)), (0.0, 1.2, 2.4))
TANK = TransferFunction(b=(0.0, 0.2), a=(0.8,))


def drawn(model, name):
    with style():
        return figures(model)[name]()


def labels(figure):
    return [(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes if axes.get_visible()]


@given(model=models())
@settings(max_examples=10, deadline=None)
def test_every_model_can_be_drawn(model):
    for name in figures(model):
        drawn(model, name).canvas.draw()


def test_what_a_model_has_not_is_not_drawn():
    assert list(figures(FittedModel(BlockChain((VALVE,))))) == ["static_functions.png"]
    assert "static_functions.png" not in figures(FittedModel(BlockChain((TANK,))))


def test_the_units_of_the_ends_are_those_of_the_record():
    model = FittedModel(
        BlockChain((VALVE, TANK, VALVE)), about={"units": {"input": "V", "output": "m", "time": "s"}}
    )
    assert labels(drawn(model, "static_functions.png")) == [
        ("input of N1 (V)", "output of N1"),
        ("input of N2", "output of N2 (m)"),
    ]


@pytest.mark.parametrize(
    ("dt", "unit", "label", "nyquist"),
    [
        (None, "s", "frequency (rad/sample)", np.pi),
        (0.5, "s", "frequency (Hz)", 1.0),
        (0.5, "min", "frequency (cycles/min)", 1.0),
        (0.5, "", "frequency (cycles per unit of time)", 1.0),
    ],
)
def test_the_frequencies_of_a_bode_diagram_end_at_half_the_sampling_rate(dt, unit, label, nyquist):
    figure = drawn(FittedModel(BlockChain((TANK,), dt=dt), about={"units": {"time": unit}}), "bode.png")
    gains, phases = figure.axes
    assert phases.get_xlabel() == label
    x, y = gains.lines[0].get_data()
    np.testing.assert_allclose(x[-1], nyquist)
    np.testing.assert_allclose(y[0], 0.0, atol=0.01)
    np.testing.assert_allclose(y[-1], 20 * np.log10(0.2 / 1.8))


def test_a_curve_is_solid_where_it_was_fitted_and_dashed_beyond():
    model = FittedModel(BlockChain((VALVE,)), ranges=((1.2, 3.9),))
    solid, *beyond, knots = drawn(model, "static_functions.png").axes[0].lines
    assert (solid.get_xdata()[0], solid.get_xdata()[-1]) == (1.2, 3.9)
    assert [line.get_linestyle() for line in beyond] == ["--", "--"]
    assert knots.get_xdata().tolist() == [1.0, 2.0, 4.0]


def test_of_a_saturation_whose_range_is_not_known_nothing_is_dashed():
    model = FittedModel(BlockChain((StaticFunction(Saturation(-1.0, 1.0), (0.0, 1.0)),)))
    curve, corners = drawn(model, "static_functions.png").axes[0].lines
    assert curve.get_label().startswith("_")
    assert corners.get_label() == "corners"


def test_a_step_response_reaches_the_static_gain():
    [axes] = drawn(FittedModel(BlockChain((TANK,), dt=4.0)), "step_responses.png").axes
    response, gain = axes.lines
    np.testing.assert_allclose(response.get_ydata()[-1], 1.0, atol=5e-3)
    assert gain.get_label() == "static gain 1"
    assert axes.get_xlabel() == "time"


def test_poles_and_zeros_far_away_are_counted():
    block = TransferFunction(b=(0.1, 1.0), a=(0.8,))
    [axes] = drawn(FittedModel(BlockChain((block,))), "poles_zeros.png").axes
    assert axes.get_title() == "L (1 beyond the frame)"


def test_an_output_is_drawn_with_what_it_is_compared_with():
    t = np.arange(3.0)
    with style():
        figure = comparison(t, "time (s)", t, t, t, ("u (V)", "y (m)", "simulation"))
    assert labels(figure) == [("", "y (m)"), ("", "residual"), ("time (s)", "u (V)")]
    with style():
        figure = comparison(t[:1], "sample", t[:1], t[:1], None, ("u", "output", "simulation"))
    assert labels(figure) == [("", "output"), ("sample", "u")]
