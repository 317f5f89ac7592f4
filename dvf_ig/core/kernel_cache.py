"""Compile kernels and keep them on disk, each valid for the digest of all sources that it may inline.

numba's own cache depends on the file of the outer kernel alone: after an edit to a function of another file
it keeps running the old one. Here every entry holds the digest of its package's kernel sources, and a process
with another digest compiles and replaces it. Index and entry are separate files, so both hold the digest:
neither a process that was killed between the two nor one of another version leaves old code under a new name.

A kernel that another kernel calls is a part of that kernel: it is typed and lowered once, and optimised and
turned into machine code only with each kernel that Python calls. numba does both for every function as well,
with all that it calls, which is most of the time of a deep tree of small functions.

A kernel that is compiled separately is no part of others: it is optimised once, and they call it through its
address, which each process writes into their code when it has compiled or loaded it.

Entries are where numba keeps them: in NUMBA_CACHE_DIR, else in `__pycache__` next to the source, else in the
user's cache folder. If none can be written, kernels work and are compiled again in each process.
"""

import ctypes
import hashlib
import logging
import os
import pickle
import sys
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numba
from numba.core import cgutils, compiler, serialize, sigutils
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache
from numba.core.ccallback import CFunc
from numba.core.codegen import JITCodeLibrary
from numba.core.environment import lookup_environment
from numba.core.registry import CPUDispatcher
from numba.core.typing import make_concrete_template

from .kernel_sources import KernelSources

_types: Any = numba.types
_LOGGER = logging.getLogger(__name__)


def compile_kernel(
    function: Callable[..., Any], sources: KernelSources, *, separately: bool = False, **options: Any
) -> Any:
    """Compile a function at its first call, or load it; `options` are those of `numba.njit`."""
    # stated, because numba otherwise takes it from the kernel that is being compiled at the first call
    options = {"nopython": True, "boundscheck": None, "forceinline": False, **options}
    compiled = (_SeparateKernel if separately else _Kernel)(function, targetoptions=options)
    compiled._cache = _cache_of(function, sources)
    return compiled


def compile_callback(function: Callable[..., Any], sources: KernelSources, signature: Any) -> Any:
    """Compile a function to a C callback, or load it, when its `address` is first asked for."""
    callback: Any = _Callback(
        function, sigutils.normalize_signature(signature), locals={}, options={"nopython": True}
    )
    callback._cache = _cache_of(function, sources)
    return callback


class _Callback(CFunc):
    """C callback that is compiled when its address is needed."""

    _wrapper_address: Any

    @property
    def address(self) -> Any:
        if self._wrapper_address is None:
            self.compile()
        return self._wrapper_address


class _Part(JITCodeLibrary):  # type: ignore[misc]
    """Code of a kernel within others, as it was lowered; it has no address."""

    def finalize(self) -> None:
        self._finalized = True

    def with_its_own(self) -> list[Any]:
        """Return this library and all that its code calls, to be linked with a caller."""
        return [self, *self._linking_libraries]


class _Kernel(CPUDispatcher):  # type: ignore[misc]
    """Kernel that is compiled where Python calls it, and a part of the code of each kernel that calls it."""

    def __init__(self, function: Callable[..., Any], **settings: Any) -> None:
        super().__init__(function, **settings)
        self._parts: dict[tuple[Any, ...], Any] = {}

    def compile(self, signature: Any) -> Any:
        entry_point = super().compile(signature)
        arguments, _ = sigutils.normalize_signature(signature)
        result = self.overloads[tuple(arguments)]
        for variable in result.library._final_module.global_variables:
            environment = lookup_environment(variable.name)
            if environment is not None:  # also those of its parts, which have no address of their own
                result.codegen.set_env(variable.name, environment)
        _write_addresses(result.library.codegen, _calls(result))
        return entry_point

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return the types of a call by another kernel."""
        signature, arguments = self._compiler.fold_argument_types(args, kws)
        with self._compiling_counter:
            self._part(tuple(arguments))
        signatures = [part.signature for part in self._parts.values()]
        template = make_concrete_template(self.__name__, key=self.__name__, signatures=signatures)
        return template, signature, arguments, {}

    def get_overload(self, sig: Any) -> Any:
        """Return the key under which numba looks up the code for a call by another kernel."""
        arguments, _ = sigutils.normalize_signature(sig)
        return self._parts[tuple(arguments)].library

    def _part(self, arguments: tuple[Any, ...]) -> None:
        if arguments in self._parts:
            return
        flags = compiler.Flags()
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        library = _Part(self.targetctx.codegen(), self.__qualname__)
        part = compiler.compile_extra(
            self.typingctx,
            self.targetctx,
            self.py_func,
            args=arguments,
            return_type=None,
            flags=flags,
            locals={},
            library=library,
        )
        self.targetctx.insert_user_function(library, part.fndesc, library.with_its_own())
        self._parts[arguments] = part


class _SeparateKernel(_Kernel):
    """Kernel that others call through its address, which is in a variable of their code."""

    def __init__(self, function: Callable[..., Any], **settings: Any) -> None:
        super().__init__(function, **settings)
        self.name = f"{function.__module__}.{function.__qualname__}"
        _SEPARATE[self.name] = self

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return super().get_call_template(tuple(map(_types.unliteral, args)), kws)

    def get_overload(self, sig: Any) -> Any:
        """Return the name of the variable with the address of the code for a call by another kernel."""
        return self._variable(sigutils.normalize_signature(sig)[0])

    def write_address(self, codegen: Any, arguments: tuple[Any, ...]) -> None:
        """Write the address of the code for arguments of these types to where its callers look for it."""
        self.compile(arguments)
        result = self.overloads[arguments]
        address = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
        place = codegen._engine.get_global_value_address(self._variable(arguments))
        if not address or not place:
            raise RuntimeError(f"no code, or no caller, of {self.name} in this process")
        ctypes.c_void_p.from_address(place).value = address

    def _part(self, arguments: tuple[Any, ...]) -> None:
        if arguments in self._parts:
            return
        self.compile(arguments)
        part, variable = self.overloads[arguments], self._variable(arguments)
        self.targetctx.insert_func_defn([(_call_through(variable), variable, part.signature.args)])
        _CALLED[variable] = (self.name, arguments)
        self._parts[arguments] = part

    def _variable(self, arguments: tuple[Any, ...]) -> str:
        """Return a name that is the same in every process; numba's own hold numbers of types in one."""
        return f"{self.name}.{hashlib.sha256(repr(arguments).encode()).hexdigest()}"


_Call = tuple[str, tuple[Any, ...]]
"""A separate kernel's name, and the types of the arguments."""
_SEPARATE: dict[str, _SeparateKernel] = {}
_CALLED: dict[str, _Call] = {}
"""Kernel and types behind the address that a variable holds."""


def _call_through(variable: str) -> Callable[..., Any]:
    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        result, kinds = signature.return_type, signature.args
        place = context.declare_env_global(builder.module, variable)
        function = builder.bitcast(
            builder.load(place), context.call_conv.get_function_type(result, kinds).as_pointer()
        )
        status, value = context.call_conv.call_function(builder, function, result, kinds, args)
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return value

    return build


def _calls(compiled: Any) -> list[_Call]:
    """Return the calls of separate kernels in code that was compiled in this process."""
    names = (variable.name for variable in compiled.library._final_module.global_variables)
    return [_CALLED[name] for name in names if name in _CALLED]


def _write_addresses(codegen: Any, calls: list[_Call]) -> None:
    for name, arguments in calls:
        _SEPARATE[name].write_address(codegen, arguments)


def _cache_of(function: Callable[..., Any], sources: KernelSources) -> Any:
    try:
        return _KernelCache(function, sources)
    except RuntimeError:  # numba found no folder that can be written
        return _NoCache()


def _version(sources: KernelSources) -> str:
    """Return numba's version, that of the form of entries, and the digest of the sources."""
    return f"{numba.__version__} 2 {sources.digest}"


class _Entries(CompileResultCacheImpl):  # type: ignore[misc]
    """Entries that hold the digest of their sources, in one file for each kernel and signature."""

    if not os.path.isabs(os.path.expanduser("~")):  # no home: numba would make a folder `~` where it runs
        _locator_classes = tuple(
            locator
            for locator in CompileResultCacheImpl._locator_classes
            if "UserWide" not in locator.__name__
        )

    def __init__(self, function: Callable[..., Any], sources: KernelSources) -> None:
        self.digest = _version(sources)
        super().__init__(function)

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """Return the file name without numba's line number, so that moved functions leave no old files."""
        plain = fullname.replace("<", "").replace(">", "")
        return f"{plain}.{sys.implementation.cache_tag}{abiflags}"

    def reduce(self, compiled: Any) -> tuple[str, bytes]:
        return self.digest, serialize.dumps((super().reduce(compiled), _calls(compiled)))

    def rebuild(self, target_context: Any, entry: tuple[str, bytes]) -> Any:
        """Return the compiled function, or None if it comes from other sources."""
        digest, content = entry
        if digest != self.digest:
            return None
        reduced, calls = pickle.loads(content)
        compiled = super().rebuild(target_context, reduced)
        _write_addresses(compiled.library.codegen, calls)
        return compiled


class _KernelCache(FunctionCache):  # type: ignore[misc]
    def __init__(self, function: Callable[..., Any], sources: KernelSources) -> None:
        self._sources = sources
        self._impl_class = partial(_Entries, sources=sources)
        super().__init__(function)
        # an index of other sources is not unpickled: it may hold types that no longer exist
        self._cache_file._version = _version(sources)

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(signature, target_context)
        except OSError:
            return None  # saving also fails, and reports why

    def save_overload(self, signature: Any, compiled: Any) -> None:
        if not self._sources.unchanged():
            return  # edited while this process runs: the code in memory may be a mixture
        try:
            super().save_overload(signature, compiled)
        except OSError as error:
            self.disable()
            _say_not_kept(str(error))


class _NoCache(NullCache):  # type: ignore[misc]
    def save_overload(self, signature: Any, compiled: Any) -> None:
        _say_not_kept("no folder for them can be written")


@cache
def _say_not_kept(reason: str) -> None:
    _LOGGER.warning(
        "compiled kernels are not kept, so each process compiles its own (%s); "
        "set NUMBA_CACHE_DIR to a folder that can be written",
        reason,
    )
