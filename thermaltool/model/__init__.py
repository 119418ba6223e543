"""The model document: what a calibration writes and every later command reads."""

from thermaltool.model.document import (
    Drive,
    Model,
    Output,
    Role,
    Term,
    dumps,
    loads,
    to_document,
)
from thermaltool.model.selection import only_sensors
from thermaltool.model.simulate import (
    acting_drives,
    read_outputs,
    relative,
    simulate_response,
    sum_terms,
    term_input,
)
from thermaltool.model.step import ModelRecursion
from thermaltool.model.validity import (
    MARGIN,
    NOT_AT_REST,
    Excursion,
    away_from_rest,
    excursions,
    extrapolated,
)

__all__ = [
    "MARGIN",
    "NOT_AT_REST",
    "Drive",
    "Excursion",
    "Model",
    "ModelRecursion",
    "Output",
    "Role",
    "Term",
    "acting_drives",
    "away_from_rest",
    "dumps",
    "excursions",
    "extrapolated",
    "loads",
    "only_sensors",
    "read_outputs",
    "relative",
    "simulate_response",
    "sum_terms",
    "term_input",
    "to_document",
]
