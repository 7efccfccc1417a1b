"""Meshes and clouds of points out of files: what meshio reads, and VTP, OBJ and CSV, which are read here.

meshio is imported when a file asks for it. Whatever is wrong with a file is told by Unfit.
"""

import base64
import contextlib
import csv
import io
import re
import signal
import threading
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from pmpm.scene.functions import Unfit

# Corners of what meshio calls the same with more nodes (triangle6, hexahedron20): the corners come first.
CORNERS = {"line": 2, "triangle": 3, "quad": 4, "tetra": 4, "pyramid": 5, "wedge": 6, "hexahedron": 8}
FACES: dict[str, tuple[tuple[int, ...], ...]] = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetra": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    "pyramid": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
VOLUMES, PLANES = ("tetra", "pyramid", "wedge", "hexahedron"), ("triangle", "quad")
FORMATS = {".msh": "gmsh"}  # not Ansys, whose reader meshio asks first: it never ends on a file that is cut off
PATIENCE, PATIENCE_PER_BYTE = 20.0, 4e-6  # s
VTK_REALS = {"Float32": "f4", "Float64": "f8"}
VTK_TYPES = VTK_REALS | {
    f"{sign}Int{8 * size}": f"{sign.lower() or 'i'}{size}" for sign in ("", "U") for size in (1, 2, 4, 8)
}


@dataclass
class Block:
    """Cells of one kind: the kind, corners (n, CORNERS[kind]), and names of the groups with the cells in each."""

    kind: str
    corners: np.ndarray
    groups: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass
class FileMesh:
    """points (n, 3) m as the file has them, blocks of cells, and values at points by name."""

    points: np.ndarray
    blocks: list[Block]
    point_data: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def flat(self) -> bool:
        """Whether all points lie in one plane z = constant, as those of a 2-D mesh do."""
        return bool(len(self.points) and np.ptp(self.points[:, 2]) == 0.0)

    def group_names(self) -> list[str]:
        return list(dict.fromkeys(name for block in self.blocks for name in block.groups))


def read_mesh(path: str) -> FileMesh:
    """Read a mesh of any kind. Raises Unfit."""
    reader = {".obj": read_obj, ".vtp": read_vtp, ".csv": read_polygons}.get(
        Path(path).suffix.lower(), read_with_meshio
    )
    try:
        found = reader(path)
    except Unfit:
        raise
    except MemoryError:
        raise Unfit("cannot be read: it does not fit into memory") from None
    except Exception as error:
        raise Unfit(
            f"cannot be read as {Path(path).suffix or 'a mesh'}: {type(error).__name__}: {first_line(error)}"
        ) from None
    check_mesh(found)
    return found


def check_mesh(mesh: FileMesh) -> None:
    """Raise Unfit for points that are no places and cells of points that there are not."""
    if not len(mesh.points):
        raise Unfit("holds no points")
    wrong = np.flatnonzero(~np.isfinite(mesh.points).all(axis=1))
    if len(wrong):
        raise Unfit(f"has {len(wrong)} points that are no finite numbers, the first is number {wrong[0]}")
    for block in mesh.blocks:
        if block.corners.size and not 0 <= block.corners.min() <= block.corners.max() < len(mesh.points):
            raise Unfit(f"has a {block.kind} of a point that there is not; it has {len(mesh.points)} points")


def first_line(error: BaseException | str) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0][:200] if lines else "no reason given"


# ---- by meshio --------------------------------------------------------------------------------------------------------------


def read_with_meshio(path: str) -> FileMesh:
    try:
        import meshio
    except ImportError:
        raise Unfit("needs meshio to be read: pip install 'pmpm[mesh]'") from None
    if path.lower().endswith(".ply") and b"end_header" not in Path(path).read_bytes():
        raise Unfit("cannot be read: it has no end_header")  # for which meshio would look for ever
    said = io.StringIO()
    try:  # it prints what it thinks, and ends the process where no reader takes the file
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), patience(path):
            mesh = meshio.read(path, FORMATS.get(Path(path).suffix.lower()))
    except SystemExit:
        raise Unfit(f"cannot be read: {first_line(said.getvalue())}") from None
    except ImportError as error:
        raise Unfit(f"needs a package that is not installed: {first_line(error)}") from None
    points = in_space(np.asarray(mesh.points, float))
    blocks = [block for number, cells in enumerate(mesh.cells) for block in blocks_of(mesh, number, cells)]
    return FileMesh(points, blocks, {name: np.asarray(values) for name, values in mesh.point_data.items()})


@contextlib.contextmanager
def patience(path: str) -> Iterator[None]:
    """Raise Unfit when reading takes longer than any file of this size may: some of meshio's readers wait for ever for what a
    file that was cut off does not have. Where nothing can interrupt, outside of the main thread, there is no limit."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return
    seconds = PATIENCE + Path(path).stat().st_size * PATIENCE_PER_BYTE

    def give_up(number: int, frame: Any) -> None:
        raise Unfit(f"cannot be read: no end was found in {seconds:.0f} s; is it cut off?")

    before = signal.signal(signal.SIGALRM, give_up)
    rest, _ = signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, rest)
        signal.signal(signal.SIGALRM, before)


def in_space(points: np.ndarray) -> np.ndarray:
    """Points with a third coordinate, zero where there is none."""
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise Unfit(f"must have points of two or three coordinates, not an array of shape {points.shape}")
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))


def blocks_of(mesh: Any, number: int, cells: Any) -> list[Block]:
    """The cells of one block of meshio's, those with more nodes by their corners, polygons by triangles."""
    kind = re.sub(r"\d+$", "", cells.type)
    if kind == "polygon":
        return polygons(list(cells.data))
    if kind not in CORNERS:
        return []
    return [Block(kind, np.asarray(cells.data, np.int64)[:, : CORNERS[kind]], groups_of(mesh, number, len(cells.data)))]


def groups_of(mesh: Any, number: int, count: int) -> dict[str, np.ndarray]:
    """{name of a group: bool (count,) which cells of a block are in it}: sets of cells, physical groups of Gmsh, and whole
    numbers at cells as "name=number"."""
    found: dict[str, np.ndarray] = {}
    for name, sets in mesh.cell_sets.items():
        if not name.startswith("gmsh:") and number < len(sets) and sets[number] is not None:
            chosen = np.zeros(count, bool)
            chosen[np.asarray(sets[number]).astype(np.int64)] = True
            found[name] = chosen
    physical = {int(value[0]): name for name, value in mesh.field_data.items() if np.size(value) == 2}
    for name, blocks in mesh.cell_data.items():
        values = np.asarray(blocks[number])
        if values.shape != (count,) or values.dtype.kind not in "iu":
            continue
        for value in np.unique(values)[:1000]:
            label = physical.get(int(value), f"{name}={value}") if name == "gmsh:physical" else f"{name}={value}"
            found.setdefault(label, values == value)
    return {name: chosen for name, chosen in found.items() if chosen.any()}


def polygons(faces: list[Any]) -> list[Block]:
    """Triangles of polygons, a fan around the first corner of each."""
    sizes = np.array([len(face) for face in faces], np.int64)
    found = []
    for size in np.unique(sizes[sizes >= 3]):
        corners = np.array([face for face in faces if len(face) == size], np.int64)
        fans = [corners[:, [0, i, i + 1]] for i in range(1, size - 1)]
        found.append(Block("triangle", np.concatenate(fans)))
    return found


# ---- by hand ----------------------------------------------------------------------------------------------------------------


def read_obj(path: str) -> FileMesh:
    """Wavefront OBJ: its `v`, `f` and `l` lines; numbers of points may count from the end. `o` and `g` name groups."""
    points: list[list[float]] = []
    faces: dict[str, list[list[int]]] = {"": []}
    lines: list[list[int]] = []
    group = ""
    with open(path, encoding="utf-8", errors="replace") as file:
        for line in file:
            words = line.split()
            kind = words[0] if words else ""
            if kind == "v":
                points.append([float(word) for word in words[1:4]])
            elif kind in ("o", "g"):
                group = " ".join(words[1:])
                faces.setdefault(group, [])
            elif kind in ("f", "l"):
                numbers = [int(word.split("/")[0]) for word in words[1:]]
                if 0 in numbers:
                    raise Unfit("has a face of point 0: OBJ counts from 1")
                chain = [number - 1 if number > 0 else len(points) + number for number in numbers]
                if kind == "f":
                    faces[group].append(chain)
                else:
                    lines += [[a, b] for a, b in zip(chain, chain[1:], strict=False)]
    blocks = [Block("line", np.array(lines, np.int64))] if lines else []
    for name, chains in faces.items():
        for block in polygons(chains):
            block.groups = {name: np.ones(len(block.corners), bool)} if name else {}
            blocks.append(block)
    return FileMesh(np.array(points, float).reshape(-1, 3), blocks)


def read_polygons(path: str) -> FileMesh:
    """CSV of closed polygons: x and y (m) of a corner in each row, an empty row between one polygon and the next."""
    points: list[list[float]] = []
    lines: list[list[int]] = []
    first = 0

    def close() -> None:
        numbers = list(range(first, len(points)))
        if len(numbers) > 1 and points[first] == points[-1]:
            numbers = numbers[:-1]
        lines.extend([a, b] for a, b in zip(numbers, numbers[1:] + numbers[:1], strict=True))

    with open(path, encoding="utf-8-sig", newline="") as file:
        for number, row in enumerate(csv.reader(file)):
            if not "".join(row).strip():
                close()
                first = len(points)
                continue
            if number == 0 and not is_number(row[0]):
                continue  # names of the columns
            if len(row) != 2 or not all(map(is_number, row)):
                raise Unfit(f"must have two numbers in each row, x and y; row {number + 1} is {','.join(row)[:60]}")
            points.append([float(word) for word in row])
    close()
    return FileMesh(
        in_space(np.array(points, float).reshape(-1, 2)), [Block("line", np.array(lines, np.int64).reshape(-1, 2))]
    )


def is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def read_vtp(path: str) -> FileMesh:
    """VTK XML PolyData: points, polygons, strips, lines, values at points; text, base64 or raw, compressed by zlib or not."""
    content = Path(path).read_bytes()
    head, raw = content, b""
    appended = re.search(rb"<AppendedData[^>]*>", content)
    if appended is not None and b'"raw"' in appended.group():
        first = content.index(b"_", appended.end()) + 1
        head, raw = content[: appended.end()] + b"</AppendedData></VTKFile>", content[first:]
    if b"<!DOCTYPE" in head or b"<!ENTITY" in head:
        raise Unfit("cannot be read: it declares entities, which no VTP file needs")
    root = ElementTree.fromstring(head)
    if root.tag != "VTKFile" or root.get("type") != "PolyData":
        raise Unfit("is no VTK XML PolyData file")
    read = VtkArrays(root, raw)
    points, data, blocks, count = [], [], [], 0
    for piece in root.iter("Piece"):
        here = np.asarray(read.only(piece.find("Points")), float).reshape(-1, 3)
        data.append({str(array.get("Name")): read(array) for array in piece.iterfind("PointData/DataArray")})
        for kind in ("Polys", "Strips", "Lines"):
            blocks += vtk_cells(kind, read, piece.find(kind), count)
        points.append(here)
        count += len(here)
    names = set.intersection(*(set(piece) for piece in data)) if data else set()
    together = {name: np.concatenate([piece[name] for piece in data]) for name in sorted(names)}
    return FileMesh(np.concatenate(points) if points else np.zeros((0, 3)), blocks, together)


def vtk_cells(kind: str, read: "VtkArrays", part: Any, count: int) -> list[Block]:
    """The cells of one kind of a piece whose points come after `count` others."""
    arrays = {array.get("Name"): read(array) for array in part.iterfind("DataArray")} if part is not None else {}
    if not len(arrays.get("offsets", ())):
        return []
    corners = arrays["connectivity"].astype(np.int64) + count
    cells = np.split(corners, arrays["offsets"].astype(np.int64)[:-1])
    if kind == "Polys":
        return polygons(cells)
    if kind == "Lines":
        return [Block("line", np.concatenate([np.stack([cell[:-1], cell[1:]], axis=-1) for cell in cells]))]
    strips = [cell[[i, i + 1 + i % 2, i + 2 - i % 2]] for cell in cells for i in range(len(cell) - 2)]
    return [Block("triangle", np.array(strips, np.int64).reshape(-1, 3))]


class VtkArrays:
    """Reads DataArray elements of a VTK XML file."""

    def __init__(self, root: ElementTree.Element, raw: bytes):
        order = ">" if root.get("byte_order") == "BigEndian" else "<"
        self.order, self.raw = order, raw
        self.header = np.dtype(order + VTK_TYPES[root.get("header_type", "UInt32")])
        compressor = root.get("compressor")
        if compressor not in (None, "vtkZLibDataCompressor"):
            raise Unfit(f"is compressed by {compressor}; only vtkZLibDataCompressor can be read")
        self.compressed = compressor is not None
        appended = root.find("AppendedData")
        text = (appended.text or "").strip() if appended is not None else ""
        self.base64 = text[1:] if text.startswith("_") else ""

    def only(self, part: Any) -> np.ndarray:
        return self(next(part.iterfind("DataArray")))

    def __call__(self, array: ElementTree.Element) -> np.ndarray:
        kind = VTK_TYPES.get(array.get("type", ""))
        if kind is None:
            raise Unfit(f"has an array of type {array.get('type')}, which cannot be read")
        width = int(array.get("NumberOfComponents", 1))
        if array.get("format") == "ascii":
            flat = np.array((array.text or "").split(), dtype=kind)
        else:
            flat = np.frombuffer(self.content(array), self.order + kind)
        return flat.reshape(-1, width) if width > 1 else flat

    def content(self, array: ElementTree.Element) -> bytes:
        """The bytes of an array that is not text."""
        inline = array.get("format") == "binary"
        first = 0 if inline else int(array.get("offset", 0))
        if not inline and self.raw:
            return self.unpacked(lambda start, size: self.raw[first + start : first + start + size])
        text = re.sub(r"\s", "", array.text or "") if inline else self.base64[first:]

        def decode(start: int, size: int) -> bytes:
            # What comes before is encoded together with this, or by itself: then it ends with padding or needs none.
            if start == 0 or (start % 3 and text[letters(start) - 1] != "="):
                return base64.b64decode(text[: letters(start + size)])[start : start + size]
            return base64.b64decode(text[letters(start) :][: letters(size)])[:size]

        return self.unpacked(decode)

    def unpacked(self, take: Any) -> bytes:
        """The content behind its header: the size, or sizes of blocks that are compressed one by one."""
        word = self.header.itemsize
        if not self.compressed:
            return take(word, int(np.frombuffer(take(0, word), self.header)[0]))
        blocks = int(np.frombuffer(take(0, word), self.header)[0])
        sizes = np.frombuffer(take(0, word * (3 + blocks)), self.header)[3:].astype(np.int64)
        packed = take(word * (3 + blocks), int(sizes.sum()))
        ends = np.cumsum(sizes)
        return b"".join(zlib.decompress(packed[end - size : end]) for end, size in zip(ends, sizes, strict=True))


def letters(size: int) -> int:
    """How many letters of base64 so many bytes take."""
    return 4 * (-(-size // 3))


# ---- surfaces out of meshes -------------------------------------------------------------------------------------------------


def boundary(mesh: FileMesh, dim: int, group: str | None) -> np.ndarray:
    """Return the corners (n, dim) of the triangles (in 2-D: segments) around a mesh or around one group of its cells: the faces
    that volumes have once, else what triangles, or lines, the file has. Raises Unfit."""
    blocks = mesh.blocks
    if group is not None:
        from pmpm.scene.messages import known_text

        if group not in mesh.group_names():
            raise Unfit(f"has no group {group}; {known_text(group, mesh.group_names(), 'groups')}")
        blocks = [Block(b.kind, b.corners[b.groups[group]]) for b in blocks if group in b.groups]
    solid, skin = (VOLUMES, PLANES) if dim == 3 else (PLANES, ("line",))
    filled = [block for block in blocks if block.kind in solid and len(block.corners)]
    if filled:
        faces = [block.corners[:, face] for block in filled for face in FACES[block.kind]]
        return cut_faces(once(faces))
    return cut_faces([block.corners for block in blocks if block.kind in skin])


def once(faces: list[np.ndarray]) -> list[np.ndarray]:
    """Leave out faces that two cells share."""
    found = []
    for size in sorted({face.shape[1] for face in faces}):
        same = np.concatenate([face for face in faces if face.shape[1] == size])
        _, first, count = np.unique(np.sort(same, axis=1), axis=0, return_index=True, return_counts=True)
        found.append(same[np.sort(first[count == 1])])
    return found


def cut_faces(faces: list[np.ndarray]) -> np.ndarray:
    """Triangles of triangles and quads, or segments."""
    cut = [
        piece
        for face in faces
        for piece in ([face[:, [0, 1, 2]], face[:, [0, 2, 3]]] if face.shape[1] == 4 else [face])
    ]
    return np.concatenate(cut) if cut else np.zeros((0, 3), np.int64)
