"""Linking of compiled functions: kernels have copies of their own, what only kernels call is bitcode.

Numba leaves what it does not inline to the linker as weak symbols, which take the first copy that the process has:
where the kernel is compiled, the callee by itself; where it is loaded, that of whichever kernel came first. Copies are
optimised with their callers, so that they differ in their last bits. And Numba makes machine code of every function by
itself, which is a tenth of the time until the first filter runs.
"""

from __future__ import annotations

from typing import Any

from llvmlite.binding import Linkage
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class _OwnCopies(JITCodeLibrary):
    """Library that calls its own copies of other functions, never those of other libraries of the process."""

    def _finalize_final_module(self) -> None:
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr:
                function.linkage = Linkage.internal
        super()._finalize_final_module()


class KernelCompiler(Compiler):
    """Numba's compiler, for code that has the same bits where it is compiled and where it is loaded."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function."""
        self.state.library = _OwnCopies(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        return super().compile_extra(func)


class _Bitcode(JITCodeLibrary):
    """Library that is optimised and linked into others, but not handed to the code generator."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class BitcodeCompiler(Compiler):
    """Numba's compiler without its last step, for functions that only kernels call."""

    def __init__(self, typing_context: Any, target_context: Any, library: Any, *arguments: Any) -> None:
        super().__init__(typing_context, target_context, library, *arguments)
        self.state.flags.no_compile = True
        if library is None:
            self.state.library = _Bitcode(self.state.targetctx.codegen(), "bitcode")
            self.state.library.enable_object_caching()

    def _compile_core(self) -> Any:
        result = super()._compile_core()
        handle: Any = [].append  # callers find the function by its entry point, of which each needs one of its own
        result.target_context.insert_user_function(handle, result.fndesc, [result.library])
        return result._replace(entry_point=handle)
