"""Which graphics card a rank takes, and whether there is one: said before anything is read or allocated."""

import importlib.util
import platform
from dataclasses import dataclass

from pmpm import estimate
from pmpm.scene.errors import SceneError

INSTALL = "pip install 'pmpm[cuda]'"
OLDEST_DRIVER = 13  # of CUDA, which the compiler of the extra `cuda` writes for


@dataclass(frozen=True)
class Cards:
    """What all ranks have taken, as a text, the least memory that one of them has free in bytes, and a warning or None."""

    text: str
    free: float
    warning: str | None


def take(comm):
    """Let this rank drive a card of its host, in turn. Returns the Cards. Collective. Raises SceneError, on all ranks, where
    one finds no card."""
    host = platform.node()
    place = comm.gather(host)[: comm.rank].count(host)
    problem, found = trouble(), None
    if problem is None:
        problem, found = opened(place)
    problems = [(rank, *said) for rank, said in enumerate(comm.gather((host, problem))) if said[1]]
    if problems:
        rank, name, text = problems[0]
        where = f" on {name}, rank {rank}; {len(problems)} of {comm.size} ranks say so" if comm.size > 1 else ""
        raise SceneError(f"--backend cuda: {text}{where}")
    cards = comm.gather(found)
    shared = len(cards) - len({(card["host"], card["id"]) for card in cards})
    warning = f"warning: {len(cards)} ranks share {len(cards) - shared} cards: give each its own" if shared else None
    names = sorted({card["name"] for card in cards})
    free = min(card["free"] for card in cards)
    text = f"{len(cards)} of {', '.join(names)}, {estimate.amount(free)} free on each"
    if comm.size > 1:
        text += f"; shared planes go {'from card to card' if comm.reaches_cards() else 'by way of the host'}"
    return Cards(text, free, warning)


def trouble():
    """What is missing for numba to reach a card, or None."""
    if importlib.util.find_spec("numba_cuda") is None:
        return f"the package numba-cuda is not installed: {INSTALL}"
    from numba import cuda

    if not cuda.is_available():
        reason = str(cuda.cuda_error() or "no card answers, or NVIDIA's compiler is missing").strip().splitlines()[0]
        return f"no NVIDIA driver or no card ({reason.rstrip('.')})"
    return None


def opened(place):
    """(problem, None) or (None, {host, id, name, free}) of the card for the rank that is `place`-th on its host."""
    from numba import cuda

    from pmpm.kernels.targets import card_is_simulated

    if card_is_simulated():
        return None, {
            "host": platform.node(),
            "id": place,
            "name": "a simulated card",
            "free": estimate.available_memory(),
        }
    driver = driver_version()
    if driver is not None and driver < (OLDEST_DRIVER, 0):
        return f"the driver knows CUDA {driver[0]}.{driver[1]}, {OLDEST_DRIVER}.0 is needed: update it", None
    count = len(cuda.gpus)
    if not count:
        return "the driver shows no card (CUDA_VISIBLE_DEVICES?)", None
    device = cuda.select_device(place % count)
    free, _ = cuda.current_context().get_memory_info()
    name = device.name.decode() if isinstance(device.name, bytes) else device.name
    return None, {"host": platform.node(), "id": str(device.uuid), "name": name, "free": free}


def driver_version():
    """(major, minor) of CUDA that the driver knows, or None."""
    from numba.cuda.cudadrv import driver

    try:
        return tuple(driver.driver.get_version())
    except (AttributeError, RuntimeError):
        return None


def refuse_memory(scene, free, ranks):
    """Raise SceneError where the scene takes more than `free` bytes on each of so many cards."""
    taken = of_scene(scene)
    if taken > free * ranks:
        raise SceneError(
            f"--backend cuda: the scene takes about {estimate.amount(taken)}, on {ranks} cards with {estimate.amount(free)} "
            f"free each: {int(-(-taken // free))} ranks, each with such a card, would do"
        )


def of_scene(scene):
    """Bytes on all cards together: particles and nodes."""
    from pmpm.explain import first_look

    needs, geometry, _ = first_look(scene)
    counts = estimate.particles(scene)
    return estimate.on_cards(needs, estimate.memory(scene, needs, geometry, counts), float(counts.sum()))
