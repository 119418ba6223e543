"""Whether a record begins at rest, judged by an output-error model of second order."""

from __future__ import annotations

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.start_state import StartErrors, with_start
from thermaltool.fitting.transfer.orders import Orders
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.search import search


def started(data: TrainingData) -> TrainingData:
    """The data from rest, unless a free state describes them clearly better (`with_start`).

    Parameters
    ----------
    data : TrainingData
    """
    return with_start(data, _second_order_errors)


def _second_order_errors(data: TrainingData) -> StartErrors | None:
    """Errors of an output-error model of second order; None where there are too few rows."""
    inputs, least = range(len(data.inputs)), data.least_delays
    second = tuple(2 for _ in inputs)
    orders = Orders(second, second, least, tuple((k,) for k in inputs))
    problem = Problem(data.about_levels(orders.first), orders)
    if problem.rows <= problem.linear_count + sum(orders.nf):
        return None
    found = search(problem)

    def runs() -> list[list[Array]]:
        return [[error for error, _ in problem.errors(problem.project(found.F))]]

    return StartErrors([found.loss / problem.rows], runs)
