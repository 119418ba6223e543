"""Which causes this log can tell apart, and the experiment that would."""

from __future__ import annotations

from collections.abc import Sequence

from thermaltool.diagnosis.result import Alternative
from thermaltool.diagnosis.scan import Candidate
from thermaltool.diagnosis.workbench import Workbench


def alternatives(
    bench: Workbench, chosen: Candidate, rivals: Sequence[Candidate]
) -> list[Alternative]:
    return []
