"""Words that a stream writes beside its numbers: what a line rests on, and what the alarm says."""

from __future__ import annotations

# Columns of words: they are no channels.
STATUS, ALARM = "status", "alarm"
WORDS = frozenset({STATUS, ALARM})

# Status: what the estimate rests on ...
SAFE, HELD, REDUCED, SETTLES = "safe", "held", "reduced", "settles"
RESUMED, EXTRAPOLATES, OK = "resumed", "extrapolates", "ok"
# ... and what a controller's law does with it.
SATURATED, OLD_PLAN, FAILED, FAULT = "saturated", "old-plan", "failed", "fault"
# Alarm: whether model and machine agree; "untested" of a row that does not count. "parted" is a
# status, too.
QUIET, PARTED, UNTESTED, NOT_POSSIBLE = "quiet", "parted", "untested", "not possible"
