"""What computes a rank's share of a step: the processor or a graphics card. Only what a run asks for is imported."""


def processor(simulation, backend, threads):
    """The processor of this rank: `backend` cpu, on so many threads, cuda, or plan, see there. Raises ValueError for another
    name, SceneError where a rank finds no card."""
    if backend == "cuda":
        from pmpm.processors import cards
        from pmpm.processors.cuda import Cuda

        cards.take(simulation.comm)
        return Cuda(simulation)
    if backend == "plan":
        from pmpm.processors.plan import Plan

        return Plan(simulation)
    if backend != "cpu":
        raise ValueError(f"backend = {backend!r}: must be cpu or cuda")
    from pmpm.processors.cpu import Cpu

    return Cpu(simulation, threads)
