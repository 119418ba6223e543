"""What a stream writes whose model is refused: the names of its set points, and the safe line."""

from __future__ import annotations

import contextlib
import json
import re
from pathlib import Path
from typing import Any

from thermaltool.documents import CONTROLLER
from thermaltool.runtime.compensation import setpoint_name
from thermaltool.runtime.pipe import LinePipe
from thermaltool.runtime.settings import Settings
from thermaltool.runtime.sinks import open_sink
from thermaltool.status import ALARM, SAFE, STATUS, UNTESTED

# In a file that is no JSON any more: outputs that measure a displacement.
DEFLECTION = re.compile(r'"channel":\s*"(d_[^"\\]+)"')
# And drives that a controller sets.
CONTROL = re.compile(r'"channel":\s*"([^"\\]+)",\s*"maximum"')

# Words of a line that rests on nothing.
UNKNOWN = {STATUS: SAFE, ALARM: UNTESTED}


def refused_setpoints(path: str, heater: str | None) -> list[str]:
    """Names of the set points of a model that cannot be run, as far as its file shows them.

    Parameters
    ----------
    path : str
    heater : str or None
        The drive that is set in place of offsets.
    """
    if heater is not None:
        return [heater]
    text = ""
    with contextlib.suppress(OSError, ValueError):
        text = Path(path).read_text(encoding="utf-8", errors="replace")
    with contextlib.suppress(ValueError, RecursionError, TypeError, KeyError, AttributeError):
        document = json.loads(text)
        if CONTROLLER.matches(document):
            heaters = [drive["channel"] for drive in document["control"]]
            return [*heaters, *map(setpoint_name, document.get("axes", {}))]
        return [
            setpoint_name(o["channel"])
            for o in document["outputs"]
            # The contact by which a joint is told has none.
            if o["role"] == "deflection" and not o["fit"].get("contact")
        ]
    if CONTROLLER.name in text:
        return list(dict.fromkeys(CONTROL.findall(text)))
    return [setpoint_name(name) for name in dict.fromkeys(DEFLECTION.findall(text))]


def write_safe_line(names: list[str], settings: Settings, source: int, sink: int) -> None:
    """Header and safe set points: all that a stream without a model has to say.

    Parameters
    ----------
    names : list of str
        Nothing is written where it is empty.
    settings : Settings
    source, sink : int
        File descriptors.
    """
    if not names:
        return
    with LinePipe(source, sink) as pipe:
        values: list[Any] = [(settings.safe or 0.0) + 0.0] * len(names)
        for name in settings.template_fields(names):
            # Of what is estimated nothing is known.
            names, values = [*names, name], [*values, UNKNOWN.get(name, 0.0)]
        out = open_sink(settings.to_format, pipe, **settings.sink_options(names))
        out.open(("time_s", *names))
        # Where the last set point is to be held, no line holds it.
        if settings.safe is not None and settings.end != "hold":
            out.write([(None, values)])
        out.close()
