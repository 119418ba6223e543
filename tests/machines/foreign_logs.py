"""One plant, a first-order lag by its exact step, in the layouts of ten programs."""

from __future__ import annotations

import json
from datetime import datetime, timedelta
from importlib import import_module
from pathlib import Path

import numpy as np

# Seconds, heat in W, temperature in degC, deflection in um: 0.2 K/W, 3 um/K.
ROWS, LAG = 240, 120.0
TIME = 5.0 * np.arange(ROWS)
HEAT = np.where(TIME >= 100, 100.0, 0.0)
RISE = np.where(TIME >= 100, 20 * -np.expm1(-(TIME - 100) / LAG), 0.0)
TEMPERATURE = 21.5 + RISE + 0.01 * np.random.default_rng().standard_normal(ROWS)
DEFLECTION = 3 * RISE + 0.05 * np.random.default_rng().standard_normal(ROWS)
BEGIN = datetime(2026, 3, 14, 10, 15, 0)
STAMPS = [BEGIN + timedelta(seconds=t) for t in TIME]


def german(folder: Path) -> Path:
    """A workshop logger: cp1252, decimal commas, two lines before the names, units behind them."""
    lines = ["Messprotokoll Spindel Süd", "Gerät: ALMEMO", "Datum;Uhrzeit;Leistung;Lager;Weg;",
             ";;W;°C;µm;"]  # fmt: skip
    for moment, row in zip(STAMPS, zip(HEAT, TEMPERATURE, DEFLECTION, strict=True), strict=True):
        cells = [f"{value:.3f}".replace(".", ",") for value in row]
        lines.append(";".join([f"{moment:%d.%m.%Y}", f"{moment:%H:%M:%S}", *cells, ""]))
    path = folder / "protokoll.csv"
    path.write_bytes("\r\n".join([*lines, ""]).encode("cp1252"))
    return path


def utf_16(folder: Path) -> Path:
    """A text export of Excel: UTF-16 with tabs, stamps without seconds."""
    lines = ["Time\tHeater power (W)\tBearing temperature (°F)\tProbe (mm)"]
    for moment, q, t, d in zip(STAMPS, HEAT, TEMPERATURE, DEFLECTION, strict=True):
        lines.append(f"{moment:%m/%d/%Y %H:%M}\t{q:.1f}\t{1.8 * t + 32:.4f}\t{d / 1000:.6f}")
    path = folder / "export.txt"
    path.write_bytes("\r\n".join([*lines, ""]).encode("utf-16"))
    return path


def lvm(folder: Path) -> Path:
    """A measurement file of LabVIEW."""
    end = "***End_of_Header***"
    head = ["LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab",
            "Decimal_Separator\t,", "Multi_Headings\tNo", "X_Columns\tOne", "Time_Pref\tAbsolute",
            "Operator\tmeister", "Date\t2026/03/14", "Time\t10:15:00,1234567890123", f"{end}\t", "",
            "Channels\t3\t\t\t", f"Samples\t{ROWS}\t{ROWS}\t{ROWS}\t",
            "Date\t2026/03/14\t2026/03/14\t2026/03/14\t", "Time\t" + "10:15:00,1234567890123\t" * 3,
            "Y_Unit_Label\tW\tdeg C\tMicrons\t", "X_Dimension\tTime\tTime\tTime\t",
            "X0\t0,0000000000000000E+0\t0,0000000000000000E+0\t0,0000000000000000E+0\t",
            "Delta_X\t5,000000\t5,000000\t5,000000\t", f"{end}\t\t\t\t",
            "X_Value\tHeater\tBearing\tProbe Z\tComment"]  # fmt: skip
    rows = zip(TIME, HEAT, TEMPERATURE, DEFLECTION, strict=True)
    body = ["\t".join(f"{value:.6f}".replace(".", ",") for value in row) for row in rows]
    path = folder / "test_001.lvm"
    path.write_text("\r\n".join([*head, *body, ""]))
    return path


def tdms(folder: Path) -> Path:
    """Waveforms, by the writer of npTDMS."""
    nptdms = import_module("nptdms")
    path = folder / "run.tdms"
    channels = [
        ("Heater", HEAT, "W"),
        ("Bearing", TEMPERATURE, "degC"),
        ("Probe", DEFLECTION, "µm"),
    ]
    with nptdms.TdmsWriter(str(path)) as writer:
        for name, values, unit in channels:
            properties = {"wf_increment": 5.0, "wf_start_offset": 0.0, "unit_string": unit}
            writer.write_segment([nptdms.ChannelObject("Measured", name, values, properties)])
    return path


def workbook(folder: Path) -> Path:
    """A workbook with a title, and a date and a time of day as Excel has them."""
    openpyxl = import_module("openpyxl")
    book = openpyxl.Workbook()
    book.active.title = "Notes"
    sheet = book.create_sheet("Run 3")
    sheet.append(["Spindle test", None, None, None, None])
    sheet.append([])
    sheet.append(["Date", "Time", "Heat [W]", "Bearing [°C]", "Z growth [µm]"])
    for moment, q, t, d in zip(STAMPS, HEAT, TEMPERATURE, DEFLECTION, strict=True):
        day = datetime(moment.year, moment.month, moment.day)
        sheet.append([day, moment.time(), float(q), float(t), float(d)])
    path = folder / "run 3.xlsx"
    book.save(path)
    return path


def matlab_5(folder: Path) -> Path:
    """A struct of columns with days as `datenum` counts them."""
    from scipy.io import savemat

    days = 740060.0 + TIME / 86400
    log = {"t": days[:, None], "Q_W": HEAT[:, None], "T_bearing": TEMPERATURE[:, None]}
    path = folder / "log5.mat"
    savemat(path, {"log": {**log, "probe_um": DEFLECTION[:, None]}, "fs": 0.2, "who": "lab 2"})
    return path


def matlab_73(folder: Path) -> Path:
    """HDF5 as MATLAB lays it out: rows of columns, its header before."""
    h5py = import_module("h5py")
    path = folder / "log73.mat"
    columns = {"time_ms": 1e3 * TIME, "Q_W": HEAT, "T_bearing": TEMPERATURE, "probe_um": DEFLECTION}
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in columns.items():
            file.create_dataset(name, data=values[None, :])
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        note = file.create_dataset("note", data=np.frombuffer(b"ab", np.uint8)[None].astype("u2"))
        note.attrs["MATLAB_class"] = np.bytes_("char")
    with open(path, "r+b") as stream:
        head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sat Mar 14 10:15:00 2026"
        stream.write(head.ljust(124) + b"\x00\x02IM")
    return path


def klippy(folder: Path) -> Path:
    """klippy.log: the settings, then lines of statistics amid others."""
    lines = ["Starting Klippy...",
             "Git version: 'v0.12.0'", "===== Config file =====", "[printer]",
             "kinematics = corexy", "=======================", "Configured MCU 'mcu'"]  # fmt: skip
    for t, q, chamber in zip(TIME, HEAT, TEMPERATURE, strict=True):
        lines.append(
            f"Stats {4321.4 + t:.1f}: gcodein=0  mcu: mcu_awake=0.001 mcu_task_avg=0.000012 "
            f"bytes_write=1203 freq=179999{int(t) % 7}00 heater_bed: target=60 "
            f"temp={40 + q / 10:.1f} pwm={q / 100:.3f} chamber: temp={chamber:.1f} "
            f"print_time={t:.3f} buffer_time=0.000 print_stall=0 extruder: target=0 temp=25.1 "
            "pwm=0.000 sysload=0.14 cputime=2.331 memavail=740000"
        )
    path = folder / "klippy.log"
    path.write_text("\n".join([*lines, ""]))
    return path


def moonraker(folder: Path) -> Path:
    """An answer of Moonraker's temperature store: a value a second, no clock."""
    count = 1200
    t = np.arange(float(count))
    on = t >= 100
    chamber = 21.5 + np.where(on, 20 * -np.expm1(-(t - 100) / LAG), 0.0)
    store = {
        "heater_bed": {"temperatures": [40.0] * count, "targets": [60.0] * count,
                       "powers": on.astype(float).tolist()},
        "temperature_sensor chamber": {"temperatures": chamber.round(2).tolist()},
    }  # fmt: skip
    path = folder / "store.json"
    path.write_text(json.dumps({"result": store}))
    return path


def messages(folder: Path) -> Path:
    """A broker's NDJSON: one message per sensor, not quite at one time, nested."""
    lines = []
    for k, row in enumerate(zip(HEAT, TEMPERATURE, DEFLECTION, strict=True)):
        names = ("heater_power_W", "bearing_degC", "probe_um")
        for late, name, value in zip((0.0, 0.11, 0.35), names, row, strict=True):
            stamp = 1773483300 + 5 * k + late
            lines.append(json.dumps({"meta": {"ts": stamp, "sensor": name}, "value": value}))
    path = folder / "broker.ndjson"
    path.write_text("\n".join([*lines, ""]))
    return path


# The writer, heat, output, static gain [unit of the output by that of the drive].
CASES = [
    (german, "Q_Leistung_W", "T_Lager_degC", 0.2),
    (utf_16, "Q_Heater_power_W", "T_Bearing_temperature_degC", 0.2),
    (lvm, "Q_Heater_W", "d_Probe_Z_um", 0.6),
    (tdms, "Q_Heater_W", "d_Probe_um", 0.6),
    (workbook, "Q_Heat_W", "d_Z_growth_um", 0.6),
    (matlab_5, "Q_log_Q_W", "d_log_probe_um", 0.6),
    (matlab_73, "Q_W", "d_probe_um", 0.6),
    (klippy, "Q_heater_bed_pwm_1", "T_chamber_temp_degC", 20.0),
    (moonraker, "Q_heater_bed_powers_1", "T_temperature_sensor_chamber_temperatures_degC", 20.0),
    (messages, "Q_heater_power_W", "d_probe_um", 0.6),
]
