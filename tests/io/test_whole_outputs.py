"""Whatever stops a program that writes, its output is the old one or the new one, and nobody else's goes."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from dvf_ig.cli.calibrate.output import save
from dvf_ig.cli.gate import gate
from dvf_ig.core import OutputError
from dvf_ig.io.reading import read_text
from dvf_ig.io.writing import atomic_folder as whole
from dvf_ig.io.writing import swap_journal
from dvf_ig.io.writing.atomic import atomic_file
from dvf_ig.io.writing.atomic_folder import atomic_folder, files_together

NAMES = ("a", "b", "c")


def write(folder: Path, text: str) -> None:
    with atomic_folder(folder) as new:
        for name in NAMES:
            (new / name).write_text(text)


def write_together(folder: Path, text: str) -> None:
    with files_together(folder, NAMES) as new:
        for name in NAMES:
            (new / name).write_text(text)


def texts(folder: Path) -> list[str]:
    return [(folder / name).read_text() for name in NAMES]


def interrupted_at(step: int, *, after: bool, rename: Callable[..., None]) -> Callable[..., None]:
    """os.rename with a Ctrl-C right before or right after its call number `step`."""
    count = [0]

    def renaming(source: Path, target: Path) -> None:
        count[0] += 1
        if count[0] == step and not after:
            raise KeyboardInterrupt
        rename(source, target)
        if count[0] == step:
            raise KeyboardInterrupt

    return renaming


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("step", range(1, 8))
@pytest.mark.parametrize("writer", [write, write_together])
def test_ctrl_c_between_renames_leaves_the_old_or_the_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: Callable[..., None], step: int, after: bool
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    writer(folder, "old")
    monkeypatch.setattr(whole, "_exchanged", lambda *_: False)
    monkeypatch.setattr(os, "rename", interrupted_at(step, after=after, rename=os.rename))
    try:
        writer(folder, "new")
    except KeyboardInterrupt:
        assert texts(folder) == ["old"] * 3
    else:
        assert texts(folder) == ["new"] * 3
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert {path.name for path in folder.iterdir()} <= {*NAMES, whole.LISTING}


@pytest.mark.parametrize("writer", [write, write_together])
def test_ctrl_c_right_after_an_exchange(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: Callable[..., None]
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    writer(folder, "old")
    exchange, calls = whole._exchanged, [0]

    def twice_interrupted(one: Path, other: Path) -> bool:
        done = exchange(one, other)
        calls[0] += 1
        if calls[0] in (1, 2):
            raise KeyboardInterrupt
        return done

    monkeypatch.setattr(whole, "_exchanged", twice_interrupted)
    with pytest.raises(KeyboardInterrupt):
        writer(folder, "new")
    assert texts(folder) == ["old"] * 3
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


LOOP = """
import signal
import sys
from contextlib import suppress
from pathlib import Path
from dvf_ig.io.writing.atomic_folder import {writer}
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job begins with it ignored
print("on", flush=True)
for n in range({rounds}):
    with {writer}(Path(sys.argv[1]){names}) as new:
        for name in "abc":
            (new / name).write_text(sys.argv[2] + str(n))
"""


@pytest.mark.parametrize("kind", [signal.SIGKILL, signal.SIGINT])
def test_killed_at_random_moments(tmp_path: Path, kind: signal.Signals) -> None:
    """A loop writes the folder a few hundred times a second; whenever it dies, the folder is of one round."""
    folder, rng = tmp_path / "out", random.Random(kind)
    code = LOOP.format(writer="atomic_folder", rounds=10**9, names="")
    loop = [sys.executable, "-c", code, str(folder), ""]
    child = subprocess.Popen(loop, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "on\n"
    time.sleep(0.05 + 0.1 * rng.random())
    for _ in range(40):  # Python loses a Ctrl-C that comes while an object is being deleted
        child.send_signal(kind)
        with suppress(subprocess.TimeoutExpired):
            child.wait(0.5)
            break
    child.stdout.close()
    assert child.poll() is not None
    assert len(set(texts(folder))) == 1
    assert whole._foreign_file(folder) is None


KILLED = """
import os, signal, sys
from pathlib import Path
from dvf_ig.io.writing import atomic_folder as whole
swap, done = whole._swap, [0]
def dying(new, place):
    if done[0] == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)
    swap(new, place)
    done[0] += 1
whole._swap = dying
with whole.files_together(Path(sys.argv[1]), "abcd") as new:
    for name in "abc":
        (new / name).write_text("new")
"""


@pytest.mark.parametrize("swapped", [0, 1, 2, 3])
def test_what_a_killed_program_left_half_done_is_done_by_the_next(tmp_path: Path, swapped: int) -> None:
    for name in "abd":
        (tmp_path / name).write_text("old")
    killed = [sys.executable, "-c", KILLED, str(tmp_path), str(swapped)]
    assert subprocess.run(killed, check=False).returncode == -signal.SIGKILL
    assert (tmp_path / swap_journal.JOURNAL).is_file()
    assert read_text(tmp_path / "a", "a text") == "new"
    assert texts(tmp_path) == ["new"] * 3
    assert {path.name for path in tmp_path.iterdir()} == set("abc")


def test_a_file_written_since_a_program_was_killed_stays(tmp_path: Path) -> None:
    (tmp_path / "b").write_text("old")
    killed = [sys.executable, "-c", KILLED, str(tmp_path), "1"]
    subprocess.run(killed, check=False)
    (tmp_path / "b").unlink()
    (tmp_path / "b").write_text("mine")
    assert read_text(tmp_path / "b", "a text") == "mine"
    assert read_text(tmp_path / "c", "a text") == "new"


@pytest.mark.parametrize(
    "said", [b"", b"[]", b"{}", b'{"folder": "..", "moves": {"x": [null, null]}}', b"[" * 10000]
)
def test_a_foreign_journal_moves_nothing(tmp_path: Path, said: bytes) -> None:
    """A journal in somebody's folder can name files of that folder alone."""
    inside, victim = tmp_path / "in", tmp_path / "victim"
    (inside / ".0123abcd").mkdir(parents=True)
    victim.write_text("mine")
    (inside / "a").write_text("old")
    at = victim.stat()
    nodes = [None, [at.st_dev, at.st_ino, at.st_mtime_ns]]
    moves = {"../victim": nodes[::-1], "b": nodes, "..": [None, None]}
    text = said or json.dumps({"folder": ".0123abcd", "moves": moves}).encode()
    (inside / swap_journal.JOURNAL).write_bytes(text)
    (inside / ".0123abcd" / "b").symlink_to(victim)
    assert read_text(inside / "a", "a text") == "old"
    assert victim.read_text() == "mine"
    assert not (inside / "b").exists()
    assert not (inside / swap_journal.JOURNAL).exists()


def test_only_what_this_program_wrote_is_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    write(folder, "old")
    write(folder, "new")
    (folder / "a").write_text("mine")
    with pytest.raises(OutputError, match="'a' in it was not written by this program"):
        write(folder, "newer")
    assert texts(folder) == ["mine", "new", "new"]
    (folder / "a").write_text("new")
    (folder / "b").unlink()
    write(folder, "newer")
    assert texts(folder) == ["newer"] * 3
    (folder / whole.LISTING).unlink()
    with pytest.raises(OutputError, match="was not written"):
        write(folder, "newest")
    (folder / whole.LISTING).write_text(json.dumps(["a"]))
    with pytest.raises(OutputError, match="was not written"):
        write(folder, "newest")


def test_links_stay_links(tmp_path: Path) -> None:
    """What a link points to is replaced: a folder, a file, also one that does not exist yet."""
    link, real = tmp_path / "link", tmp_path / "real"
    link.symlink_to(real)
    for text in ("first", "second"):
        write(link, text)
        assert texts(real) == [text] * 3
    single, target = tmp_path / "single", tmp_path / "target"
    single.symlink_to(target)
    with atomic_file(single) as temporary:
        temporary.write_text("text")
    assert target.read_text() == "text"
    assert link.is_symlink()
    assert single.is_symlink()
    assert {path.name for path in tmp_path.iterdir()} == {"link", "real", "single", "target"}
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    with pytest.raises(OutputError, match="links lead nowhere"):
        write(tmp_path / "circle", "text")


@pytest.mark.parametrize(
    "name",
    [".", "..", "a\0b", "/dev/null", "x" * 300, "file/below"],
    ids=["here", "above", "NUL", "device", "long", "below a file"],
)
def test_places_where_nothing_can_be_written(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="cannot"):
        write(Path(name), "text")
    with pytest.raises(OutputError, match="cannot"), atomic_file(Path(name)) as temporary:
        temporary.write_text("text")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_two_processes_do_not_mix_their_files(tmp_path: Path) -> None:
    """Each swaps its files in while the other waits."""
    code = LOOP.format(writer="files_together", rounds=150, names=', "abc"')
    command = [sys.executable, "-c", code, str(tmp_path)]
    both = [subprocess.Popen([*command, which], stdout=subprocess.DEVNULL) for which in "xy"]
    assert [child.wait(60) for child in both] == [0, 0]
    assert len(set(texts(tmp_path))) == 1
    assert {path.name for path in tmp_path.iterdir()} == set(NAMES)


def full_disk(*_: object, **__: object) -> None:
    raise OutputError("cannot write: No space left on device")


def test_no_result_stays_without_its_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ecg.csv").write_text(
        "t_s,II\n" + "".join(f"{i / 250},{i % 200 == 9:d}\n" for i in range(3000))
    )
    monkeypatch.setattr("dvf_ig.report.gate_png", full_disk)
    app = typer.Typer()
    app.command()(gate)
    done = CliRunner().invoke(app, [str(tmp_path / "ecg.csv"), "-o", str(tmp_path / "gate.json")])
    assert done.exit_code == 4
    with pytest.raises(OutputError, match="No space left"):
        save(tmp_path / "tip.json", {"kind": "tip", "refused": False}, None, None, None, full_disk)
    assert [path.name for path in tmp_path.iterdir()] == ["ecg.csv"]
