"""Numba's compiler with only the passes that kernels need, and a lighter one for inner kernels.

An inner kernel is one that another kernel calls. Numba would give it machine code and a wrapper for
Python too. Its passes also serve features that no kernel uses: closures, ``with`` blocks, parallel
loops. All that takes 3 tenths of the time.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba._dynfunc import make_function  # type: ignore[import-not-found]
from numba.core import compiler, typed_passes, untyped_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_machinery import PassManager, register_pass

FRONT = (
    untyped_passes.TranslateByteCode,
    untyped_passes.FixupArgs,
    untyped_passes.IRProcessing,
    untyped_passes.GenericRewrites,
    untyped_passes.InlineInlinables,
    untyped_passes.ReconstructSSA,
    typed_passes.NopythonTypeInference,
    typed_passes.PreLowerStripPhis,
    typed_passes.NopythonRewrites,
    typed_passes.IRLegalization,
)


class Kernel(compiler.CompilerBase):
    """Compiles a kernel that Python calls."""

    lowering: type = typed_passes.NativeLowering

    def define_pipelines(self) -> list[Any]:
        """Numba's own passes that kernels need, in Numba's order."""
        passes = PassManager("kernel")
        for each in (*FRONT, self.lowering, typed_passes.NoPythonBackend):
            passes.add_pass(each, each.__name__)
        passes.finalize()
        return [passes]

    def compile_extra(self, function: Any) -> Any:
        """Compile without garbage collections, which take a tenth of the time."""
        with _no_collections():
            return super().compile_extra(function)


@register_pass(mutates_CFG=True, analysis_only=False)
class InnerLowering(typed_passes.NativeLowering):
    """Numba's lowering, without machine code and without a way in for Python."""

    _name = "inner_lowering"

    def run_pass(self, state: Any) -> bool:
        """Lower, and tell Numba's other kernels what to link."""
        state.library = InnerLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.reorder = bool(state.flags.fastmath)
        state.flags.no_compile = True
        super().run_pass(state)
        found = state.cr
        # the result needs a function as its key; nothing calls it
        key = make_function(
            found.fndesc.lookup_module(), state.func_id.func_name, "", 0, found.env, ()
        )
        state.targetctx.insert_user_function(key, found.fndesc, [state.library])
        state.cr = found._replace(cfunc=key)
        return True


class InnerKernel(Kernel):
    """Compiles a kernel for other kernels, which link and optimise it."""

    lowering = InnerLowering


class InnerLibrary(JITCodeLibrary):
    """Code to be linked: the intermediate form, no machine code.

    Attributes
    ----------
    reorder : bool
        Whether to optimise it alone first. Then sums have one order, whoever calls it.
    """

    reorder = False

    def _optimize_final_module(self) -> None:
        if self.reorder:
            super()._optimize_final_module()

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@contextmanager
def _no_collections() -> Iterator[None]:
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
