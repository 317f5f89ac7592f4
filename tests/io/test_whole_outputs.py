"""Whatever stops a program that writes, its output is the old one or the new one, and nobody else's goes."""

import hashlib
import json
import multiprocessing
import os
import random
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from dvf_ig.cli.calibrate.output import save
from dvf_ig.cli.gate import gate
from dvf_ig.core import OutputError, UnreadableFileError
from dvf_ig.io.provenance import not_recorded, recorded_inputs
from dvf_ig.io.reading import read_text
from dvf_ig.io.writing import atomic, listing
from dvf_ig.io.writing.atomic import atomic_file, atomic_folder, files_together, foreign_file, write_text
from dvf_ig.io.writing.listing import LISTING

NAMES = ("a", "b", "c")


FORKS = "ignore:.*multi-threaded, use of fork:DeprecationWarning"  # from Python 3.12 on
pytestmark = [pytest.mark.usefixtures("in_a_command"), pytest.mark.filterwarnings(FORKS)]


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
    monkeypatch.setattr(atomic, "_exchanged", lambda *_: False)
    monkeypatch.setattr(os, "rename", interrupted_at(step, after=after, rename=os.rename))
    try:
        writer(folder, "new")
    except KeyboardInterrupt:
        assert texts(folder) == ["old"] * 3
    else:
        assert texts(folder) == ["new"] * 3
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert {path.name for path in folder.iterdir()} == {*NAMES, LISTING}


@pytest.mark.parametrize("writer", [write, write_together])
def test_ctrl_c_right_after_an_exchange(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: Callable[..., None]
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    writer(folder, "old")
    exchange, calls = atomic._exchanged, [0]

    def twice_interrupted(one: Path, other: Path) -> bool:
        done = exchange(one, other)
        calls[0] += 1
        if calls[0] in (1, 2):
            raise KeyboardInterrupt
        return done

    monkeypatch.setattr(atomic, "_exchanged", twice_interrupted)
    with pytest.raises(KeyboardInterrupt):
        writer(folder, "new")
    assert texts(folder) == ["old"] * 3
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


FORK = multiprocessing.get_context("fork")
Writer = Callable[[Path, str], None]


def keep_writing(folder: Path, writer: Writer, text: str, rounds: int, began: Any) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job begins with it ignored
    for n in range(rounds):
        with recorded_inputs():
            writer(folder, f"{text}{n}")
        began.set()


def writing(folder: Path, writer: Writer, text: str = "", rounds: int = 10**9) -> Any:
    """Start a process that writes the folder again and again, and wait until it has done so once."""
    began = FORK.Event()
    child = FORK.Process(target=keep_writing, args=(folder, writer, text, rounds, began), daemon=True)
    child.start()
    assert began.wait(60.0)
    return child


@pytest.mark.parametrize("kind", [signal.SIGKILL, signal.SIGINT])
def test_killed_at_random_moments(tmp_path: Path, kind: signal.Signals) -> None:
    """A loop writes the folder a few hundred times a second; whenever it dies, the folder is of one round."""
    folder, rng = tmp_path / "out", random.Random(kind)
    child = writing(folder, write)
    time.sleep(0.05 + 0.1 * rng.random())
    for _ in range(40):  # Python loses a Ctrl-C that comes while an object is being deleted
        os.kill(child.pid, kind)
        child.join(0.5)
        if child.exitcode is not None:
            break
    assert child.exitcode is not None
    assert len(set(texts(folder))) == 1
    assert foreign_file(folder) is None


def killed_between_files(folder: Path, swapped: int) -> None:
    """Write three files, killed when so many have replaced the old ones."""
    one, done = atomic._swap, [0]

    def dying(*places: Any) -> None:
        if done[0] == swapped:
            os.kill(os.getpid(), signal.SIGKILL)
        one(*places)
        done[0] += 1

    setattr(atomic, "_swap", dying)  # noqa: B010
    with recorded_inputs():
        write_together(folder, "new")


@pytest.mark.parametrize("swapped", [0, 2])
def test_files_of_two_runs_are_refused_until_they_are_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, swapped: int
) -> None:
    """A reader moves nothing; the next writer replaces all, and names the folder that was left."""
    monkeypatch.setattr(listing, "_PATIENCE_S", 0.05)
    write_together(tmp_path, "old")
    write_text(tmp_path / "other", "of another command")
    child = FORK.Process(target=killed_between_files, args=(tmp_path, swapped))
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGKILL
    mixed = ["new"] * swapped + ["old"] * (3 - swapped)
    assert texts(tmp_path) == mixed
    for name in NAMES:
        with pytest.raises(UnreadableFileError, match=r"killed while it replaced them; run that command"):
            read_text(tmp_path / name, "a text")
    assert read_text(tmp_path / "other", "a text") == "of another command"
    assert texts(tmp_path) == mixed
    (left,) = (path for path in tmp_path.iterdir() if path.name.startswith(".dvf_ig-"))
    os.utime(left, (0, 0))
    write_together(tmp_path, "newer")
    assert [read_text(tmp_path / name, "a text") for name in NAMES] == ["newer"] * 3
    assert left.is_dir()
    assert [one.getMessage() for one in caplog.records if f"rm -r '{left}'" in one.getMessage()] != []


def test_a_reader_waits_for_a_process_that_moves_its_files(tmp_path: Path) -> None:
    child = writing(tmp_path, write_together)
    try:
        with not_recorded():
            assert all(read_text(tmp_path / name, "a text").isdecimal() for name in NAMES * 30)
    finally:
        child.kill()
        child.join()


@pytest.mark.parametrize(
    "said",
    [
        {"folder": "../victim", "moves": {}},
        {"folder": ".0badcafe", "moves": {"mine": [None, None]}},
        {"files": {"../victim/mine": ["x"]}, "unfinished": ["../victim/mine", "../victim"]},
        {"files": {"mine": "x"}, "unfinished": {"mine": 1}},
        {"files": [], "unfinished": []},
        [],
        None,
    ],
)
def test_no_file_makes_a_reader_or_a_writer_move_or_remove_another(tmp_path: Path, said: object) -> None:
    """What lies in a downloaded folder moves nothing, in it or elsewhere."""
    inside, victim = tmp_path / "download", tmp_path / "victim"
    for folder in (inside / ".0badcafe", inside / ".dvf_ig-0badcafe", victim / ".0badcafe"):
        folder.mkdir(parents=True)
        (folder / "mine").write_text("mine")
    (inside / "mine").write_text("mine")
    for name in (".dvf_ig_swap.json", LISTING):
        (inside / name).write_text(json.dumps(said))
    before = sorted(tmp_path.rglob("*"))
    with not_recorded():
        assert read_text(inside / "mine", "a text") == "mine"
    with pytest.raises(OutputError, match="this program did not write"):
        write_text(inside / "mine", "x")
    write_text(inside / "new", "x")
    assert sorted(tmp_path.rglob("*")) == sorted([*before, inside / "new"])
    assert (inside / "mine").read_text() == "mine"


def test_a_file_that_is_read_is_not_replaced(tmp_path: Path) -> None:
    """Also one that this program wrote, by another name, or within a folder that is replaced."""
    write(tmp_path / "run", "old")
    write_text(tmp_path / "data", "old")
    (tmp_path / "twin").hardlink_to(tmp_path / "data")
    with recorded_inputs():
        read_text(tmp_path / "data", "a text")
        for name in ("data", "twin"):
            with pytest.raises(OutputError, match="this command reads it"):
                write_text(tmp_path / name, "new")
        read_text(tmp_path / "run" / "b", "a text")
        with pytest.raises(OutputError, match=r"this command reads .*/b in it"):
            write(tmp_path / "run", "new")
    assert texts(tmp_path / "run") == ["old"] * 3
    assert (tmp_path / "data").read_text() == "old"
    with recorded_inputs():
        write_text(tmp_path / "data", "new")


def test_a_call_from_python_replaces_what_it_is_given(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("mine")
    with not_recorded():
        write_text(tmp_path / "a", "new")
        write_together(tmp_path, "newer")
    assert {path.name for path in tmp_path.iterdir()} == set(NAMES)


def test_somebodys_file_is_neither_replaced_nor_removed(tmp_path: Path) -> None:
    (tmp_path / "c").write_text("mine")
    with pytest.raises(OutputError, match=r"c: a file of that name exists that this program did not write"):
        write_together(tmp_path, "new")
    with (
        pytest.raises(OutputError, match="this program did not write"),
        files_together(tmp_path, NAMES) as new,
    ):
        (new / "a").write_text("new")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"c": "mine"}


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
    (folder / LISTING).unlink()
    with pytest.raises(OutputError, match="was not written"):
        write(folder, "newest")
    (folder / LISTING).write_text(json.dumps(["a"]))
    with pytest.raises(OutputError, match="was not written"):
        write(folder, "newest")


def test_an_existing_output_is_hashed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The option, the folder and the swap each ask whether the program wrote it; a change is noticed."""
    path = tmp_path / "a.txt"
    hashed: list[str] = []
    write_text(path, "old")
    monkeypatch.setattr(listing, "_SETTLED_NS", -1)
    monkeypatch.setattr(hashlib, "file_digest", _counting(hashed))
    listing.require_outputs(path)
    write_text(path, "new")
    assert [name for name in hashed if name == str(path)] == [str(path)]
    time.sleep(0.02)
    path.write_text("own")
    with pytest.raises(OutputError, match="changed since"):
        listing.require_outputs(path)


def _counting(names: list[str]) -> Callable[..., object]:
    digest = hashlib.file_digest

    def counted(stream: object, kind: str) -> object:
        names.append(stream.name)  # type: ignore[attr-defined]
        return digest(stream, kind)

    return counted


def test_links_pipes_and_devices_are_refused(tmp_path: Path) -> None:
    real, target = tmp_path / "real", tmp_path / "target"
    real.mkdir()
    target.write_text("mine")
    os.mkfifo(tmp_path / "pipe")
    links = {
        "to_folder": real,
        "to_file": target,
        "to_nothing": tmp_path / "none",
        "circle": tmp_path / "circle",
    }
    for name, end in links.items():
        (tmp_path / name).symlink_to(end)
        for writer in (write, write_together, write_text):
            with pytest.raises(OutputError, match="it is a link to"):
                writer(tmp_path / name, "text")
    for place in (tmp_path / "pipe", Path("/dev/null")):
        for writer in (write, write_text):
            with pytest.raises(OutputError, match="a device or a pipe"):
                writer(place, "text")
    assert {path.name for path in tmp_path.iterdir()} == {"real", "target", "pipe", *links}
    assert target.read_text() == "mine"
    write_text(tmp_path / "to_folder" / "below", "a link may lead to the folder")
    assert (real / "below").is_file()


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
    both = [writing(tmp_path, write_together, text, 150) for text in "xy"]
    for child in both:
        child.join(60.0)
    assert [child.exitcode for child in both] == [0, 0]
    assert len(set(texts(tmp_path))) == 1
    assert {path.name for path in tmp_path.iterdir()} == {*NAMES, LISTING}


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
