"""The state of a stream on disk."""

from __future__ import annotations

import math
import shutil
import threading
from contextlib import contextmanager
from pathlib import Path

from thermaltool.runtime.restart import checkpoint
from thermaltool.runtime.restart.checkpoint import Checkpoint
from thermaltool.runtime.rows.row import Row


def test_a_slow_disk_ends_with_the_newest_state(tmp_path, monkeypatch):
    go_on, written = threading.Event(), []
    whole = checkpoint.atomic_output

    @contextmanager
    def slow(path):
        assert go_on.wait(20)
        with whole(path) as stream:
            yield stream
        written.append(path)

    monkeypatch.setattr(checkpoint, "atomic_output", slow)
    kept = Checkpoint(str(tmp_path / "state.json"), "digest")
    for k in range(5):
        kept.save({"k": k})
    go_on.set()
    kept._writer.join(20)
    assert kept.load().state == {"k": 4}
    assert len(written) == 2


def test_a_checkpoint_of_an_earlier_release_goes_on_without_a_step(compensator, tmp_path):
    """Written by the first release, after 200 rows of one second in steps of 0.5 um."""

    def setpoints(each, start, stop):
        given = []
        for k in range(start, stop):
            each.take(Row(float(k), [round(5 * -math.expm1(-k / 30), 9)], ("",)))
            given.append(each.values())
        return given

    kept = shutil.copy(Path(__file__).with_name("checkpoint_1.json"), tmp_path / "state.json")
    whole, resumed = compensator(step=0.5), compensator(step=0.5)
    expected = setpoints(whole, 0, 400)[200:]
    resumed.resume(Checkpoint(str(kept), resumed.digest).load().state)
    assert resumed.time == 199.0
    assert setpoints(resumed, 200, 400) == expected
    # How often readings repeat was not kept then.
    each, other = (one.state()["sensors"] for one in (resumed, whole))
    assert [{**s, "frozen": 0} for s in each] == [{**s, "frozen": 0} for s in other]
