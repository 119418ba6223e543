"""The state of a stream on disk."""

from __future__ import annotations

import threading
from contextlib import contextmanager

from thermaltool.runtime import checkpoint
from thermaltool.runtime.checkpoint import Checkpoint


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
    assert kept.load() == {"k": 4}
    assert len(written) == 2
