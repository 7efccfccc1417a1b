"""The halo sum after P2G: one message per cut and direction, and the same ordered sum on both sides (see slabs)."""

import numpy as np


class Halo:
    """Exchanges the shared planes of one rank's patch. Buffers are allocated once per set of cuts.

    `targets[layer, k]` tells `fold_windows` where plane k of a layer's window goes; `unsummed` holds the planes that the
    rank which sums before this one needs unsummed.
    """

    def __init__(self, comm, slabs, patch, window):
        first, last = slabs.owned(comm.rank)
        self.comm, self.nodes = comm, patch.nodes
        plane_of_layer = np.arange(last - first)[:, None] + np.arange(window)
        self.targets = plane_of_layer.astype(np.int64)
        self.sends, self.receives, self.as_earlier, self.as_later = [], [], [], []
        self.low_shared = self.high_shared = False
        slots: list[int] = []
        for number, cut in enumerate(slabs.cuts):
            sums_tag, unsummed_tag = 2 * number, 2 * number + 1
            shape = patch.nodes.shape[1:]
            if comm.rank == cut.earlier:
                shared = slice(
                    cut.earlier_first - patch.first_plane, cut.earlier_first - patch.first_plane + cut.planes
                )
                incoming = np.zeros((len(cut.unsummed), *shape), patch.nodes.dtype)
                shift = cut.earlier_first - cut.later_first - patch.first_plane
                self.sends.append((cut.later, sums_tag, patch.nodes[shared]))
                self.receives.append((cut.later, unsummed_tag, incoming))
                self.as_earlier.append((incoming, [plane + shift for _, plane in cut.unsummed]))
                self.note_shared(shared, patch.planes)
            if comm.rank == cut.later:
                shared = slice(cut.later_first - patch.first_plane, cut.later_first - patch.first_plane + cut.planes)
                incoming = np.zeros((cut.planes, *shape), patch.nodes.dtype)
                self.receives.append((cut.earlier, sums_tag, incoming))
                self.as_later.append((incoming, shared, len(slots), [p - patch.first_plane for _, p in cut.unsummed]))
                self.sends.append((cut.earlier, unsummed_tag, (len(slots), len(slots) + len(cut.unsummed))))
                for layer, plane in cut.unsummed:
                    k = plane - (layer - slabs.reach_low)
                    self.targets[layer - first, k] = -1 - len(slots)
                    slots.append(plane)
                self.note_shared(shared, patch.planes)
        self.unsummed = np.zeros((len(slots), *patch.nodes.shape[1:]), patch.nodes.dtype)
        self.sends = [
            (peer, tag, self.unsummed[what[0] : what[1]] if isinstance(what, tuple) else what)
            for peer, tag, what in self.sends
        ]

    def note_shared(self, shared, planes):
        self.low_shared |= shared.start == 0
        self.high_shared |= shared.stop == planes

    @property
    def bytes_sent(self):
        """Bytes this rank sends per step."""
        return sum(array.nbytes for _, _, array in self.sends)

    def clear(self):
        self.unsummed[:] = 0

    def start(self):
        """Send the shared planes on their way."""
        return self.comm.start_exchange(self.sends, self.receives)

    def finish(self, handle):
        """Complete the sums of the shared planes, the same way on both sides."""
        self.comm.finish(handle)
        for incoming, planes in self.as_earlier:
            for slot, plane in enumerate(planes):
                self.nodes[plane] += incoming[slot]
        for sums, shared, first_slot, planes in self.as_later:
            self.nodes[shared] = sums
            for slot, plane in enumerate(planes):
                self.nodes[plane] += self.unsummed[first_slot + slot]
