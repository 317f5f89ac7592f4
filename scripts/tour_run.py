"""Run the tours of the guide: ``bash`` blocks line by line in a folder, ``python`` blocks as one program."""

import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
GUIDE = ROOT / "dvf_ig" / "docs" / "guide"
TOURS = ("tour.md", "own-tour.md", "python-tour.md")
BLOCK = re.compile(r"^```(bash|python)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Program:
    """Program that is run at once: a shell command, or Python."""

    page: str
    language: str
    text: str


def programs_of(page: str, markdown: str) -> list[Program]:
    """List each command of a page, and all of its Python together."""
    programs: list[Program] = []
    python: list[str] = []
    for language, text in BLOCK.findall(markdown):
        if language == "python":
            python.append(text)
        else:
            joined = text.replace("\\\n", " ")
            programs += [Program(page, "bash", line) for line in joined.splitlines() if line.strip()]
    if python:
        programs.append(Program(page, "python", "\n".join(python)))
    return programs


def run(program: Program, folder: Path) -> Path:
    """Run a program and return the folder in which it ends.

    Raises:
        subprocess.CalledProcessError: it ended with another exit code than 0.
    """
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path}
    if program.language == "python":
        subprocess.run([sys.executable, "-c", program.text], cwd=folder, env=environment, check=True)
        return folder
    words = program.text.split()
    if words[0] == "cd":
        return folder / words[1]
    subprocess.run(["bash", "-euc", program.text], cwd=folder, env=environment, check=True)
    return folder


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        base = Path(sys.argv[1] if len(sys.argv) > 1 else scratch).resolve()
        base.mkdir(parents=True, exist_ok=True)
        for page in TOURS:
            folder = base
            for program in programs_of(page, (GUIDE / page).read_text(encoding="utf-8")):
                shown = program.text if program.language == "bash" else "its Python"
                print(f"\n== {page}: {shown}", flush=True)
                begin = time.perf_counter()
                folder = run(program, folder)
                print(f"-- {time.perf_counter() - begin:.1f} s", flush=True)


if __name__ == "__main__":
    main()
