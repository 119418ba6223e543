"""What is in a log and what is wrong with it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Unpack

from thermaltool.api.inputs import Reading, reads
from thermaltool.api.result import Result
from thermaltool.documents import jsonable
from thermaltool.logs import read_log

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.logs import Log
    from thermaltool.logs.inspect import Finding, Inspection
    from thermaltool.logs.reader import Data


@dataclass(frozen=True, repr=False)
class LogCheck(Result):
    """A log and what is wrong with it.

    Attributes
    ----------
    log : Log
        Without the faults that are left out.
    inspection : Inspection
        Rows, clock, channels and findings.
    """

    log: Log
    inspection: Inspection

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is wrong, in the order reading, clock, channels."""
        return self.inspection.findings

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings

    @property
    def frame(self) -> pandas.DataFrame:
        """What is wrong, one row each."""
        import pandas

        columns = ["kind", "line", "column", "message"]
        rows = [[getattr(each, name) for name in columns] for each in self.findings]
        return pandas.DataFrame(rows, columns=columns)

    def document(self) -> dict[str, Any]:
        """The check as JSON-ready data; null for what is not finite."""
        log = {"log": self.log.name, "sha256": self.log.digest, "epoch": self.log.epoch}
        found = {k: v for k, v in asdict(self.inspection).items() if k != "faults"}
        document: dict[str, Any] = jsonable({**log, **found})
        return document

    def table(self) -> str:
        """Rows, clock, channels and findings, one line each."""
        from thermaltool.report.check import check_table

        return check_table(self.log, self.inspection)

    def draw(self) -> Figure:
        """The channels of the log against its clock."""
        from thermaltool.report.records import draw_log

        return draw_log(self.log)


@reads(Reading)
def check(data: Data, **reading: Unpack[Reading]) -> LogCheck:
    """What is in a log (rows, clock, channels) and what is wrong with it.

    Parameters
    ----------
    data : str, path, pandas.DataFrame or Record
    **reading
        See `read_log`.

    Returns
    -------
    LogCheck

    Raises
    ------
    LogError
        An input that cannot be read at all.

    Examples
    --------
    >>> import pandas as pd, thermaltool as tt
    >>> frame = pd.DataFrame({"time_s": [0.0, 1.0, 2.0], "T_a_degC": [20.0, -300.0, 20.1]})
    >>> [finding.message for finding in tt.check(frame).findings]
    ['-300 degC is below absolute zero']
    """
    from thermaltool.logs.faults import without
    from thermaltool.logs.inspect import inspect

    policy = reading.pop("faults", "omit")
    log = read_log(data, **reading, strict=False)
    inspection = inspect(log)
    return LogCheck(without(log, inspection.faults) if policy == "omit" else log, inspection)
