"""Compiling the many small functions a kernel is made of, without paying for each what a function of its own costs.

numba compiles every function to the end: wrappers that call it from Python and from C, machine code, room for both. Here only
entries, which Python calls, get these; the functions they call are parts: optimised LLVM code, inlined into entries. Entries
come out as they would from numba alone, to the bit; they take half the time. LLVM's passes over each part are among what
makes them the same: left out, products and sums contract differently in some kernels.
This file and targets.py are the ones that lean on numba's internals; pyproject.toml pins numba for them.
"""

import gc
import operator
from types import CodeType

from numba.core import funcdesc, lowering, sigutils, typed_passes, untyped_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, _LowerResult
from numba.core.compiler_machinery import LoweringPass, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering
from numba.core.typing import arraydecl, builtins
from numba.core.typing.templates import infer_global


def simplify(library, module):
    """Run LLVM's passes over each function the module defines; numba makes them for those it only declares as well."""
    module.data_layout = library.codegen._data_layout
    for function in module.functions:
        if not function.is_declaration:
            passes, builder = library.codegen._function_pass_manager()
            passes.run(function, builder)


def try_first(template, function):
    """Let numba try this meaning of a function before those for any target, of which `[]` has some thirty.

    It finds the same one, sooner.
    """
    infer_global(function)(type(template.__name__, (template,), {"metadata": ON_CPU}))


ON_CPU = {"target": "cpu"}
try_first(arraydecl.GetItemBuffer, operator.getitem)
try_first(arraydecl.SetItemBuffer, operator.setitem)
try_first(builtins.Bool, bool)


class PartLibrary(JITCodeLibrary):
    """The code of one part with what it calls inlined, for entries and other parts to inline."""

    _optimize_functions = simplify

    def _finalize_final_module(self):
        self._finalized = True  # no machine code

    def get_pointer_to_function(self, name):
        return 0


class EntryLibrary(JITCodeLibrary):
    """The code of an entry with its parts inlined."""

    _optimize_functions = simplify


@register_pass(mutates_CFG=True, analysis_only=False)
class LowerPart(LoweringPass):
    """numba's lowering without wrappers and machine code."""

    _name = "lower_part"

    def __init__(self):
        pass

    def run_pass(self, state):
        context, flags = state.targetctx, state.flags
        library = state["library"] = PartLibrary(context.codegen(), state.func_id.func_qualname)
        description = funcdesc.PythonFunctionDescriptor.from_specialized_function(
            state.func_ir,
            state.typemap,
            state.return_type,
            state.calltypes,
            mangler=context.mangler,
            inline=flags.forceinline,
            noalias=flags.noalias,
            abi_tags=[flags.get_mangle_string()],
        )
        with context.push_code_library(library):
            lower = lowering.Lower(context, library, description, state.func_ir, metadata=state.metadata)
            lower.lower()
        library._ensure_finalized()
        name = Place(description.mangled_name)
        context.insert_user_function(name, description, [library])
        state["cr"] = _LowerResult(description, lower.call_helper, cfunc=name, env=lower.env)
        return True


class Place:
    """What numba looks the code of a part up by."""

    def __init__(self, name):
        self.name = name


@register_pass(mutates_CFG=True, analysis_only=False)
class LowerEntry(NativeLowering):
    """numba's lowering."""

    _name = "lower_entry"

    def run_pass(self, state):
        library = state["library"] = EntryLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        library.enable_object_caching()
        return super().run_pass(state)


def pipeline(state, lowering_pass, unneeded=()):
    """numba's passes with another last one."""
    passes = DefaultPassBuilder.define_nopython_pipeline(state)
    passes.passes = [
        (lowering_pass if p is NativeLowering else p, description)
        for p, description in passes.passes
        if p not in unneeded
    ]
    passes.finalize()
    return [passes]


# Passes for what parts do not hold: `with`, closures, comprehensions, expressions of whole arrays, literals to unroll.
FOR_ENTRIES = (
    untyped_passes.WithLifting,
    untyped_passes.InlineClosureLikes,
    untyped_passes.RewriteDynamicRaises,
    untyped_passes.MakeFunctionToJitFunction,
    untyped_passes.InlineInlinables,
    untyped_passes.FindLiterallyCalls,
    untyped_passes.LiteralUnroll,
    untyped_passes.LiteralPropagationSubPipelinePass,
    typed_passes.NopythonRewrites,
    typed_passes.DumpParforDiagnostics,
)


class EntryCompiler(CompilerBase):
    """numba's compiler for functions that Python calls."""

    def compile_extra(self, func):
        """Compile with all parts. A search for cyclic garbage walks all that numba holds: one, afterwards, is enough."""
        collecting = gc.isenabled()
        gc.disable()
        try:
            return super().compile_extra(func)
        finally:
            if collecting:
                gc.enable()

    def define_pipelines(self):
        return pipeline(self.state, LowerEntry)


class PartCompiler(CompilerBase):
    """numba's compiler for functions that only compiled ones call."""

    def define_pipelines(self):
        nested = any(isinstance(constant, CodeType) for constant in self.state.func_id.code.co_consts)
        return pipeline(self.state, LowerPart, () if nested else FOR_ENTRIES)


class Part(CPUDispatcher):
    """A function for kernels to call."""

    def __init__(self, function, options):
        super().__init__(function, targetoptions=options | {"nopython": True}, pipeline_class=PartCompiler)

    def __call__(self, *arguments):
        raise TypeError(f"{self.py_func.__name__} is part of a kernel: Python cannot call it")

    def compile(self, sig):
        arguments, result = sigutils.normalize_signature(sig)
        compiled = self.overloads.get(tuple(arguments))
        if compiled is None:
            with self._compiling_counter:
                compiled = self._compiler.compile(arguments, result)
            self.overloads[tuple(arguments)] = compiled
        return compiled.entry_point
