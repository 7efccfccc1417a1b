"""The halo sum after P2G: one message per cut and direction, and the same ordered sum on both sides (see slabs).

A message holds, of each of its planes, which nodes it has, as spans, and what is on them.
"""

import numpy as np

HEAD = 64  # bytes: numbers of a message begin at a multiple


def zeros(size):
    """So many bytes, which take no memory until they are written to."""
    return np.zeros(size, np.uint8)


class Message:
    """Bytes on their way: how many spans each plane has (int64), all spans (middle, first quad, last quad + 1) in int32, then
    the reals of their nodes, of one velocity field after another. Room for full planes: what is not used takes no memory."""

    def __init__(self, planes, rows, quads, real, room=zeros, fields=1):
        self.planes, self.itemsize = planes, np.dtype(real).itemsize
        self.most = planes * rows * quads * 4  # nodes
        most = self.first_real(planes * rows * (quads // 2 + 1)) * self.itemsize
        self.bytes = room(most + fields * planes * rows * quads * 16 * self.itemsize)
        self.counts = self.bytes[: 8 * planes].view(np.int64)
        self.spans = self.bytes[8 * planes : most].view(np.int32)
        self.reals = self.bytes.view(real)
        self.used = np.zeros(0, np.uint8)

    def first_real(self, spans):
        """Which of all reals is the first after so many spans."""
        return -(-(8 * self.planes + 12 * spans) // HEAD) * HEAD // self.itemsize

    def tell(self, counts, spans, reals):
        """Write what will be sent: spans (n, 3) of the planes, and how many reals. Returns a view of where these go."""
        self.counts[:] = counts
        self.spans[: spans.size] = spans.ravel()
        first = self.first_real(len(spans))
        self.used = self.bytes[: (first + reals) * self.itemsize]
        return self.reals[first : first + reals]

    @property
    def head(self):
        """The bytes that say which nodes there are."""
        return self.bytes[: 8 * self.planes + 12 * int(self.counts.sum())]

    def told(self, field=0):
        """Where the reals of a velocity field of what has arrived begin."""
        spans = int(self.counts.sum())
        behind = field * 16 * int((self.spans[2 : 3 * spans : 3] - self.spans[1 : 3 * spans : 3]).sum()) if field else 0
        return self.first_real(spans) + behind


def node_numbers(message, planes, patch):
    """Numbers of the nodes in a patch that a message tells of, one after another; -1 where the patch has none."""
    counts, spans = message.counts, message.spans[: 3 * int(message.counts.sum())].reshape(-1, 3)
    middle, first, last = spans.astype(np.int64).T
    sizes = 4 * (last - first)
    of_span = np.repeat(np.arange(len(sizes)), sizes)
    node = 4 * first[of_span] + np.arange(int(sizes.sum())) - (np.cumsum(sizes) - sizes)[of_span]
    return patch.find(np.repeat(planes, counts)[of_span], middle[of_span], node)


class Halo:
    """Exchanges the shared planes of one rank's patch. Buffers are allocated once per set of cuts; `lay_out` follows the nodes.

    The rank that sums before another one at a cut sends what it has summed, the other what P2G has kept apart for it. Where the
    order of sums is not kept anyway (`ordered` false) both send their sums. `sent`: counts messages and bytes.
    """

    def __init__(self, comm, slabs, patch, kernels, sent=None, ordered=True, room=zeros):
        self.comm, self.patch, self.kernels = comm, patch, kernels
        self.sums: list[tuple] = []  # sent: (peer, tag, message, first plane)
        self.unsummed: list[tuple] = []  # sent: (peer, tag, message, pairs)
        self.as_earlier: list[tuple] = []  # received: (peer, tag, message, planes, pairs that follow)
        self.as_later: list[tuple] = []
        self.low_shared = self.high_shared = False
        self.sent = np.zeros(2, np.int64) if sent is None else sent
        self.tags = 2 * len(slabs.cuts)
        shape = patch.rows, patch.row_quads, patch.real, room, patch.fields
        for number, cut in enumerate(slabs.cuts):
            sums_tag, unsummed_tag = 2 * number, 2 * number + 1
            if comm.rank == cut.earlier:
                low = cut.earlier_first - patch.first_plane
                shift = cut.earlier_first - cut.later_first - patch.first_plane
                planes = np.array(
                    [plane + shift for _, plane in cut.unsummed] if ordered else range(low, low + cut.planes)
                )
                self.sums.append((cut.later, sums_tag, Message(cut.planes, *shape), low))
                self.as_earlier.append((cut.later, unsummed_tag, Message(len(planes), *shape), planes, None))
                self.note_shared(low, cut.planes)
            if comm.rank == cut.later:
                low = cut.later_first - patch.first_plane
                kept = [(layer - patch.first_layer, plane - layer + slabs.reach_low) for layer, plane in cut.unsummed]
                pairs = patch.keep_apart(kept if ordered else [])
                planes = low + np.arange(cut.planes)
                if ordered:
                    self.unsummed.append((cut.earlier, unsummed_tag, Message(len(pairs), *shape), pairs))
                else:
                    self.sums.append((cut.earlier, unsummed_tag, Message(cut.planes, *shape), low))
                self.as_later.append((cut.earlier, sums_tag, Message(cut.planes, *shape), planes, pairs))
                self.note_shared(low, cut.planes)
        self.outgoing: list[tuple] = []  # (where nodes go, where they are)

    def note_shared(self, first, count):
        self.low_shared |= first == 0
        self.high_shared |= first + count == self.patch.planes

    def lay_out(self):
        """Write which nodes the messages hold, and ready them."""
        patch = self.patch
        self.outgoing = []
        for _, _, message, low in self.sums:
            rows = patch.row_start[low * patch.rows : (low + message.planes) * patch.rows + 1]
            starts = rows[:: patch.rows]
            spans = patch.spans[starts[0] : starts[-1]].copy()
            spans[:, 0] %= patch.rows
            nodes = patch.nodes[:, 4 * patch.plane_start[low] : 4 * patch.plane_start[low + message.planes]]
            self.send_from(nodes, message, np.diff(starts), spans)
        first = 0
        for _, _, message, pairs in self.unsummed:
            of_layers = [slice(*patch.placed_start[layer : layer + 2]) for layer in pairs[:, 0]]
            spans = [patch.placed[of_layer, :3] for of_layer in of_layers]
            begin, end = patch.slot_start[first], patch.slot_start[first + len(pairs)]
            kept = patch.unsummed[:, 4 * begin : 4 * end]
            self.send_from(kept, message, list(map(len, spans)), np.concatenate(spans))
            first += len(pairs)
        self.ready()

    def send_from(self, values, message, counts, spans):
        """Let a message take these nodes of all fields, (fields, n, 4), each time."""
        rooms = message.tell(counts, spans, values.size).reshape(values.shape)
        self.outgoing += zip(rooms, values, strict=True)

    def ready(self, values=None, rooms=None):
        """Ready the messages. With arrays of cards that the sums lie in and come into, one for each velocity field of each
        message, messages hold no more than which nodes there are, and the sums go from card to card."""
        incoming = *self.as_earlier, *self.as_later
        sends = [(peer, tag, message.used) for peer, tag, message, _ in (*self.sums, *self.unsummed)]
        receives = [(peer, tag, message.bytes) for peer, tag, message, *_ in incoming]
        if values is not None:
            sends = [(peer, tag, message.head) for peer, tag, message, _ in self.sums]
            sends += self.of_cards(self.sums, values)
            receives += self.of_cards(incoming, rooms)
        # What goes round a periodic axis to this rank itself is no message.
        to_others = [array.nbytes for peer, _, array in sends if peer != self.comm.rank]
        self.each_time = np.array([len(to_others), sum(to_others)])
        self.exchange = self.comm.exchange(sends, receives)

    def of_cards(self, messages, arrays):
        """(peer, tag, array) of each velocity field of messages that go from card to card."""
        return [
            (peer, (1 + field) * self.tags + tag, array)
            for (peer, tag, *_), of_fields in zip(messages, arrays, strict=True)
            for field, array in enumerate(of_fields)
        ]

    def warm_up(self):
        """Load the kernels without touching anything."""
        patch, nothing = self.patch, Message(0, 1, 1, self.patch.real)
        self.add(nothing, np.zeros(0, np.int64))
        self.kernels.add_slots(
            patch.nodes[0], patch.unsummed[0], patch.placed, patch.placed_start, patch.slots, np.zeros((0, 2), np.int64)
        )

    def pack(self):
        """Write the shared planes into the messages."""
        for room, values in self.outgoing:
            room[:] = values

    def start(self):
        """Send the messages on their way."""
        self.sent += self.each_time
        self.exchange.start()

    def wait(self):
        """Wait for what others send."""
        self.exchange.finish()

    def finish(self):
        """Complete the sums of the shared planes, the same way on both sides."""
        for _, _, message, planes, _ in self.as_earlier:
            self.add(message, planes)
        for _, _, message, planes, pairs in self.as_later:
            self.add(message, planes)
            if len(pairs):
                self.patch.add_apart(self.kernels, pairs)

    def earlier_nodes(self):
        """Numbers of the patch's nodes that a rank with earlier layers has, too, as its messages tell."""
        found = [node_numbers(message, planes, self.patch) for _, _, message, planes, _ in self.as_later]
        return np.unique(np.concatenate(found)) if found else np.zeros(0, np.int64)

    def heads(self):
        """What tells the nodes of those messages: bytes."""
        return b"".join(message.head.tobytes() for _, _, message, *_ in self.as_later)

    def add(self, message, planes):
        patch = self.patch
        for field, nodes in enumerate(patch.nodes):
            self.kernels.add_planes(
                nodes, patch.spans, patch.row_start, patch.first_quads, patch.rows, planes, message.counts,
                message.spans, message.reals, message.told(field),
            )  # fmt: skip
