"""Write the foreign logs of the tutorials: a heated gantry and a spindle, in numpy alone.

``python data_samples/machines.py FOLDER``. Lumped nodes (capacities, conductances, films), stepped
each second; what is written looks as a logger script and a LabVIEW panel write it.
"""

from __future__ import annotations

import sys
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

# Nodes of the gantry: bed, chamber, columns, beam; J/K and W/K.
GANTRY_CAPACITY = np.array([1400.0, 350.0, 9000.0, 2300.0])
GANTRY_LINKS = {(0, 1): 1.6, (0, 2): 0.5, (1, 2): 0.9, (1, 3): 0.8, (2, 3): 1.1}
GANTRY_FILMS = np.array([0.4, 1.1, 0.8, 0.5])
GANTRY_GROWTH = np.array([0.9, 0.0, -7.0, 1.6])  # µm/K of the gap between nozzle and bed
# Nodes of the spindle: front bearing, shaft, housing, head, column.
SPINDLE_CAPACITY = np.array([900.0, 4200.0, 9500.0, 26000.0, 64000.0])
SPINDLE_LINKS = {(0, 1): 6.0, (0, 2): 14.0, (2, 3): 12.0, (3, 4): 7.0}
SPINDLE_FILMS = np.array([0.5, 1.5, 4.0, 7.0, 16.0])
SPINDLE_GROWTH = {  # µm/K of each distance between spindle and table
    "E_Z0S": np.array([0.4, 1.9, 1.2, 2.1, -1.6]),
    "E_X0S": np.array([0.1, 0.0, 0.3, 0.5, 0.2]),
    "E_Y0S": np.array([0.2, 0.1, 1.3, 1.7, -1.1]),
}


def exchange(links: dict[tuple[int, int], float], films: np.ndarray) -> np.ndarray:
    """Conductances between nodes and to the room as a matrix [W/K]."""
    matrix = np.diag(films)
    for (i, j), conductance in links.items():
        matrix[i, i] += conductance
        matrix[j, j] += conductance
        matrix[i, j] -= conductance
        matrix[j, i] -= conductance
    return matrix


def gantry(
    path: Path, begin: datetime, target: float, hours_on: float, room: float, seed: int
) -> None:
    """Z of a nozzle on a pin, in motor steps of 2.5 µm; the bed on a thermostat, then off."""
    noise = np.random.default_rng(seed)
    loss = exchange(GANTRY_LINKS, GANTRY_FILMS)
    heat, period = np.zeros(4), 30
    temperature = np.full(4, room)
    rest = temperature.copy()
    lines = [
        "# nozzle on a pin; z in steps of 2.5 um",
        "sample,time,z_steps,frame_t,chamber_t,bed_t,bed_target",
    ]
    for second in range(int(5.5 * 3600)):
        on = 600 <= second < 600 + 3600 * hours_on
        heat[0] = np.clip(60.0 * (target - temperature[0]), 0.0, 350.0) if on else 0.0
        if second % period == 0:
            rise = temperature - rest
            steps = (GANTRY_GROWTH @ rise + noise.normal(0.0, 1.0)) / 2.5
            frame = temperature[2] + noise.normal(0.0, 0.04)
            chamber, bed = temperature[[1, 0]] + noise.normal(0.0, 0.05, 2)
            stamp = (begin + timedelta(seconds=second)).strftime("%Y/%m/%d-%H:%M:%S")
            # The frame's probe counts sixteenths of a kelvin; 85 is what it says without power.
            frame_t = 85.0 if second in (6600, 12000) and hours_on > 3 else round(frame * 16) / 16
            lines.append(
                f"{second // period},{stamp},{round(steps)},{frame_t:.4f},{chamber:.2f},{bed:.2f},"
                f"{target if on else 0:.0f}"
            )
        temperature = (
            temperature + (heat - loss @ temperature + GANTRY_FILMS * room) / GANTRY_CAPACITY
        )
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def spindle(path: Path, begin: datetime, profile: list[tuple[float, float]], seed: int) -> None:
    """Three displacement probes on a test mandrel, speed by blocks of (hours, 1/min)."""
    noise = np.random.default_rng(seed)
    loss = exchange(SPINDLE_LINKS, SPINDLE_FILMS)
    inlet = np.array([0.75, 0.25, 0.0, 0.0, 0.0])
    speed = np.concatenate([np.full(int(hours * 3600), rpm) for hours, rpm in profile])
    temperature = np.full(5, 21.0)
    rows = [
        "Prüfstand 2;Erwärmung durch drehende Spindel",
        "Prüfer;M. Weber",
        "Datum;Uhrzeit;Drehzahl [1/min];T Lager vorn [°C];T Gehäuse [°C];T Raum [°C];"
        + ";".join(f"{name} [µm]" for name in SPINDLE_GROWTH),
    ]
    for second, rpm in enumerate(speed):
        room = 21.0 + 0.3 * np.sin(2 * np.pi * second / 21600)
        if second % 30 == 0:
            rise = temperature - 21.0
            read = temperature[[0, 2]] + noise.normal(0.0, 0.02, 2)
            moved = [growth @ rise + noise.normal(0.0, 0.15) for growth in SPINDLE_GROWTH.values()]
            stamp = (begin + timedelta(seconds=second)).strftime("%d.%m.%Y;%H:%M:%S")
            cells = [f"{rpm:.0f}", f"{read[0]:.2f}", f"{read[1]:.2f}", f"{room:.2f}"]
            cells += [f"{value:.2f}" for value in moved]
            rows.append(f"{stamp};" + ";".join(cells).replace(".", ","))
        # Friction grows a little faster than the speed.
        friction = inlet * 260.0 * (rpm / 8000) ** 1.3
        temperature = (
            temperature + (friction - loss @ temperature + SPINDLE_FILMS * room) / SPINDLE_CAPACITY
        )
    path.write_bytes(("\r\n".join(rows) + "\r\n").encode("cp1252"))


def main() -> None:
    """Write the four logs."""
    folder = Path(sys.argv[1])
    gantry(folder / "gantry_morning.csv", datetime(2026, 3, 14, 7, 30), 105.0, 3.2, 20.5, 21)
    gantry(folder / "gantry_evening.csv", datetime(2026, 3, 14, 19, 5), 80.0, 2.0, 23.0, 22)
    steps = [(0.5, 0), (1.5, 4000), (1.5, 8000), (1.5, 2000), (1.0, 0)]
    spindle(folder / "spindle_steps.csv", datetime(2026, 3, 16, 8, 0), steps, 23)
    spectrum = [(0.4, 0), *[(0.25, rpm) for rpm in (6000, 0, 3000, 8000, 5000, 7000, 0, 4000)] * 2]
    spindle(folder / "spindle_spectrum.csv", datetime(2026, 3, 17, 8, 0), spectrum, 24)


if __name__ == "__main__":
    main()
