"""The loops over nodes of a scene, for patches whose nodes a test marks itself, without particles."""

import functools
from types import SimpleNamespace

from pmpm.kernels import loops, spans, targets
from pmpm.kernels.build import LAYING_OUT, PER_CUT


@functools.cache
def kernels(real):
    """Entries of the halo and of the layout, and `fold_layer`."""
    targets.use_cache_folder()
    target = targets.scalar(real)
    entries = {name: target.entry(getattr(loops, name)) for name in PER_CUT}
    entries |= {name: target.entry(getattr(spans, name)) for name in LAYING_OUT}
    return SimpleNamespace(**entries, fold_layer=target.compile(loops.fold_layer))


def lay_out(patch, mark):
    """Let a patch take the nodes that `mark(marks)` marks in (layers, rows, words), see kernels.spans."""
    patch.lay_out(lambda marks, slack: mark(marks), kernels(patch.real), [])
