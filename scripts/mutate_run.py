"""Apply named mutants to a copy of the tree, one at a time, and list which tests failed: `scripts/mutate`."""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import Queue

REPO = Path(__file__).resolve().parent.parent
COPIED = ("pyproject.toml", "dvf_ig", "data_synth", "tests")
WANTED_SHARE = 0.9
SECONDS = 600
"""Time above which a test run counts as failed: the mutant made it hang."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """Change to the code, and the tests that should notice it."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Outcome:
    name: str
    fell: tuple[str, ...]


def main() -> int:
    arguments = _arguments()
    mutants = _mutants(arguments.names)
    if arguments.list:
        for mutant in mutants:
            print(f"{mutant.name:<44} {mutant.file}")
        return 0
    _refuse_stale(mutants)
    with tempfile.TemporaryDirectory() as folder:
        trees: Queue[Path] = Queue()
        for k in range(arguments.jobs):
            trees.put(_copy(Path(folder) / f"tree{k}"))
        _refuse_broken(trees, mutants)
        with ThreadPoolExecutor(arguments.jobs) as pool:
            outcomes = list(pool.map(lambda mutant: _outcome(trees, mutant), mutants))
    return _report(outcomes, complete=not arguments.names)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="mutants to apply; default: all")
    parser.add_argument("--list", action="store_true", help="print the mutants and end")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="mutants at a time")
    return parser.parse_args()


def _mutants(names: list[str]) -> list[Mutant]:
    document = tomllib.loads((REPO / "scripts" / "mutants.toml").read_text())
    mutants = [Mutant(**{**entry, "tests": tuple(entry["tests"])}) for entry in document["mutant"]]
    defined = {mutant.name for mutant in mutants}
    if unknown := sorted(set(names) - defined):
        sys.exit(f"mutate: no mutant is called {', '.join(unknown)}; --list names them all")
    return [mutant for mutant in mutants if not names or mutant.name in names]


def _refuse_stale(mutants: list[Mutant]) -> None:
    """Refuse mutants whose text is not in its file exactly once, or whose tests are gone."""
    stale = []
    for mutant in mutants:
        path = REPO / mutant.file
        count = path.read_text().count(mutant.old) if path.is_file() else 0
        if count != 1:
            stale.append(f"{mutant.name}: its text occurs {count} times in {mutant.file}")
        stale += [f"{mutant.name}: there is no {t}" for t in mutant.tests if not (REPO / t).exists()]
    if stale:
        sys.exit("mutate: bring scripts/mutants.toml up to date:\n  " + "\n  ".join(stale))


def _copy(tree: Path) -> Path:
    tree.mkdir()
    for name in COPIED:
        source = REPO / name
        if source.is_dir():
            shutil.copytree(source, tree / name)
        else:
            shutil.copy2(source, tree / name)
    return tree


def _refuse_broken(trees: "Queue[Path]", mutants: list[Mutant]) -> None:
    """Refuse tests that fail without any mutant, as these would count as having noticed."""
    tree = trees.get()
    tests = sorted({test for mutant in mutants for test in mutant.tests})
    fell = _failed_tests(tree, tests, 10 * SECONDS)
    trees.put(tree)
    if fell:
        sys.exit("mutate: these tests fail without any mutant; repair them first:\n  " + "\n  ".join(fell))


def _outcome(trees: "Queue[Path]", mutant: Mutant) -> Outcome:
    tree = trees.get()
    path = tree / mutant.file
    original = path.read_text()
    try:
        path.write_text(original.replace(mutant.old, mutant.new))
        outcome = Outcome(mutant.name, tuple(_failed_tests(tree, list(mutant.tests))))
    finally:
        path.write_text(original)
        trees.put(tree)
    print(f"{mutant.name:<44} {_words(outcome)}", flush=True)
    return outcome


def _failed_tests(tree: Path, tests: list[str], timeout_s: float = SECONDS) -> list[str]:
    """List the tests that failed; "(hangs)" if they did not end."""
    data = os.environ.get("DVF_IG_DATA", str(REPO / ".." / "shared" / "data"))
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "--no-header",
        "--tb=no",
        "-p",
        "no:cacheprovider",
        *tests,
    ]
    environment = {**os.environ, "PYTHONPATH": str(tree), "DVF_IG_DATA": data, "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        run = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except subprocess.TimeoutExpired:
        return ["(hangs)"]
    fell = re.findall(r"^(?:FAILED|ERROR) (\S+)", run.stdout, flags=re.MULTILINE)
    if run.returncode not in (0, 1) and not fell:
        return [f"(pytest ended with {run.returncode})"]
    return fell


def _words(outcome: Outcome) -> str:
    if not outcome.fell:
        return "SURVIVED"
    more = f" and {len(outcome.fell) - 1} more" if len(outcome.fell) > 1 else ""
    return f"{outcome.fell[0]}{more}"


def _report(outcomes: list[Outcome], *, complete: bool) -> int:
    """Print the share, and write it if no mutant was left out."""
    killed = [o for o in outcomes if o.fell]
    share = len(killed) / len(outcomes)
    print(f"{len(killed)} of {len(outcomes)} mutants were killed")
    if complete:
        (REPO / "out").mkdir(exist_ok=True)
        document = {"share": share, "mutants": [asdict(o) for o in outcomes]}
        (REPO / "out" / "mutants.json").write_text(json.dumps(document, indent=1) + "\n")
        print("wrote out/mutants.json")
    return 0 if share >= WANTED_SHARE else 7


if __name__ == "__main__":
    sys.exit(main())
