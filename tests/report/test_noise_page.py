from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt


def test_eight_channels_are_one_page_and_constant_ones_are_named():
    rng = np.random.default_rng(8)
    frame = pd.DataFrame({"time_s": np.arange(600.0)})
    names = [f"T_front bearing housing {k}_degC" for k in range(7)]
    for name in names:
        frame[name] = 20 + 0.02 * rng.standard_normal(600)
    frame["Q_main_W"] = 5.0
    figure = tt.noise(frame).draw()
    assert figure.get_size_inches().tolist() == pytest.approx([13.0, 1.3 + 15.0])
    assert len(figure.axes) == 7 * 3
    assert [ax.get_title(loc="left") for ax in figure.axes[::3]] == names
    assert "no noise seen: Q_main_W" in [text.get_text() for text in figure.texts]
    # One label of the clock, under the lowest row.
    assert [bool(ax.get_xlabel()) for ax in figure.axes[::3]] == [False] * 6 + [True]


def test_a_log_of_constant_channels_says_so():
    frame = pd.DataFrame({"time_s": np.arange(600.0), "Q_main_W": 5.0})
    figure = tt.noise(frame, warn=lambda message: None).draw()
    assert any("constant" in text.get_text() for ax in figure.axes for text in ax.texts)
