"""Names of the laws by which heaters are set; without numpy, for the command line."""

from __future__ import annotations

from typing import Literal, get_args

Method = Literal["receding-horizon", "output-lqr", "state-lqr", "inversion"]
METHODS: tuple[str, ...] = get_args(Method)
