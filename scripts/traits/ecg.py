"""Traits of ECG recordings."""

import random
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.io import read_ecg

from . import Target, Trait, drop_cell, in_cells, in_lines, replaced, swap_columns

RATE_HZ, SECONDS = 250, 12


def _channels() -> tuple[FloatArray, FloatArray]:
    """Return an ECG at 75 beats per minute and breathing, both in mV, in steps of 0.001."""
    t_s = np.arange(RATE_HZ * SECONDS) / RATE_HZ
    beat = (t_s + 0.4) % 0.8 - 0.4
    ecg = np.exp(-0.5 * (beat / 0.012) ** 2) + 0.2 * np.exp(-0.5 * ((beat - 0.25) / 0.05) ** 2)
    breathing = np.sin(1.5 * t_s)
    return np.asarray(ecg.round(3)), np.asarray(breathing.round(3))


def write_seeds(folder: Path) -> None:
    """Write the valid files."""
    folder = folder / "ecg"
    folder.mkdir()
    ecg, breathing = _channels()
    rows = zip((np.arange(len(ecg)) / RATE_HZ).tolist(), ecg.tolist(), breathing.tolist(), strict=True)
    lines = ["t_s,ECG [mV],RSP [V]", *(f"{t:.3f},{a:.3f},{b:.3f}" for t, a, b in rows)]
    (folder / "whole.csv").write_text("\n".join(lines) + "\n")
    counts = np.stack([np.rint(1000 * ecg), np.rint(1000 * breathing)]).astype("<i2")
    fields: list[tuple[tuple[str, str], int]] = [(("ECG", "Resp"), 16), (("", ""), 80), (("mV", "mV"), 8)]
    fields += [(("-5", "-5"), 8), (("5", "5"), 8), (("-5000", "-5000"), 8), (("5000", "5000"), 8)]
    fields += [(("", ""), 80), ((str(RATE_HZ), str(RATE_HZ)), 8), (("", ""), 32)]
    fixed = f"{'0':8}{'':80}{'':80}{'01.01.2001.00.00':16}{768:<8}{'':44}{SECONDS:<8}{'1':8}{'2':4}"
    head = fixed + "".join(text.ljust(width) for texts, width in fields for text in texts)
    records = counts.reshape(2, SECONDS, RATE_HZ).transpose(1, 0, 2)
    (folder / "whole.edf").write_bytes(head.encode() + records.tobytes())
    signal = "whole.dat 16 1000(0)/mV 16 0 0 0 0"
    (folder / "whole.hea").write_text(f"whole 2 {RATE_HZ} {len(ecg)}\n{signal} II\n{signal} RESP\n")
    (folder / "whole.dat").write_bytes(counts.T.tobytes())


def _row(lines: list[str], rng: random.Random) -> int:
    """Draw a row that is neither the first nor the last."""
    return rng.randrange(3, len(lines) - 3)


def _drop_row(lines: list[str], rng: random.Random) -> None:
    at = _row(lines, rng)
    del lines[at : at + rng.choice((1, 3))]


def _repeat_row(lines: list[str], rng: random.Random) -> None:
    at = _row(lines, rng)
    lines.insert(at, lines[at])


def _second_header(lines: list[str], rng: random.Random) -> None:
    lines.insert(_row(lines, rng), lines[0])


def _no_header(lines: list[str], rng: random.Random) -> None:
    del lines[0]


def _stated_rate(lines: list[str], rng: random.Random) -> None:
    lines.insert(0, rng.choice(("Sample Rate: 500 Hz", "# sampling frequency = 1 kHz", "Interval=\t0.001 s")))


def _stamps(rows: list[list[str]], rng: random.Random) -> None:
    """Write times in ms or us under a name that says s."""
    scale = rng.choice((1e3, 1e6))
    for row in rows[1:]:
        row[0] = f"{scale * float(row[0]):.0f}"


def _spreadsheet(data: bytes, rng: random.Random) -> bytes:
    """Save as a spreadsheet does in Western Europe."""
    unit = "[µV]" if rng.random() < 0.3 else "[mV]"
    text = data.decode().replace(",", ";").replace(".", ",").replace("[mV]", unit)
    return text.encode(rng.choice(("utf-16", "cp1252", "utf-8-sig")))


def _field(at: int, width: int, *values: str) -> Trait:
    """Put another value into a field of an EDF's header."""
    return lambda data, rng: data[:at] + rng.choice(values).ljust(width).encode() + data[at + width :]


_TABLE = (
    *map(in_cells, (drop_cell, swap_columns, _stamps)),
    *map(in_lines, (_drop_row, _repeat_row, _second_header, _no_header, _stated_rate)),
    _spreadsheet,
    replaced(("t_s", "t_ms"), ("t_s", "t_us"), ("t_s", "time [min]"), ("t_s", "time [h]")),
    replaced(("ECG [mV]", "ECG [V]"), ("ECG [mV]", "ECG [uV]"), ("ECG [mV]", "ECG [mmHg]")),
    replaced(("ECG", "Pleth"), ("ECG", "Trigger"), ("ECG", ""), ("ECG", "channel 1")),
)
_SIGNALS = 256  # first byte after the fixed part of an EDF's header
_EDF = (
    _field(184, 8, "512", "1024", "256"),
    _field(236, 8, "11", "13", "-1"),
    _field(252, 4, "1", "3"),
    _field(_SIGNALS, 16, "Pleth", "Trigger", "", "channel 1"),
    _field(_SIGNALS + 192, 8, "V", "uV", "mmHg", "%", ""),
    _field(_SIGNALS + 208, 8, "-5000", "5", "-"),
    _field(_SIGNALS + 240, 8, "5000", "5", "100"),
    _field(_SIGNALS + 256, 8, "-40000", "-10", "5000"),
    _field(_SIGNALS + 272, 8, "40000", "100", "-5000"),
    _field(_SIGNALS + 448, 8, "500", "125", "249"),
    lambda data, rng: data[: -rng.randrange(1, 3000)],
    lambda data, rng: data + bytes(rng.randrange(1, 3000)),
)
_WFDB = (
    replaced(("whole 2 ", "whole 1 "), ("whole 2 ", "whole 3 ")),
    replaced((" 250 3000", ""), (" 3000", " 2900"), (" 3000", " 3001"), (" 3000", "")),
    replaced((" 16 1000", " 212 1000"), (" 16 1000", " 80 1000"), (" 16 1000", " 16x2 1000")),
    replaced(("1000(0)", "1(0)"), ("1000(0)", "1000000(0)"), ("1000(0)", "0")),
    replaced(("/mV", "/V"), ("/mV", "/uV"), ("/mV", "/mmHg"), ("/mV", "/NU")),
    replaced((" II", " PLETH"), (" II", ""), (" II", " channel 1")),
    replaced((" 3000\n", " 3000 05-May-2020 09:49:17\n"), (" 3000\n", " 3000 10:00:00 \xe4\n")),
)


def _read(path: Path) -> Any:
    """Read what decides the times of R peaks; a unit is part of it."""
    signal = read_ecg(str(path))
    return signal.rate_hz, signal.leads, signal.unit, signal.samples


TRAITS = {
    "ecg-csv": Target("ecg/whole.csv", _read, _TABLE),
    "ecg-edf": Target("ecg/whole.edf", _read, _EDF),
    "ecg-wfdb": Target("ecg/whole.hea", _read, _WFDB),
}
