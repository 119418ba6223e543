import os

from thermaltool.runtime.line_writer import MAX_WAITING, LineWriter


def test_lines_that_were_dropped_are_counted_once_there_is_room():
    read, write = os.pipe()
    writer = LineWriter(write)
    # More than the pipe and the queue hold: 200 bytes a line, 64 KiB the pipe.
    total = 2 * MAX_WAITING
    for k in range(total):
        writer.write(f"{k:06d}" + "." * 193)
    dropped = writer.dropped
    assert 0 < dropped < total
    got = b""
    while got.count(b"\n") < total - dropped:
        got += os.read(read, 65536)
    writer.write("again")
    writer.close()
    os.close(write)
    while part := os.read(read, 65536):
        got += part
    os.close(read)
    lines = got.decode().splitlines()
    assert [int(line[:6]) for line in lines[:-2]] == list(range(total - dropped))
    assert lines[-2:] == [f"{dropped} messages dropped: nobody took them", "again"]
