import os

from thermaltool.runtime.line_writer import MAX_WAITING, LineWriter


def test_lines_that_were_dropped_are_counted_once_there_is_room():
    read, write = os.pipe()
    writer = LineWriter(write)
    # More than the pipe and the queue hold: 200 bytes a line, 64 KiB the pipe.
    total = 2 * MAX_WAITING
    for k in range(total):
        writer.write(f"{k:06d}" + "." * 193)
    assert 0 < writer.dropped < total
    got = b""
    while got.count(b"\n") < total - writer.dropped:
        got += os.read(read, 65536)
    writer.write("again")
    writer.close()
    os.close(write)
    while part := os.read(read, 65536):
        got += part
    os.close(read)
    *lines, last = got.decode().splitlines()
    assert last == "again"
    # The writer may find room while others are still being dropped: then it says so more than once.
    reports = [line for line in lines if "dropped" in line]
    said = [int(line.removesuffix(" messages dropped: nobody took them")) for line in reports]
    numbers = [int(line[:6]) for line in lines if "dropped" not in line]
    assert sum(said) == writer.dropped == total - len(numbers)
    assert numbers == sorted(set(numbers))
