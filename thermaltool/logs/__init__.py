"""Logs: tables of measured channels against one clock, read from and written to files and pipes."""

from thermaltool.logs.clock import Sampling, resample
from thermaltool.logs.log import Log
from thermaltool.logs.reader import read_log
from thermaltool.logs.writer import write_table

__all__ = ["Log", "Sampling", "read_log", "resample", "write_table"]
