"""The model document: what a calibration writes and every later command reads."""

from thermaltool.model.characteristics import (
    Characteristics,
    OperatingPoint,
    at_operating_points,
    characteristics,
    deviations,
    operating_points,
    step_at_rate,
    with_known_spread,
)
from thermaltool.model.document import (
    Drive,
    Model,
    Output,
    Role,
    Term,
)
from thermaltool.model.initial_state import Start, StartedOutput, started_outputs
from thermaltool.model.model_agreement import agreements
from thermaltool.model.model_file import dumps, from_document, loads, to_document
from thermaltool.model.rest import (
    Zero,
    drive_rests,
    relative,
    rest_level,
    rest_shifts,
    zero_beside,
    zero_of,
)
from thermaltool.model.selection import only_sensors
from thermaltool.model.simulate import (
    Course,
    acting_drives,
    acting_effects,
    read_outputs,
    simulate_response,
    state_rates,
    sum_terms,
    term_input,
    with_acting_terms,
)
from thermaltool.model.step import ModelRecursion
from thermaltool.model.validity import (
    MARGIN,
    NOT_AT_REST,
    UNTOLD_REST,
    Excursion,
    away_from_rest,
    excursions,
    extrapolated,
)

__all__ = [
    "MARGIN",
    "NOT_AT_REST",
    "UNTOLD_REST",
    "Characteristics",
    "Course",
    "Drive",
    "Excursion",
    "Model",
    "ModelRecursion",
    "OperatingPoint",
    "Output",
    "Role",
    "Start",
    "StartedOutput",
    "Term",
    "Zero",
    "acting_drives",
    "acting_effects",
    "agreements",
    "at_operating_points",
    "away_from_rest",
    "characteristics",
    "deviations",
    "drive_rests",
    "dumps",
    "excursions",
    "extrapolated",
    "from_document",
    "loads",
    "only_sensors",
    "operating_points",
    "read_outputs",
    "relative",
    "rest_level",
    "rest_shifts",
    "simulate_response",
    "started_outputs",
    "state_rates",
    "step_at_rate",
    "sum_terms",
    "term_input",
    "to_document",
    "with_acting_terms",
    "with_known_spread",
    "zero_beside",
    "zero_of",
]
