"""Compiled kernels on disk: used again while no source changes, never after an edit to what they inline."""

import ast
import importlib
import inspect
import json
import os
import pkgutil
import shutil
import subprocess
import sys
from pathlib import Path
from types import CodeType

import pytest
from numba.core.caching import NullCache
from numba.core.ccallback import CFunc
from numba.core.dispatcher import Dispatcher
from numba.extending import _Intrinsic

import data_synth.kernels
import dvf_ig.kernels
from dvf_ig.kernels.compiled import inlined, kernel, separate

REPO = Path(dvf_ig.__file__).parent.parent
COMPILED = (CFunc, Dispatcher, _Intrinsic)


@kernel
def half(x):
    if x < 0.0:
        raise ValueError("negative")
    return 0.5 * x


@kernel
def quarter(x):
    return half(half(x))


def test_a_kernel_is_a_part_of_its_callers_and_compiled_alone_only_for_python():
    assert quarter(8.0) == 2.0
    assert not half.overloads  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="negative"):
        quarter(-8.0)
    assert half(3.0) == 1.5


@kernel
def third(x):
    return x / 3.0


@inlined
def ninth(x):
    return third(third(x))


@kernel
def twenty_seventh(x):
    return third(ninth(x))


def test_a_kernel_that_an_inlined_one_calls_first_is_not_inlined_itself(monkeypatch):
    """numba gives a function without the flag that of the kernel whose compilation asks for it first."""
    monkeypatch.setattr(twenty_seventh, "_cache", NullCache())  # compiled here and not by an earlier run
    assert twenty_seventh(54.0) == 2.0
    for compiled, flag in ((third, False), (ninth, True)):
        (part,) = compiled._parts.values()  # type: ignore[attr-defined]
        assert ("alwaysinline" in str(part.library._final_module)) is flag


@separate
def root(x, times):
    if x < 0.0:
        raise ValueError("negative")
    return times * x**0.5


@kernel
def root_of_half(x):
    return root(half(x), 1)


@kernel
def twice_the_root(x, used):
    return root(x, 2) if used else 0.0


def test_a_separate_kernel_is_compiled_once_for_all_that_call_it():
    assert (root_of_half(8.0), twice_the_root(9.0, True)) == (2.0, 6.0)
    assert len(root.overloads) == 1  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="negative"):
        twice_the_root(-8.0, True)
    for caller in (root_of_half, twice_the_root):
        (code,) = vars(caller)["overloads"].values()
        assert not [f for f in code.library.get_defined_functions() if "4root" in f.name]


FORKS = """
import json, os, runpy, sys, traceback
import numba.core.caching, numba.core.ccallback, numba.core.registry

numba.njit(lambda x: 3.0 * x)(2.0)  # loads what every compilation needs
for line in sys.stdin:
    folder, arguments, environment = json.loads(line)
    if process := os.fork():
        print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)
        continue
    for number, name in ((1, "said.out"), (2, "said.err")):
        os.dup2(os.open(os.path.join(folder, name), os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    os.environ.clear()
    os.environ.update(environment)
    numba.config.reload_config()
    sys.path.insert(0, folder)
    sys.argv = ["call.py", *arguments]
    os.chdir(folder)
    code = 1
    try:
        runpy.run_path("call.py", run_name="__main__")
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)
"""


@pytest.fixture(scope="module")
def forks():
    """A process that has loaded numba, and forks one for each line that it reads."""
    with subprocess.Popen(
        [sys.executable, "-B", "-c", FORKS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield process


def edit(path, old, new):
    """Replace text by text of the same length; neither size nor time of the file changes."""
    before, content = path.stat(), path.read_text()
    assert content.count(old) == 1
    assert len(old) == len(new)
    path.write_text(content.replace(old, new))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


@pytest.fixture
def tiny(tmp_path):
    """A package of two kernels, of which one is inlined into the other's file, and a script that calls it.

    Beside them nothing of dvf_ig but what keeps kernels.
    """
    core = tmp_path / "dvf_ig" / "core"
    core.mkdir(parents=True)
    for path in (core.parent / "__init__.py", core / "__init__.py"):
        path.touch()
    for name in ("kernel_cache.py", "kernel_sources.py"):
        shutil.copy(REPO / "dvf_ig" / "core" / name, core)
    package = tmp_path / "tiny"
    package.mkdir()
    (package / "__init__.py").write_text(inspect.getsource(dvf_ig.kernels))
    (package / "law.py").write_text(
        "from dvf_ig.core.kernel_cache import compile_kernel\n"
        "from . import SOURCES\n"
        "def law(x):\n"
        "    return 3.0 * x\n"
        "law = compile_kernel(law, SOURCES)\n"
    )
    (package / "outer.py").write_text(
        "from dvf_ig.core.kernel_cache import compile_kernel\n"
        "from . import SOURCES\n"
        "from .law import law\n"
        "def outer(x):\n"
        "    return law(x) + 1.0\n"
        "outer = compile_kernel(outer, SOURCES)\n"
    )
    (tmp_path / "call.py").write_text(
        "import logging, shutil, sys\n"
        "from pathlib import Path\n"
        "from tiny.outer import outer\n"
        "exec(sys.argv[1] if len(sys.argv) > 1 else '')\n"
        "value = outer(2.0)\n"
        "print(value, sum(outer.stats.cache_hits.values()))\n"
    )
    return package


@pytest.fixture
def called(tiny, forks):
    """The outer kernel's value at 2, whether it was read from disk, and what was said."""
    inherited = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}

    def called(*arguments, **environment):
        request = (str(tiny.parent), arguments, inherited | environment)
        forks.stdin.write(json.dumps(request) + "\n")
        forks.stdin.flush()
        assert forks.stdout.readline() == "0\n", (tiny.parent / "said.err").read_text()
        value, hits = (tiny.parent / "said.out").read_text().split()
        return float(value), int(hits) == 1, (tiny.parent / "said.err").read_text()

    return called


def test_kept_until_a_source_changes(tiny, called):
    assert called() == (7.0, False, "")
    assert called() == (7.0, True, "")
    (entry,) = (tiny / "__pycache__").glob("outer.*.nbc")
    of_the_old_law = entry.read_bytes()
    edit(tiny / "law.py", "3.0", "5.0")
    assert called() == (11.0, False, "")
    # what a process leaves that is killed between the two files, or that runs another version
    entry.write_bytes(of_the_old_law)
    assert called() == (11.0, False, "")
    files = sorted(path.name for path in (tiny / "__pycache__").iterdir())
    edit(tiny / "law.py", "5.0", "3.0")
    (tiny / "outer.py").write_text("\n\n" + (tiny / "outer.py").read_text())
    assert called() == (7.0, False, "")
    assert sorted(path.name for path in (tiny / "__pycache__").iterdir()) == files, "nothing is left behind"


def test_a_separate_kernel_is_kept_by_itself(tiny, called):
    source = (tiny / "law.py").read_text().replace("SOURCES)", "SOURCES, separately=True)")
    (tiny / "law.py").write_text(source)
    assert called() == (7.0, False, "")
    for entry in (tiny / "__pycache__").glob("law.law.*.nb?"):
        entry.unlink()
    assert called() == (7.0, True, "")
    edit(tiny / "law.py", "3.0", "5.0")
    assert called() == (11.0, False, "")


def test_nothing_is_kept_of_sources_that_change_while_a_process_runs(tiny, called):
    change = "law = Path('tiny/law.py'); law.write_text(law.read_text().replace('3.0', '5.0'))"
    assert called(change) == (7.0, False, "")
    assert not list(tiny.rglob("*.nbc"))
    assert called() == (11.0, False, "")


def test_without_a_folder_that_can_be_written(tiny, called):
    (tiny / "__pycache__").write_text("in the way")
    nowhere = {"HOME": str(tiny / "law.py"), "XDG_CACHE_HOME": str(tiny / "law.py")}
    value, read, said = called(**nowhere)
    assert (value, read) == (7.0, False)
    assert said.count("set NUMBA_CACHE_DIR to a folder that can be written") == 1
    given = {**nowhere, "NUMBA_CACHE_DIR": str(tiny.parent / "kept")}
    assert called(**given) == (7.0, False, "")
    assert list((tiny.parent / "kept").rglob("outer.*.nbc"))


def test_a_folder_that_can_no_longer_be_written(tiny, called):
    lost = "shutil.rmtree('tiny/__pycache__'); Path('tiny/__pycache__').write_text('in the way')"
    value, _, said = called(lost)
    assert value == 7.0
    assert said.count("set NUMBA_CACHE_DIR") == 1


def test_no_home_no_folder_called_tilde(tiny, called):
    (tiny / "__pycache__").write_text("in the way")
    homeless = "import os, pwd; del os.environ['HOME']; pwd.getpwuid = {}.__getitem__\n"
    (tiny.parent / "call.py").write_text(homeless + (tiny.parent / "call.py").read_text())
    value, _, said = called()
    assert value == 7.0
    assert "NUMBA_CACHE_DIR" in said
    assert not (tiny.parent / "~").exists()


@pytest.mark.parametrize("package", [dvf_ig.kernels, data_synth.kernels])
def test_kernels_inline_nothing_of_other_packages(package):
    """A function or number from elsewhere would be compiled in without being in the digest."""
    seen = 0
    for info in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        module = importlib.import_module(info.name)
        tree = ast.parse(inspect.getsource(module))
        foreign = {
            alias.asname or alias.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module is not None
            if node.module.split(".")[0] in ("dvf_ig", "data_synth")
            if not node.module.startswith(package.__name__)
            for alias in node.names
        }
        functions = [inspect.unwrap(v) for v in vars(module).values() if isinstance(v, COMPILED)]
        seen += len(functions)
        for function in functions:
            assert not foreign & names_used(function.__code__), f"{info.name}.{function.__name__}"
    assert seen > 50


def names_used(code):
    within = [names_used(constant) for constant in code.co_consts if isinstance(constant, CodeType)]
    return set(code.co_names).union(*within)
