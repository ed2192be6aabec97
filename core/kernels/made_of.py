"""What a kernel is made of: if any of it changes, the machine code that was kept on disk is another kernel's."""

import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.extending import _Intrinsic


@cache
def content(file: str) -> bytes:
    """What the file held when it was first asked for."""
    return Path(file).read_bytes()


@cache
def made_of(kernel: FunctionType) -> str:
    """A digest of the files of a kernel, of its parts, of intrinsics and of what these call,
    of the constants that they use, and of how all of it is compiled."""
    functions, files, constants = [kernel], {str(Path(__file__).with_name("compiled.py"))}, set()
    for function in functions:  # those that it names are added on the way
        files.add(function.__code__.co_filename)
        for name, value in _globals_in(function):
            if isinstance(value, int | float | tuple | np.generic | np.ndarray):
                constants.add(f"{name} = {value!r}")
            elif (called := _python_of(value)) and called not in functions:
                functions.append(called)
    contents = (content(file) for file in sorted(files))
    return hashlib.sha256(b"".join([*contents, *map(str.encode, sorted(constants))])).hexdigest()


def _globals_in(function: FunctionType) -> Iterator[tuple[str, object]]:
    """Names and values of the globals of a function, and of the modules among them what it takes from there."""
    names = set(_names_in(function.__code__))
    for name in names & function.__globals__.keys():
        value = function.__globals__[name]
        yield name, value
        if isinstance(value, ModuleType):
            yield from ((inner, vars(value)[inner]) for inner in names & vars(value).keys())


def _names_in(code: CodeType) -> Iterator[str]:
    """Names that a function uses, of globals and of attributes."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):  # a function in it
            yield from _names_in(constant)


def _python_of(value: object) -> FunctionType | None:
    """The Python function that this is or was; None if it is something else, or none of ours."""
    if isinstance(value, Dispatcher):
        return value.py_func
    if isinstance(value, _Intrinsic):
        return value._defn
    return value if isinstance(value, FunctionType) and value.__module__.startswith("core.") else None
