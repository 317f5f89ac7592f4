"""The files that make up a WFDB record."""

from pathlib import Path


def record_files(record: Path) -> tuple[Path, ...]:
    """The header of a record, named without suffix, and the signal files that it names, in order.

    A record in several segments has a header for each.

    Source: WFDB header(5): a record line "name/segments signals …", then a line for each signal or segment.
    Raises:
        OSError: a header cannot be read.
    """
    header = Path(f"{record}.hea")
    text = header.read_bytes().decode("latin-1")
    lines = [line.split() for line in text.splitlines() if line.strip() and line.lstrip()[0] != "#"]
    names = [line[0] for line in lines[1:] if line[0] != "~"]
    if not lines or "/" not in lines[0][0]:
        return (header, *(header.parent / name for name in dict.fromkeys(names)))
    segments = (record_files(header.parent / name) for name in dict.fromkeys(names) if name != record.name)
    return (header, *(file for segment in segments for file in segment))
