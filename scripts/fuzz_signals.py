"""Well-formed ECG recordings that contradict themselves or what an ECG can be, as people have reported them.

Each must be refused, named in a warning, or give the same leads, rate and samples as the whole file.
Usage: python -m scripts.fuzz_signals [N]
"""

import logging
import random
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, Signal
from dvf_ig.core.errors import DvfIgError
from dvf_ig.io import read_ecg

Lie = Callable[[bytes, random.Random], bytes]
RATE_HZ, SECONDS = 250, 12


def _channels() -> tuple[FloatArray, FloatArray]:
    """Return an ECG at 75 beats per minute and breathing, both in mV, in steps of 0.001."""
    t_s = np.arange(RATE_HZ * SECONDS) / RATE_HZ
    beat = (t_s + 0.4) % 0.8 - 0.4
    ecg = np.exp(-0.5 * (beat / 0.012) ** 2) + 0.2 * np.exp(-0.5 * ((beat - 0.25) / 0.05) ** 2)
    breathing = np.sin(1.5 * t_s)
    return np.asarray(ecg.round(3)), np.asarray(breathing.round(3))


def write_seeds(folder: Path) -> None:
    """Write the whole recordings."""
    ecg, breathing = _channels()
    rows = zip((np.arange(len(ecg)) / RATE_HZ).tolist(), ecg.tolist(), breathing.tolist(), strict=True)
    lines = ["t_s,ECG [mV],RSP [V]", *(f"{t:.3f},{a:.3f},{b:.3f}" for t, a, b in rows)]
    (folder / "lies.csv").write_text("\n".join(lines) + "\n")
    counts = np.stack([np.rint(1000 * ecg), np.rint(1000 * breathing)]).astype("<i2")
    fields: list[tuple[tuple[str, str], int]] = [(("ECG", "Resp"), 16), (("", ""), 80), (("mV", "mV"), 8)]
    fields += [(("-5", "-5"), 8), (("5", "5"), 8), (("-5000", "-5000"), 8), (("5000", "5000"), 8)]
    fields += [(("", ""), 80), ((str(RATE_HZ), str(RATE_HZ)), 8), (("", ""), 32)]
    fixed = f"{'0':8}{'':80}{'':80}{'01.01.2001.00.00':16}{768:<8}{'':44}{SECONDS:<8}{'1':8}{'2':4}"
    head = fixed + "".join(text.ljust(width) for texts, width in fields for text in texts)
    records = counts.reshape(2, SECONDS, RATE_HZ).transpose(1, 0, 2)
    (folder / "lies.edf").write_bytes(head.encode() + records.tobytes())
    signal = "lies.dat 16 1000(0)/mV 16 0 0 0 0"
    (folder / "lies.hea").write_text(f"lies 2 {RATE_HZ} {len(ecg)}\n{signal} II\n{signal} RESP\n")
    (folder / "lies.dat").write_bytes(counts.T.tobytes())


def _replaced(*pairs: tuple[bytes, bytes]) -> Lie:
    """Replace the first occurrence of one text by another."""

    def lie(data: bytes, rng: random.Random) -> bytes:
        old, new = rng.choice(pairs)
        return data.replace(old, new, 1)

    return lie


def _edited(change: Callable[[list[bytes], random.Random, int], None]) -> Lie:
    """Change the lines of a table; the third argument is a row between the first and the last."""

    def lie(data: bytes, rng: random.Random) -> bytes:
        lines = data.split(b"\n")
        change(lines, rng, rng.randrange(3, len(lines) - 3))
        return b"\n".join(lines)

    return lie


def _drop_cell(lines: list[bytes], rng: random.Random, row: int) -> None:
    cells = lines[row].split(b",")
    del cells[rng.randrange(3)]
    lines[row] = b",".join(cells)


def _swap_columns(lines: list[bytes], rng: random.Random, row: int) -> None:
    order = rng.sample(range(3), 3)
    lines[:] = [b",".join(line.split(b",")[i] for i in order) if line else line for line in lines]


def _drop_row(lines: list[bytes], rng: random.Random, row: int) -> None:
    del lines[row : row + rng.choice((1, 3))]


def _repeat_row(lines: list[bytes], rng: random.Random, row: int) -> None:
    lines.insert(row, lines[row])


def _second_header(lines: list[bytes], rng: random.Random, row: int) -> None:
    lines.insert(row, lines[0])


def _no_header(lines: list[bytes], rng: random.Random, row: int) -> None:
    del lines[0]


def _stated_rate(lines: list[bytes], rng: random.Random, row: int) -> None:
    lines.insert(
        0, rng.choice((b"Sample Rate: 500 Hz", b"# sampling frequency = 1 kHz", b"Interval=\t0.001 s"))
    )


def _stamps(lines: list[bytes], rng: random.Random, row: int) -> None:
    """Write times in ms or us under a name that says s."""
    scale = rng.choice((1e3, 1e6))
    for i, line in enumerate(lines[1:], 1):
        time, _, rest = line.partition(b",")
        lines[i] = b"%.0f,%s" % (scale * float(time), rest) if line else line


def _spreadsheet(data: bytes, rng: random.Random) -> bytes:
    """Save as a spreadsheet does in Western Europe."""
    text = (
        data.decode()
        .replace(",", ";")
        .replace(".", ",")
        .replace("[mV]", "[µV]" if rng.random() < 0.3 else "[mV]")
    )
    return text.encode(rng.choice(("utf-16", "cp1252", "utf-8-sig")))


def _field(at: int, width: int, *values: str) -> Lie:
    """Put another value into a field of an EDF's header."""
    return lambda data, rng: data[:at] + rng.choice(values).ljust(width).encode() + data[at + width :]


_TWO = 256  # first byte after the fixed part of an EDF's header
LIES: dict[str, tuple[str, tuple[Lie, ...]]] = {
    "ecg-csv": (
        "lies.csv",
        (
            *map(_edited, (_drop_cell, _swap_columns, _drop_row, _repeat_row, _second_header, _no_header)),
            *map(_edited, (_stated_rate, _stamps)),
            _spreadsheet,
            _replaced((b"t_s", b"t_ms"), (b"t_s", b"t_us"), (b"t_s", b"time [min]"), (b"t_s", b"time [h]")),
            _replaced((b"ECG [mV]", b"ECG [V]"), (b"ECG [mV]", b"ECG [uV]"), (b"ECG [mV]", b"ECG [mmHg]")),
            _replaced((b"ECG", b"Pleth"), (b"ECG", b"Trigger"), (b"ECG", b""), (b"ECG", b"channel 1")),
        ),
    ),
    "ecg-edf": (
        "lies.edf",
        (
            _field(184, 8, "512", "1024", "256"),
            _field(236, 8, "11", "13", "-1"),
            _field(252, 4, "1", "3"),
            _field(_TWO, 16, "Pleth", "Trigger", "", "channel 1"),
            _field(_TWO + 192, 8, "V", "uV", "mmHg", "%", ""),
            _field(_TWO + 208, 8, "-5000", "5", "-"),
            _field(_TWO + 240, 8, "5000", "5", "100"),
            _field(_TWO + 256, 8, "-40000", "-10", "5000"),
            _field(_TWO + 272, 8, "40000", "100", "-5000"),
            _field(_TWO + 448, 8, "500", "125", "249"),
            lambda data, rng: data[: -rng.randrange(1, 3000)],
            lambda data, rng: data + bytes(rng.randrange(1, 3000)),
        ),
    ),
    "ecg-wfdb": (
        "lies.hea",
        (
            _replaced((b"lies 2 ", b"lies 1 "), (b"lies 2 ", b"lies 3 ")),
            _replaced((b" 250 3000", b""), (b" 3000", b" 2900"), (b" 3000", b" 3001"), (b" 3000", b"")),
            _replaced((b" 16 1000", b" 212 1000"), (b" 16 1000", b" 80 1000"), (b" 16 1000", b" 16x2 1000")),
            _replaced((b"1000(0)", b"1(0)"), (b"1000(0)", b"1000000(0)"), (b"1000(0)", b"0")),
            _replaced((b"/mV", b"/V"), (b"/mV", b"/uV"), (b"/mV", b"/mmHg"), (b"/mV", b"/NU")),
            _replaced((b" II", b" PLETH"), (b" II", b""), (b" II", b" channel 1")),
            _replaced((b" 3000\n", b" 3000 05-May-2020 09:49:17\n"), (b" 3000\n", b" 3000 10:00:00 \xe4\n")),
        ),
    ),
}
"""Seed file and lies of each reader."""


class _Warnings(logging.Handler):
    """Count of warnings."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.count += 1


def _same(signal: Signal, whole: Signal) -> bool:
    """Return whether two readings give R peaks at the same times; a unit is part of them."""
    alike = (signal.rate_hz, signal.leads, signal.unit) == (whole.rate_hz, whole.leads, whole.unit)
    return (
        alike
        and signal.samples.shape == whole.samples.shape
        and bool((signal.samples == whole.samples).all())
    )


def silent_lies(reader: str, seed: int, count: int, seeds: Path) -> list[str]:
    """Read `count` lies and list those that were accepted without a word, but as another signal."""
    name, lies = LIES[reader]
    path, kind, silent = seeds / name, reader.removeprefix("ecg-"), list[str]()
    spec = f"{kind}:{path}"
    data, warnings = path.read_bytes(), _Warnings()
    whole = read_ecg(spec)
    logger = logging.getLogger("dvf_ig")
    logger.addHandler(warnings)
    try:
        for number in range(count):
            rng = random.Random(f"lie {seed} {reader} {number}")
            which = rng.randrange(len(lies))
            lie = lies[which](data, rng)
            path.write_bytes(lie)
            before = warnings.count
            try:
                signal = read_ecg(spec)
            except DvfIgError:
                continue
            others = set(whole.left_out) and not signal.left_out  # the note on what was left out is no news
            if warnings.count - before <= (0 if others else 1) and not _same(signal, whole):
                silent.append(
                    f"{reader} {number}: lie {which}: {signal.leads} {signal.rate_hz:g} Hz {signal.unit}"
                )
    finally:
        path.write_bytes(data)
        logger.removeHandler(warnings)
    return silent


def main(count: int) -> int:
    """Print the lies that were taken silently."""
    with tempfile.TemporaryDirectory() as folder:
        write_seeds(Path(folder))
        silent = [lie for reader in sorted(LIES) for lie in silent_lies(reader, 1, count, Path(folder))]
    print("\n".join((*silent, f"{count} lies a reader, {len(silent)} taken silently")))
    return 1 if silent else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 300))
