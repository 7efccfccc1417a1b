"""The halo sum after P2G: one message per cut and direction, and the same ordered sum on both sides (see slabs).

A message holds, of each of its planes, the box that is not zero, and what is in it.
"""

import numpy as np

from pmpm.kernels.loops import EMPTY_BOX


class Message:
    """Bytes on their way: boxes (planes, 4) int64, then the reals of the boxes."""

    def __init__(self, planes, shape, real):
        boxes = planes * len(EMPTY_BOX) * 8
        self.bytes = np.zeros(boxes + planes * int(np.prod(shape)) * np.dtype(real).itemsize, np.uint8)
        self.boxes = self.bytes[:boxes].view(np.int64).reshape(planes, len(EMPTY_BOX))
        self.reals = self.bytes[boxes:].view(real)

    def packed(self, pack, planes, boxes):
        """The bytes that hold what the boxes of these planes do."""
        used = pack(planes, boxes, self.boxes, self.reals)
        return self.bytes[: self.boxes.nbytes + used * self.reals.itemsize]


class Halo:
    """Exchanges the shared planes of one rank's patch. Buffers are allocated once per set of cuts.

    `targets[layer, k]` tells P2G where plane k of a layer's window goes; `unsummed` and `slot_boxes` hold the planes that the
    rank which sums before this one needs unsummed.
    """

    def __init__(self, comm, slabs, patch, kernels):
        first, last = slabs.owned(comm.rank)
        window = patch.windows.shape[1]
        self.comm, self.patch, self.kernels = comm, patch, kernels
        self.targets = (np.arange(last - first)[:, None] + np.arange(window)).astype(np.int64)
        self.receives, self.as_earlier, self.as_later = [], [], []
        sends: list[tuple] = []
        self.low_shared = self.high_shared = False
        shape, real = patch.nodes.shape[1:], patch.nodes.dtype
        slots: list[int] = []
        for number, cut in enumerate(slabs.cuts):
            sums_tag, unsummed_tag = 2 * number, 2 * number + 1
            if comm.rank == cut.earlier:
                low = cut.earlier_first - patch.first_plane
                shared = slice(low, low + cut.planes)
                incoming = Message(len(cut.unsummed), shape, real)
                shift = cut.earlier_first - cut.later_first - patch.first_plane
                planes = np.array([plane + shift for _, plane in cut.unsummed])
                sums = (patch.nodes[shared], patch.boxes[shared])
                sends.append((cut.later, sums_tag, Message(cut.planes, shape, real), sums))
                self.receives.append((cut.later, unsummed_tag, incoming.bytes))
                self.as_earlier.append((incoming, planes))
                self.note_shared(shared, patch.planes)
            if comm.rank == cut.later:
                low = cut.later_first - patch.first_plane
                shared = slice(low, low + cut.planes)
                incoming = Message(cut.planes, shape, real)
                mine = slice(len(slots), len(slots) + len(cut.unsummed))
                planes = np.array([plane - patch.first_plane for _, plane in cut.unsummed])
                self.receives.append((cut.earlier, sums_tag, incoming.bytes))
                own = Message(len(cut.unsummed), shape, real)
                self.as_later.append((incoming, low, own, planes))
                for layer, plane in cut.unsummed:
                    self.targets[layer - first, plane - (layer - slabs.reach_low)] = -1 - len(slots)
                    slots.append(plane)
                sends.append((cut.earlier, unsummed_tag, own, mine))
                self.note_shared(shared, patch.planes)
        self.unsummed = np.zeros((len(slots), *shape), real)
        self.slot_boxes = np.tile(np.array(EMPTY_BOX), (len(slots), 1))
        self.sends = [
            (peer, tag, message, what if isinstance(what, tuple) else (self.unsummed[what], self.slot_boxes[what]))
            for peer, tag, message, what in sends
        ]

    def note_shared(self, shared, planes):
        self.low_shared |= shared.start == 0
        self.high_shared |= shared.stop == planes

    def warm_up(self):
        """Load the kernels without touching anything."""
        nothing = Message(0, self.patch.nodes.shape[1:], self.patch.nodes.dtype)
        nodes, boxes = self.patch.nodes, self.patch.boxes
        self.kernels.pack(nodes[:0], boxes[:0], nothing.boxes, nothing.reals)
        self.kernels.take_planes(nodes, boxes, 0, nothing.boxes, nothing.reals)
        self.kernels.add_planes(nodes, boxes, np.zeros(0, np.int64), nothing.boxes, nothing.reals)

    def start(self):
        """Send the shared planes on their way."""
        sends = [(peer, tag, message.packed(self.kernels.pack, *what)) for peer, tag, message, what in self.sends]
        return self.comm.start_exchange(sends, self.receives)

    def finish(self, handle):
        """Complete the sums of the shared planes, the same way on both sides."""
        self.comm.finish(handle)
        nodes, boxes = self.patch.nodes, self.patch.boxes
        for incoming, planes in self.as_earlier:
            self.kernels.add_planes(nodes, boxes, planes, incoming.boxes, incoming.reals)
        for incoming, low, own, planes in self.as_later:
            self.kernels.take_planes(nodes, boxes, low, incoming.boxes, incoming.reals)
            self.kernels.add_planes(nodes, boxes, planes, own.boxes, own.reals)
