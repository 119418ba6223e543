from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from reference.diagnosed import BED, OUTPUT, UNDECIDED, diagnosed, measured

from thermaltool.diagnosis.action import action_of
from thermaltool.diagnosis.result import Cause, Location
from thermaltool.diagnosis.severity import Severity
from thermaltool.effects.unknown import Unknown
from thermaltool.report.diagnosis import summary
from thermaltool.report.diagnosis_figures import draw_curves, draw_evidence, pictures
from thermaltool.report.diagnosis_markdown import to_markdown
from thermaltool.report.diagnosis_tables import sections
from thermaltool.report.diagnosis_verdict import main_output, percents
from thermaltool.report.diagnosis_words import duration, estimated, number, percent
from thermaltool.units import printed


def document(causes=1, verdict="not adequate", validated=(), **changed):
    log = measured()
    found = diagnosed([log], causes, verdict).document()
    files = {"model": "model.json", "logs": [{"name": "in/run.csv", "sha256": log.digest}]}
    files["calibrated_on"] = files["sound"] = []
    files["validated_on"] = [{"name": name, "sha256": name} for name in validated]
    # As a reader of the JSON has it.
    return json.loads(json.dumps({**found, **files, **changed}, allow_nan=False))


def curves(name="in/run.csv", extended=True, shift=0.0):
    ((output, record),) = diagnosed([measured()], causes=int(extended)).curves
    columns = {**record.columns, "measured": record.column("measured") + shift}
    return output, replace(record, name=name, columns=columns)


def test_contract_of_the_issue():
    found = document()
    assert found["adequate"] is False
    assert found["noise_share"] == 0.12
    cause = found["causes"][0]
    assert (cause["name"], cause["channel"], cause["evidence"]) == ("second_source", BED, 552.0)
    assert cause["parameters"]["time_constant"] == {
        "value": 840.0, "interval": [800.0, 880.0], "unit": "s",
    }  # fmt: skip
    gain = cause["gain"][OUTPUT]
    assert (gain["rms_before"], gain["rms_after"], gain["interval"]) == (16.4, 6.1, [9.1, 11.3])
    alternative = found["alternatives"][0]
    assert alternative["names"] == ["second_source", "ambient_drift"]
    assert alternative["separating_experiment"].startswith("the bed alone")


def test_a_few_lines_for_a_new_user():
    verdict, where, cause, severe, action, worth, unknown = summary(document())
    # The squares add up: noise and what the calibration left have 12 % together.
    assert verdict == (
        "The model is not adequate for run.csv: of the residual of d_z_um, 11.4 µm RMS, noise is "
        "0.5 µm (< 1 % of the power), what the calibration left 3.92 µm (12 %) and the rest "
        "10.7 µm (88 %)."
    )
    # The bed comes on when the lamp goes off, at 3 h, and stays.
    assert re.match(r"It is wrong mostly while Q_main_1 is at 0 \(.* of the misfit in 50 %", where)
    # More than the 11.4 of all rows about their mean would have.
    worst = (
        r"; worst from 3\.\d+ to 6 h \(\d+(\.\d)? µm RMS from the level at which the log begins\)"
    )
    assert re.search(rf"slower than .*{worst}\.$", where)
    assert cause == (
        "Cause: second_source (T_bed_degC), heat enters from somewhere that the model does not "
        "know: gain[d_z_um] 0.6 (0.59 to 0.63) µm/°C, time_constant 840 (800 to 880) s; "
        "evidence 552 (decisive)."
    )
    assert severe == "Severity: it moves d_z_um by up to 24 µm (15 µm RMS over its rows)."
    assert action == (
        "To do: look at what warms with T_bed_degC: it adds 0.6 µm/°C to d_z_um; insulate it, or "
        "leave the column in every log so that the model follows it."
    )
    assert worth == (
        "On run.csv, the written model takes the residual of d_z_um from 16 to 6 µm RMS, the "
        "zero of each log free (20 to 10 µm as simulate counts); these rows it has seen, held out "
        "in turn they go from 18 to 7."
    )
    assert unknown == (
        "Not known: second_source (T_bed_degC) cannot be told from ambient_drift in this log; "
        "to tell them apart: the bed alone, lamp off, for 2 h."
    )


def test_of_several_logs_the_worst_is_named():
    found = document()
    other = {"name": "in/monday.csv", "sha256": "monday"}
    found["logs"].append(other)
    found["residuals"][OUTPUT]["log"] = "monday"
    assert "of the residual of d_z_um in monday.csv, 11.4 µm RMS" in summary(found)[0]
    (table,) = [each for each in sections(found) if each.title == "What the model gets wrong"]
    assert (table.rows[0][1], table.rows[1][1]) == ("worst in", "monday.csv")


def test_severity_against_a_tolerance():
    log = measured()
    files = {"model": "m", "calibrated_on": [], "sound": [], "validated_on": []}
    files["logs"] = [{"name": "run.csv", "sha256": log.digest}]

    def told(tolerance):
        found = diagnosed([log]).document({OUTPUT: tolerance})
        assert found["tolerance"] == {OUTPUT: tolerance}
        return summary({**found, **files})[3], {**found, **files}

    line, found = told(10.0)
    assert line == (
        "Severity: it moves d_z_um by up to 24 µm (15 µm RMS over its rows), 2.4 times the "
        "tolerance of 10 µm."
    )
    assert found["causes"][0]["severity"][OUTPUT] == {
        "largest": 24.0, "rms": 15.0, "tolerance": 10.0, "times_tolerance": 2.4,
    }  # fmt: skip
    assert told(30.0)[0].endswith(", within the tolerance of 30 µm.")
    rows = next(s.rows for s in sections(found) if s.title.startswith("How severe"))
    assert rows[1] == ["second_source (T_bed_degC)", OUTPUT, "µm", "24", "15", "10", "2.4"]


def values(**parameters):
    return {
        name.replace("__", "[", 1) + ("]" if "__" in name else ""): {
            "value": value, "interval": None, "unit": unit
        }
        for name, (value, unit) in parameters.items()
    }  # fmt: skip


def test_a_loss_of_heat_is_told_by_what_it_does_in_the_long_run():
    """Nine gains and more: what moves most comes first, the rest is in the table."""
    found = document()
    severity = found["causes"][0]["severity"][OUTPUT]
    gains = {"T_a_degC": (-0.05, -0.2, 0.01), OUTPUT: (0.1, -0.5, -2.0), "d_b_um": (1.0, 0, 0),
             "d_c_um": (0.1, 0.0, 0.0)}  # fmt: skip
    given = {
        f"{lag}__{output}": (gains[output][k], "µm/K")
        for k, lag in enumerate(("fast", "middle", "slow"))
        for output in reversed(gains)
    }
    moved = zip(gains, (90.0, 30.0, 9.0, 3.0), strict=True)
    cause = {
        **found["causes"][0],
        "name": "switching_loss", "partner": "T_motor_degC",
        "parameters": values(**given, on=(46.5, "degC"), time_constant=(60.0, "s"),
                             slowest=(6000.0, "s")),
        "severity": {o: {**severity, "largest": size} for o, size in moved},
    }  # fmt: skip
    line = summary({**found, "causes": [cause]})[2]
    assert ": on 46.5 °C, each degree that T_motor_degC is warm moves in the long run " in line
    assert (
        "T_a_degC by -0.24 °C (mostly through a lag of 10 min), d_z_um by -2.4 µm (100 min), "
        "d_b_um by 1 µm (60 s) and others (d_c_um) by what is below; evidence 552" in line
    )


def test_gains_of_many_outputs_are_told_of_those_that_move_most():
    found = document()
    severity = found["causes"][0]["severity"][OUTPUT]
    outputs = ["d_a_um", "d_b_um", "d_c_um", OUTPUT]
    cause = {
        **found["causes"][0],
        "parameters": values(**{f"gain__{o}": (k, "") for k, o in enumerate(outputs)},
                             time_constant=(60.0, "s")),
        "severity": {o: {**severity, "largest": 1.0 + k} for k, o in enumerate(outputs)},
    }  # fmt: skip
    line = summary({**found, "causes": [cause]})[2]
    told = "gain[d_z_um] 3, gain[d_c_um] 2, gain[d_b_um] 1, time_constant 60 s, less of d_a_um"
    assert f": {told} (below); evidence" in line


def test_unseen_logs_are_named():
    found = document(validated=["in/evening.csv"])
    found["written"] += [{**row, "log": "in/evening.csv", "rmse": 9.0 - row["step"],
                          "rmse_zero_free": 5.0 - row["step"]}
                         for row in found["written"]]  # fmt: skip
    assert summary(found)[5] == (
        "On evening.csv, the written model takes the residual of d_z_um from 5 to 4 µm RMS, the "
        "zero of each log free (9 to 8 µm as simulate counts)."
    )


def test_a_cause_of_one_log_is_worth_nothing_on_another():
    found = document(validated=["in/evening.csv"])
    digest = found["logs"][0]["sha256"]
    found["causes"][0]["log"] = digest
    rest = {"log": "in/evening.csv", "rmse": 9.0, "rmse_zero_free": 5.0}
    found["written"] += [{**row, **rest} for row in found["written"]]
    assert "On evening.csv it changes nothing: it belongs to run.csv alone." in summary(found)
    rows = next(s.rows for s in sections(found) if s.title.startswith("What knowing"))
    assert rows[1][1] == "run.csv"


def test_several_causes():
    found = document()
    second = json.loads(json.dumps(found["causes"][0]))
    second.update(name="sensor_gain", channel=OUTPUT, log=found["logs"][0]["sha256"])
    last = {**found["written"][-1], "step": 2, "rmse": 3.0, "rmse_zero_free": 2.0}
    found["written"].append(last)
    lines = summary({**found, "causes": [found["causes"][0], second]})
    assert [line.split(":")[0] for line in lines[2:8:3]] == ["Cause 1 of 2", "Cause 2 of 2"]
    assert ", in run.csv alone: " in lines[5]
    # One chain, from the model that came in to the file that is written.
    assert "of d_z_um from 16 to 6 to 2 µm RMS" in lines[8]
    assert "(20 to 10 to 3 µm as simulate counts)" in lines[8]
    many = summary({**found, "causes": [found["causes"][0]] * 5})
    assert "Further causes: second_source (T_bed_degC), second_source (T_bed_degC)." in many


def test_a_gain_that_is_not_sure_is_not_claimed():
    found = document()
    gain = found["causes"][0]["gain"][OUTPUT]
    gain.update(interval=[-0.2, 0.4], claimed=False)
    assert summary(found)[5].endswith("; the gain is not sure.")
    rows = next(s.rows for s in sections(found) if s.title.startswith("What knowing"))
    assert rows[1][6] == "-0.2 to 0.4, not claimed"


def test_the_output_that_gains_most_is_told():
    found = document()
    cause = found["causes"][0]
    cause["gain"]["d_x_um"] = {**cause["gain"][OUTPUT], "claimed": False}
    found["written"] += [{**row, "output": "d_x_um", "rmse_zero_free": 5.0 / (1 + 9 * row["step"])}
                         for row in found["written"]]  # fmt: skip
    worth = summary(found)[5]
    assert "of d_x_um from 5 to 0.5 µm" in worth
    assert worth.endswith("; the gain is not sure.")


def test_every_log_has_its_line_by_every_model():
    rows = next(s.rows for s in sections(document()) if s.title.startswith("The written model"))
    assert rows[1:] == [
        ["as it came", "run.csv (diagnosed)", OUTPUT, "µm", "20", "12", "16", "71"],
        [
            "+ second_source (T_bed_degC)",
            "run.csv (diagnosed)",
            OUTPUT,
            "µm",
            "10",
            "8",
            "6",
            "91",
        ],
    ]


def test_a_model_that_spoils_a_log_is_told():
    assert "is not to be used" in summary(document(spoiled="d_z_um in other.csv"))[6]


def test_misfit_without_a_cause():
    lines = summary(document(causes=0))
    assert lines[2] == "Cause: none in the catalogue explains it."
    assert lines[3].startswith("The nearest in the catalogue is second_source (T_bed_degC)")
    assert lines[4] == "Not known: this log cannot show transport_delay."


def test_cannot_judge():
    """What would help is told, and no cause is missed."""
    verdict, where, why, *rest = summary(document(causes=0, verdict="cannot judge"))
    assert verdict.startswith("The model cannot be judged by run.csv: of the residual of")
    assert where.startswith("It is wrong mostly while")
    assert why == f"{UNDECIDED}."
    assert not any(line.startswith("Cause") for line in rest)


def test_what_no_cause_explains_has_its_place():
    found = document(causes=0)
    place = Location("x", OUTPUT, 3600.0, 7200.0, "heating", 600.0, 1800.0, 3.2)
    unknown, severity = Unknown(OUTPUT, {"rms": 3.0}), {OUTPUT: Severity(5.0, 3.2)}
    action = action_of(unknown, severity, {}, place)
    cause = Cause(
        unknown, 140.0, {}, {}, 0.0, location=place, severity=severity, action=action
    ).document({})
    _, _, line, severe, to_do, nearest, *_ = summary({**found, "causes": [cause]})
    assert line == (
        "Cause: unknown (d_z_um), no cause of the catalogue explains what is left: 3.2 µm RMS, "
        "mostly while heating, most from 60 to 120 min, 10 min to 30 min; evidence 140."
    )
    assert severe == ("Severity: d_z_um is off by 3.2 µm RMS, by 5 µm RMS where it is worst.")
    assert to_do.startswith(
        "To do: look at the machine where d_z_um is off, from 60 min to 120 min into the log, "
        "mostly while heating: log whatever else changes then"
    )
    assert nearest.startswith("The nearest")


def gains(before, after):
    return {OUTPUT: {**document()["causes"][0]["gain"][OUTPUT], "rms_before": before,
                     "rms_after": after}}  # fmt: skip


def test_outliers_are_worth_what_leaving_them_out_is():
    """They are in every log that the written model is run over, which tells nothing of them."""
    found = document()
    source = {**found["causes"][0], "gain": gains(6.0, 2.0)}
    outliers = {**source, "name": "outliers", "channel": OUTPUT, "parameters": {}, "action": "",
                "gain": gains(422.0, 6.0)}  # fmt: skip
    alone = [{**row, "rmse_zero_free": 422.0, "rmse": 430.0} for row in found["written"]]
    lines = summary({**found, "causes": [outliers], "written": alone})
    assert "Without these readings the residual of d_z_um is 6 µm RMS, not 422." in lines
    assert not any("written model" in line for line in lines)
    both = summary({**found, "causes": [outliers, source], "written": alone})
    told = [line for line in both if "written model" in line]
    assert told[0].startswith(
        "On run.csv, they left out, the written model takes the residual of d_z_um from 6 to 2 µm"
    )
    assert not any("422 to" in line for line in both)


def test_a_cause_that_is_no_part_of_a_model_is_no_step_of_the_chain():
    found = document()
    first = {**found["causes"][0], "name": "record_too_short", "gain": {}}
    rows = [found["written"][0], {**found["written"][0], "step": 1}]
    rows.append({**found["written"][-1], "step": 2})
    lines = summary({**found, "causes": [first, found["causes"][0]], "written": rows})
    assert any("of d_z_um from 16 to 6 µm RMS" in line for line in lines)


def residual_of(noise, calibration, rest):
    parts = {"rms": 1.0, "noise": noise**0.5, "calibration": calibration**0.5, "rest": rest**0.5}
    return {OUTPUT: {**document()["residuals"][OUTPUT], "parts": parts}}


def test_not_adequate_where_most_is_noise_is_no_contradiction():
    found = document(noise_share=0.7, residuals=residual_of(0.15, 0.55, 0.3))
    assert summary(found)[0] == (
        "The model is not adequate for run.csv: of the residual of d_z_um, 1 µm RMS, noise is "
        "0.387 µm (15 % of the power), what the calibration left 0.742 µm (55 %) and the rest "
        "0.548 µm (30 %), which has a cause."
    )


def test_parts_that_are_not_there_are_not_told():
    found = document(causes=0, noise_share=0.0, residuals=residual_of(0.36, 0.0, 0.64))
    assert summary(found)[0].endswith(
        "noise is 0.6 µm (36 % of the power) and the rest 0.8 µm (64 %)."
    )
    found = document(causes=0, verdict="adequate", residuals=residual_of(1.0, 0.0, 0.0))
    assert summary(found)[0].endswith("1 µm RMS, noise is 1 µm (100 % of the power).")


def test_percentages_add_up_as_printed():
    assert percents([0.335, 0.335, 0.33]) == ["34 %", "33 %", "33 %"]
    assert percents([0.004, 0.555, 0.441]) == ["< 1 %", "56 %", "44 %"]
    assert percents([1.0, 0.0, 0.0]) == ["100 %", "0 %", "0 %"]


def test_causes_that_differ_are_not_said_to_look_alike():
    """An angle near 90° is no reason to tell two causes apart by an experiment alone."""
    found = document()
    other = {**found["alternatives"][0], "angle_deg": 88.0}
    assert summary({**found, "alternatives": [other]})[-1] == (
        "Not sure: ambient_drift has as much evidence as second_source (T_bed_degC); to find out: "
        "the bed alone, lamp off, for 2 h."
    )
    rows = next(s.rows for s in sections({**found, "alternatives": [other]})
                if s.title.startswith("What else"))  # fmt: skip
    assert rows[1][:3] == ["as likely", "second_source (T_bed_degC) / ambient_drift", "88°"]
    rows = next(s.rows for s in sections(found) if s.title.startswith("What else"))
    assert rows[1][0] == "look alike"


def test_channels_that_the_residual_does_not_follow_are_left_out():
    found = document()
    report = found["residuals"][OUTPUT]
    room = {**report["conditions"][-1], "channel": "T_room_degC", "name": "20 to 21",
            "power": 1.0, "time": 0.3}  # fmt: skip
    report["conditions"] = [room]
    report["dependences"] = [
        {"channel": "T_room_degC", "lag": [0.0, 0.0], "correlation": 0.3, "bound": 0.4,
         "p_value": 0.2},
    ]  # fmt: skip

    def shown():
        titles = [s.title for s in sections(found)]
        return "T_room_degC" in summary(found)[1], [t for t in titles if "follows" in t]

    assert shown() == (False, [])
    report["dependences"][0]["correlation"] = -0.5
    assert shown() == (True, ["Inputs that the residual follows, now or later"])


def test_what_an_unknown_cause_explains_is_nothing_to_tell():
    found = document(causes=0)
    place = Location("x", OUTPUT, 3600.0, 7200.0, None, 600.0, 1800.0, 3.2)
    cause = Cause(Unknown(OUTPUT, {"rms": 3.0}), 140.0, {}, {}, 0.0, location=place).document({})
    rows = next(s.rows for s in sections({**found, "causes": [cause]}) if s.title == "Causes")
    assert rows[1][3] == "–"


def test_what_is_ruled_out():
    entry = {"name": "radiation", "channel": OUTPUT, "output": OUTPUT, "above": 0.5,
             "matters": 5.0, "odds": 55.0}  # fmt: skip
    found = document(ruled_out=[entry, {**entry, "name": "sensor_gain", "odds": 1000.0}])
    told = [line for line in summary(found) if line.startswith("Ruled out")]
    assert told == [
        "Ruled out: radiation (d_z_um), sensor_gain (d_z_um); this log would have shown half the "
        "residual of each and did not."
    ]
    rows = next(s.rows for s in sections(found) if s.title.startswith("Ruled out"))
    assert rows[1] == ["radiation", OUTPUT, "0.5 µm of d_z_um", "5 µm", "55 to 1"]
    assert rows[2][-1] == "> 1000 to 1"
    many = summary({**found, "ruled_out": [entry] * 6, "tolerance": {OUTPUT: 5.0}})
    assert any(
        "and 2 more; this log would have shown half the tolerance of each" in x for x in many
    )
    mixed = summary({**found, "tolerance": {OUTPUT: 5.0},
                     "ruled_out": [entry, {**entry, "output": "T_a_degC"}]})  # fmt: skip
    assert any("of each, or of the residual where there is none, and did" in x for x in mixed)


def test_adequate():
    verdict, nothing, blind = summary(document(causes=0, verdict="adequate"))
    assert verdict.startswith("The model is adequate for run.csv: of the residual of d_z_um")
    assert "left 10.8 µm (90 %) and the rest 3.61 µm (10 %)." in verdict
    assert nothing == "No effect found: 3 causes were tried and none adds anything."
    assert blind == "Not known: this log cannot show transport_delay."
    found = document(causes=0, verdict="adequate")
    found["tried"] = [{**each, "verdict": "evidence"} for each in found["tried"]]
    assert "none stands (second_source (T_bed_degC) has evidence of 552 alone" in summary(found)[1]


def test_notes_are_told():
    assert summary(document(notes=["calibrate again"]))[-1] == "Note: calibrate again."


def test_numbers():
    assert [number(x) for x in (None, 0.01234, 1234.5, -1234.5, 3e7)] == [
        "–", "0.0123", "1234", "-1234", "3e+07",
    ]  # fmt: skip
    assert [percent(x) for x in (0.0, 1e-9, 0.125, 0.9999, 1.0)] == [
        "0 %", "< 1 %", "12 %", "> 99 %", "100 %",
    ]  # fmt: skip
    assert [printed(u) for u in ("um/degC", "um/1", "1", "1/K", "s")] == [
        "µm/°C", "µm", "", "1/K", "s",
    ]  # fmt: skip
    assert [duration(s) for s in (0.5, 90, 1800, 9000)] == ["0.5 s", "90 s", "30 min", "2.5 h"]


def test_every_row_of_a_table_has_its_cells():
    for causes in (0, 1):
        for section in sections(document(causes)):
            assert {len(row) for row in section.rows} == {len(section.rows[0])}
    assert "Causes" not in [section.title for section in sections(document(causes=0))]


def test_markdown():
    text = to_markdown(document(), [("why d_z_um.png", "curves")])
    assert text.startswith("# model.json on run.csv\n\nThe model is not adequate for run.csv")
    assert "![curves](<why d_z_um.png>)" in text
    assert "| second\\_source | T\\_bed\\_degC | 552 | 90 % | gain[d\\_z\\_um] | 0.6 |" in text
    assert "- diagnosed: `in/run.csv`, SHA-256 `digest-4`" in text
    for line in text.splitlines():
        if line.startswith("|"):
            assert line.endswith(" |")


def test_curves_before_and_after():
    top, bottom = draw_curves(*curves(), document()).axes
    assert [line.get_label() for line in top.lines] == [
        "measured", "model as it is", "model with\nsecond_source",
    ]  # fmt: skip
    before, after = bottom.lines[:2]
    assert np.std(before.get_ydata()) > 10
    assert np.std(after.get_ydata()) == pytest.approx(0.5, rel=0.1)
    assert re.search(r"before 11\.\d µm, after 0\.\d+ µm$", bottom.get_title())
    assert bottom.get_xlabel() == "time [h]"


def test_curves_without_a_cause():
    top, bottom = draw_curves(*curves(extended=False), document(causes=0)).axes
    assert len(top.lines) == 2
    assert "after" not in bottom.get_title()


def test_a_shift_of_zero_is_drawn_as_none():
    after = draw_curves(*curves(shift=50.0), document()).axes[1].lines[1].get_ydata()
    assert abs(np.mean(after)) < 0.1


def test_evidence_chart():
    ax = draw_evidence(document()).axes[0]
    assert [label.get_text() for label in ax.get_yticklabels()] == [
        "second_source (T_bed_degC)", "ambient_drift", "transport_delay (Q_main_1)",
    ]  # fmt: skip
    assert [bar.get_width() for bars in ax.containers for bar in bars] == [552, 119, -7.1]
    assert ax.get_legend_handles_labels()[1] == ["decisive from 10", "accepted", "not accepted"]


@pytest.mark.slow
def test_pictures_are_few_and_named_apart():
    several = [curves(f"in/run{k}.csv") for k in range(8)]
    made = list(pictures(several, document()))
    assert len(made) == 7
    assert len({picture.name for picture in made}) == 7
    assert made[0].name == "d_z_um_run0"
    assert all(picture.png.startswith(b"\x89PNG") for picture in made)
    single = list(pictures([curves()], document(tried=[])))
    assert [picture.name for picture in single] == ["d_z_um"]


def test_the_worst_output_is_told_first():
    """The one that `noise_share` is of: noise and calibration account for least of it."""
    found = {"d_a_um": residual_of(0.5, 0.4, 0.1)[OUTPUT], **residual_of(0.6, 0.2, 0.2)}
    assert main_output(document(residuals=found)) == OUTPUT


@pytest.mark.parametrize(
    ("value", "ends", "told"),
    [
        (1.0181, (1.0169, 1.0193), ["1.018", "1.017", "1.019"]),
        (0.42, (0.31, 0.55), ["0.42", "0.31", "0.55"]),
        (12.6, (5.23, 19.9), ["12.6", "5.23", "19.9"]),
        (58.25, (58.21, 58.29), ["58.25", "58.21", "58.29"]),
        (0.5, (0.0, 1e300), ["0.5", "0", "∞"]),
        (3.0, None, ["3"]),
    ],
)
def test_an_interval_has_as_many_digits_as_tell_its_ends_apart(value, ends, told):
    assert estimated(value, ends) == told
