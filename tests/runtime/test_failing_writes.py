"""A disk or a sink that fails at any system call: what leaves still makes no step."""

import errno
import os

import numpy as np
import pytest
from faults.streams import HEADER_OF, check, read_out, run_stream, warming

from thermaltool.errors import ThermalToolError

CALLS = ("open", "pwrite", "pread", "fsync", "replace", "link", "unlink", "write", "fstat", "stat")
ROWS = 120


def lines():
    readings = warming(np.random.default_rng(1), 1, ROWS)
    rows = [b"%g,%.3f" % (0.5 * k, x) for k, (x,) in enumerate(readings)]
    return b"\n".join([HEADER_OF[1], *rows]) + b"\n"


@pytest.fixture(scope="module")
def text():
    return lines()


@pytest.mark.parametrize("reason", [errno.ENOSPC, errno.EIO])
@pytest.mark.parametrize("name", CALLS)
def test_a_call_that_fails_makes_no_step(tmp_path, monkeypatch, text, name, reason):
    """The k-th call of one kind fails, and all after it: k from the first to the last."""
    whole, calls = getattr(os, name), 0

    def counted(*arguments, **keywords):
        nonlocal calls
        calls += 1
        if first <= calls:
            raise OSError(reason, os.strerror(reason))
        return whole(*arguments, **keywords)

    first, before = 1, None
    while first <= 12:
        calls = 0
        failed = False
        with monkeypatch.context() as patched:
            patched.setattr(os, name, counted)
            try:
                out = run_stream(text, tmp_path, 1, True, None)
            except ThermalToolError:
                failed = True
        if failed:
            out = read_out(tmp_path)
        # A sink that failed takes no safe line.
        assert not check(out, before, ends=name != "write"), (first, name)
        before = out[-1][1] if out else None
        if calls < first:
            break
        first += 1
    assert first > 1 or calls == 0
