from __future__ import annotations

import json

import pytest

from thermaltool.errors import LogError, ModelError
from thermaltool.model import dumps
from thermaltool.report.content import Content, is_document, read_document, read_table
from thermaltool.report.figure import draw

TABLES = {
    "log": "time_s,T_a_degC,offset_degC\n0,1,2\n1,2,3\n",
    "kernel": "time_s,weight_1,A0_1,A1_s\n0,1,5,6\n1,2,5,6\n",
    "inversion": "time_s,value_1,error_1\n1,1,0\n2,2,0\n",
    "simulation": "time_s,T_a_degC,residual_T_a_degC\n0,1,0\n1,2,0\n",
    "setpoints": "time_s,offset_x_um\n0,1\n1,2\n1,0\n",
}


@pytest.mark.parametrize("kind", TABLES)
def test_tables_by_their_columns(tmp_path, kind):
    path = tmp_path / "a.csv"
    path.write_text(TABLES[kind].replace("offset_degC", "U_V"))
    assert not is_document(str(path))
    content = read_table(str(path), {})
    assert content.kind == kind
    assert draw([content]).axes


def test_beside_a_model_a_table_is_a_log_or_a_kernel(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(TABLES["setpoints"])
    with pytest.raises(LogError, match="no column Q_1"):
        read_table(str(path), {}, ["Q_1"])
    assert read_table(str(path), {}, ["offset_x_um"]).kind == "log"
    path.write_text(TABLES["kernel"])
    assert read_table(str(path), {}, ["Q_1"]).kind == "kernel"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,T_a_degC\n", "no rows: nothing to draw"),
        ("time_s,value_1,error_1\n0,1,0\n1,x,0\n", "a.csv:3: value_1: not a number: 'x'"),
        ("time_s,T_a_degC\n0,1\n,2\n", "a.csv:3: time_s: missing time"),
        ("time_s,T_a_degC\n0,1\n0,2\n", "the clock repeats"),
        ("time_s,offset_x_um\n1,1\n0,2\n", "the clock goes backward"),
        ("time_s,offset_x_um\n1,1\nx,1\n", "time_s: not a number: 'x'"),
    ],
)
def test_tables_with_faults(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(LogError, match=message):
        read_table(str(path), {})


DOCUMENTS = {
    "noise": {"format": "thermaltool-noise", "version": 1, "channels": {}},
    "trade-off": {"chosen": "kalman", "forms": {}},
    "kernel": {"time_s": [0], "weight": [1], "A0": 1, "A1_s": 1},
    "inversion": {"time_s": [0], "value_1": [1], "error_1": [1], "wanted": [1]},
}


@pytest.mark.parametrize("kind", DOCUMENTS)
def test_documents_by_their_parts(tmp_path, kind):
    path = tmp_path / "a.json"
    path.write_text("\n " + json.dumps(DOCUMENTS[kind]))
    assert is_document(str(path))
    assert not is_document(str(path), "ndjson")
    assert read_document(str(path)).kind == kind


def test_model(tmp_path, model):
    path = tmp_path / "model"
    path.write_text(dumps(model))
    assert is_document(str(path))
    assert read_document(str(path)).kind == "model"
    path.write_text(dumps(model).replace('"version": 1', '"version": 2'))
    with pytest.raises(ModelError, match="version 2 is newer"):
        read_document(str(path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": 1}', "no figure for this document"),
        ('{"a": 1', "a.json:1: not JSON"),
        ('{"a": 1}\n{"a": 2}\n', "a log of JSON lines: name it .ndjson"),
        ('{"format": "thermaltool-noise", "version": 2}', "version 2 is newer"),
    ],
)
def test_documents_with_faults(tmp_path, text, message):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(LogError, match=message):
        read_document(str(path))


def test_what_makes_no_figure_together(model):
    contents = [Content("model", "m", model), Content("noise", "n", {})]
    with pytest.raises(LogError, match=r"no figure of m \(model\) and n \(noise\)"):
        draw(contents)


def test_a_document_that_lacks_a_part():
    with pytest.raises(LogError, match="n: 'channels' is missing"):
        draw([Content("noise", "n", {})])
