"""``thermaltool check``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

SOUND = "time_s,T_a_degC\n" + "".join(f"{2 * i},{20 + i / 7}\n" for i in range(50))
BAD = "# c\ntime_s,T_a_degC,T_b_degF\n0,--,1\n1,-300,2\n2,1\n1.5,3,4\n"


@pytest.fixture
def check(thermaltool):
    def run(*arguments: str, log: str = ""):
        return thermaltool("check", *arguments, stdin=log)

    return run


def test_a_sound_log(check) -> None:
    result = check(log=SOUND)
    assert result.code == 0
    assert result.out.splitlines()[0] == "<stdin>: 50 rows, 98 s, 1 segment"
    assert result.out.splitlines()[-1] == "nothing wrong"
    assert result.err == ""


def test_everything_wrong_is_told_in_one_run(check) -> None:
    result = check(log=BAD)
    assert result.code == 3
    lines = result.out.partition("wrong:\n")[2].splitlines()
    for start in (
        "<stdin>:2: T_b_degF: unknown unit 'degF'",
        "<stdin>:3: T_a_degC: not a number: '--'",
        "<stdin>:5: 2 cells where the header has 3",
        "<stdin>:4: T_a_degC: -300 degC is below absolute zero",
    ):
        assert any(line.startswith(start) for line in lines), start


def test_units_are_listed_once_with_a_cure(check) -> None:
    result = check(log="time_s,T_b_degF,bed.temp,T_a_degC\n0,1,2,3\n")
    assert result.out.count("a name is <quantity>_<place>_<unit>") == 1
    first, second, last = result.out.splitlines()[-3:]
    assert first.startswith("<stdin>:1: T_b_degF: unknown unit 'degF'; a name is")
    assert second == "<stdin>:1: bed.temp: unknown unit 'bed.temp'"
    assert last.startswith("check LOG --write-map MAP.toml drafts a map")


def test_a_backward_clock(check) -> None:
    result = check(log="time_s,T_a_degC\n0,1\n2,1.5\n1,2\n2,2\n")
    assert result.code == 3
    assert "<stdin>:4: time_s: the clock goes backward: 1 s after 2 s" in result.out


def test_json_has_no_nan(check) -> None:
    result = check("--json", log="time_s,T_a_degC\n0,\n")
    assert result.code == 3
    document = json.loads(result.out, parse_constant=lambda word: pytest.fail(word))
    assert document["rows"] == 1
    assert document["clock"]["period"] is None
    assert document["channels"][0]["maximum"] is None
    assert document["findings"] == [
        {"kind": "missing", "message": "missing value", "line": 2, "column": "T_a_degC"}
    ]


def test_header_only(check) -> None:
    result = check(log="time_s,T_a_degC\n")
    assert result.code == 3
    assert "no rows" in result.out


def test_no_log_at_all(check, tmp_path: Path) -> None:
    for result in (check(log=""), check(str(tmp_path)), check(str(tmp_path / "absent.csv"))):
        assert result.code == 1
        assert result.out == ""
        assert result.err.startswith("thermaltool check: ")
        assert result.err.count("\n") == 1


def test_the_log_goes_on_in_the_pipe(check, tmp_path: Path) -> None:
    result = check("-o", "-", "--resample", "1", "--to", "ndjson", log=SOUND)
    assert result.code == 0
    rows = [json.loads(line) for line in result.out.splitlines()]
    assert [row["time_s"] for row in rows] == list(range(99))
    assert rows[1]["T_a_degC"] == pytest.approx(20 + 0.5 / 7)
    assert "nothing wrong" in result.err
    target = tmp_path / "out.parquet"
    result = check("-o", str(target), log=SOUND)
    assert "nothing wrong" in result.out
    assert target.exists()


def test_resample_without_a_place_to_write(check) -> None:
    result = check("--resample", "1", log=SOUND)
    assert result.code == 2
    assert "--resample needs -o" in result.err


def test_a_drafted_map_leaves_typos_to_be_found_and_names_what_it_leaves_out(thermaltool, tmp_path):
    cells = [f"{20 + k / 10:.1f}" for k in range(40)]
    cells[5], cells[20], cells[7], cells[12], cells[30] = "2O.5", "21..5", "n/a", "n/a", "1.#QNAN"
    lines = [f"{10 * k},{cell},{k},ok" for k, cell in enumerate(cells)]
    log, drafted = tmp_path / "bed.csv", tmp_path / "map.toml"
    log.write_text("\n".join(["time_s,bed temp,foo_bar_zorks,note", *lines, ""]))
    result = thermaltool("check", log, "--write-map", drafted)
    assert result.code == 3
    assert f"{log}:7: bed temp: not a number: '2O.5'" in result.out
    assert f"{log}:22: bed temp: not a number: '21..5'" in result.out
    assert f"{drafted} leaves out foo_bar_zorks (no unit known), note (text): " in result.err
    text = drafted.read_text()
    assert 'missing = ["n/a", "1.#QNAN"]' in text
    assert "# typos, for check to find: '2O.5' in bed temp, '21..5' in bed temp\n" in text


def test_the_map_still_goes_with_the_log_that_it_wrote(thermaltool, check, tmp_path, capfd) -> None:
    """The same options serve the log as it came and the one that -o wrote, in a stream, too."""
    log, clean, plan = (tmp_path / name for name in ("log.csv", "clean.csv", "map.toml"))
    log.write_text("Zeit;Fehler\n" + "".join(f"{k};{k * k * k % 11},5\n" for k in range(60)))
    plan.write_text(
        'separator = ";"\ndecimal = ","\n[time]\ncolumn = "Zeit"\n[columns]\n'
        'Fehler = { name = "e_tool_um", scale = 2 }\n'
    )
    assert check(str(log), "--columns", str(plan), "-o", str(clean)).code == 0
    again = check(str(clean), "--columns", str(plan))
    assert again.code == 0
    assert again.out.startswith(f"{clean} has the names that {plan} gives already: read without")
    fitted = thermaltool("fit", clean, "--columns", plan, "-C", "e_tool_um", "--order", "1,0", "-o",
                         tmp_path / "ar.json")  # fmt: skip
    assert fitted.code == 0
    answers = []
    for each in (log, clean):
        options = ("--stream", "--columns", plan)
        assert thermaltool("forecast", tmp_path / "ar.json", each, *options).code == 0
        # A stream writes past the buffers of Python.
        answers.append(capfd.readouterr().out)
    assert answers[0] == answers[1]
    assert answers[0].count("\n") > 50
