"""Triton's interpreter in a quarter of the time, with the same results."""

from dataclasses import replace
from types import SimpleNamespace

from triton import language
from triton.runtime import interpreter

NOTHING_TO_RESTORE = SimpleNamespace(restore=lambda: None)


def hasten():
    """From here on, two things that it does in vain are left out.

    Whether a sum of integers overflows is computed, but asserted with the option `debug` alone. And while a kernel
    runs, the functions of `triton.language` are replaced by interpreted ones, anew whenever it calls a function of its
    own.
    """
    builder = interpreter.interpreter_builder
    builder.options = replace(builder.options, sanitize_overflow=False)
    replace_language = interpreter._patch_lang

    def replace_unless_done(function):
        modules = [
            module
            for module in (language, language.core)
            if any(module is value for value in function.__globals__.values())
        ]
        if any(language.core.is_builtin(module.load) for module in modules):  # one function stands for all
            return replace_language(function)
        return NOTHING_TO_RESTORE

    interpreter._patch_lang = replace_unless_done
