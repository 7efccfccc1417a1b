"""Particles out of files: places, volumes and fields, of points as they are or at the quadrature points of a mesh's cells."""

import csv
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pmpm.scene.functions import Unfit
from pmpm.scene.mesh_files import PLANES, VOLUMES, FileMesh, first_line, in_space, read_mesh
from pmpm.scene.messages import known_text

# Other names of columns and datasets.
ALIASES = {"v": "velocity", "deformation_gradient": "F"}
NO_FIELDS = ("id", "material", "ids")
HDF = (".h5", ".hdf", ".hdf5", ".vtkhdf")
GAUSS = 0.5773502691896257  # 1/sqrt(3)
TETRA = 0.5854101966249685, 0.1381966011250105  # (5 + 3 sqrt 5)/20, (5 - sqrt 5)/20


@dataclass(frozen=True, eq=False)
class Cloud:
    """x (n, 3) m as in the file, volume (n,) in m3 (2-D: m2) or None, fields by name, each (n, k)."""

    x: np.ndarray
    volume: np.ndarray | None
    fields: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def flat(self) -> bool:
        return bool(np.ptp(self.x[:, 2]) == 0.0)


def read_cloud(path: str, group: str | None) -> Cloud:
    """Read a file of any kind. Raises Unfit."""
    suffix = Path(path).suffix.lower()
    try:
        if suffix == ".csv":
            found = from_columns(read_columns(path))
        elif suffix in HDF:
            found = from_columns(read_hdf(path))
        else:
            return checked(of_mesh(read_mesh(path), group))
    except Unfit:
        raise
    except Exception as error:
        raise Unfit(f"cannot be read as {suffix}: {type(error).__name__}: {first_line(error)}") from None
    if group is not None:
        raise Unfit(f"has no group {group}: only meshes have")
    return checked(found)


def checked(cloud: Cloud) -> Cloud:
    """The same, if it holds particles and all numbers are finite and volumes > 0. Raises Unfit."""
    if not len(cloud.x):
        raise Unfit("holds no particles")
    volume = {} if cloud.volume is None else {"volume": cloud.volume[:, None]}
    for name, values in cloud.fields.items():
        if len(values) != len(cloud.x):
            raise Unfit(f"has {len(values)} values of {name} for {len(cloud.x)} particles")
    # Others may be nan where a law has no such field; whoever takes them looks.
    moving = {"velocity": cloud.fields["velocity"]} if "velocity" in cloud.fields else {}
    for name, values in {"position": cloud.x, **volume, **moving}.items():
        wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(wrong):
            raise Unfit(f"has a {name} that is no finite number, of particle {wrong[0]} of {len(cloud.x)}")
    if cloud.volume is not None and cloud.volume.min() <= 0.0:
        first = int(np.argmin(cloud.volume))
        raise Unfit(f"has a volume of {cloud.volume[first]:.4g}, of particle {first}; volumes must be > 0")
    return cloud


# ---- tables -----------------------------------------------------------------------------------------------------------------


def read_columns(path: str) -> dict[str, np.ndarray]:
    """{name: (n, k)} of a CSV file with a row of names; names that differ in what follows the last `_` are one field: v_x, v_y
    or F_xx, F_xy, ..., in the order of the columns."""
    with open(path, encoding="utf-8-sig", newline="") as file:
        names = [name.strip() for name in next(csv.reader(file), [])]
    if not {"x", "y"} <= set(names):
        raise Unfit(f"must begin with a row of names with x and y; it is {','.join(names)[:60]!r}")
    if len(set(names)) < len(names):
        raise Unfit("names a column twice")
    values = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2, encoding="utf-8-sig")
    if values.shape[1] != len(names):
        raise Unfit(f"has {len(names)} names for {values.shape[1]} columns")
    parts: dict[str, list[int]] = {}
    places = [names.index(axis) for axis in "xyz" if axis in names]
    for number, name in enumerate(names):
        if number not in places:
            stem, _, end = name.rpartition("_")
            parts.setdefault(stem if stem and end and set(end) <= set("xyz0123456789") else name, []).append(number)
    return {"Points": values[:, places]} | {name: values[:, numbers] for name, numbers in parts.items()}


def read_hdf(path: str) -> dict[str, np.ndarray]:
    """The same of an HDF5 file: a snapshot or checkpoint, or datasets x (n, dim) and others at its root."""
    import h5py

    found: dict[str, np.ndarray] = {}
    with h5py.File(path, "r") as file:
        if "VTKHDF/Points" in file:
            found["Points"] = np.asarray(file["VTKHDF/Points"], float)
            groups = [file[name] for name in ("VTKHDF/PointData",) if name in file]
            groups += [law for law in (file["pmpm"].values() if "pmpm" in file else ()) if isinstance(law, h5py.Group)]
        elif "x" in file:
            found["Points"] = np.asarray(file["x"], float)
            groups = [file]
        else:
            raise Unfit("has neither VTKHDF/Points nor x: no positions")
        count = len(found["Points"])
        for group in groups:
            for name, data in group.items():
                # The state of a law that only some particles have is theirs alone.
                if isinstance(data, h5py.Dataset) and data.shape[:1] == (count,) and data.dtype.kind in "fiu":
                    found.setdefault(name, np.asarray(data, float).reshape(count, -1))
    found.pop("x", None)
    return found


def from_columns(columns: dict[str, np.ndarray]) -> Cloud:
    x = in_space(columns.pop("Points"))
    fields = {ALIASES.get(name, name): values for name, values in columns.items() if name not in NO_FIELDS}
    volume = fields.pop("volume", None)
    return Cloud(x, None if volume is None else volume[:, 0], fields)


# ---- meshes -----------------------------------------------------------------------------------------------------------------


def of_mesh(mesh: FileMesh, group: str | None) -> Cloud:
    """Quadrature points of the volumes of a mesh, in 2-D of its cells; points as they are where it has none."""
    kinds = PLANES if mesh.flat else VOLUMES
    blocks = [block for block in mesh.blocks if block.kind in kinds and len(block.corners)]
    if group is not None:
        if group not in mesh.group_names():
            raise Unfit(f"has no group {group}; {known_text(group, mesh.group_names(), 'groups')}")
        blocks = [type(b)(b.kind, b.corners[b.groups[group]]) for b in blocks if group in b.groups]
    if not blocks:
        if group is not None or any(len(block.corners) and block.kind != "line" for block in mesh.blocks):
            raise Unfit("has no cells with a volume that particles could stand for; shape mesh fills a surface")
        return from_columns({"Points": mesh.points} | {k: v.reshape(len(v), -1) for k, v in mesh.point_data.items()})
    found = [quadrature(block.kind, mesh.points[block.corners]) for block in blocks]
    x, volume = (np.concatenate(parts) for parts in zip(*found, strict=True))
    if np.count_nonzero(volume < 0.0) > len(volume) // 2:  # corners the other way round
        volume = -volume
    return Cloud(x, volume)


def quadrature(kind: str, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (x (m, 3), volume (m,)) of quadrature points of cells with these corners (n, k, 3): exact for polynomials of
    degree 2 in straight cells (Zienkiewicz and Taylor, The Finite Element Method, chapter 5)."""
    places, weights = RULES[kind]
    shapes, slopes = zip(*(shape_functions(kind, place) for place in places), strict=True)
    x = np.einsum("qk,nkd->nqd", np.array(shapes), corners)
    jacobian = np.einsum("qke,nkd->nqed", np.array(slopes), corners)
    if kind in PLANES:
        size = jacobian[..., 0, 0] * jacobian[..., 1, 1] - jacobian[..., 0, 1] * jacobian[..., 1, 0]
    else:
        size = np.linalg.det(jacobian)
    return x.reshape(-1, 3), (size * np.array(weights)).reshape(-1)


CUBE = [(a, b, c) for c in (-1, 1) for b in (-1, 1) for a in (-1, 1)]
THIRDS: list[tuple[float, ...]] = [(1 / 6, 1 / 6), (2 / 3, 1 / 6), (1 / 6, 2 / 3)]
APEX = 0.1225148226554414, 0.5441518440112253  # of (1 - z)^2 dz on 0 .. 1, with weights below
RULES: dict[str, tuple[list[tuple[float, ...]], list[float]]] = {
    "triangle": (THIRDS, [1 / 6] * 3),
    "quad": ([(GAUSS * a, GAUSS * b) for a, b, c in CUBE if c < 0], [1.0] * 4),
    "tetra": (
        [tuple(TETRA[0] if axis == i else TETRA[1] for axis in range(3)) for i in range(4)],
        [1 / 24] * 4,
    ),
    "hexahedron": ([(GAUSS * a, GAUSS * b, GAUSS * c) for a, b, c in CUBE], [1.0] * 8),
    "wedge": ([(*t, 0.5 + 0.5 * s * GAUSS) for s in (-1, 1) for t in THIRDS], [1 / 12] * 6),
    # A pyramid is a cube whose top has shrunk: of that the Gauss points, with the size of its slopes.
    "pyramid": (
        [(GAUSS * a, GAUSS * b, z) for z in APEX for a, b, c in CUBE if c < 0],
        [0.232547451253508] * 4 + [0.1007858820798252] * 4,
    ),
}  # fmt: skip


def shape_functions(kind: str, place: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return (values (k,), slopes (k, dim)) of the linear shape functions of a cell at a place of its reference cell."""
    if kind in ("quad", "hexahedron"):
        dim = len(place)
        ring = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
        ends = ring if dim == 2 else np.array([[a, b, c] for c in (-1.0, 1.0) for a, b in ring])
        factors = 0.5 * (1.0 + ends * place)
        slopes = np.stack(
            [0.5 * ends[:, e] * np.prod(np.delete(factors, e, axis=1), axis=1) for e in range(dim)], axis=1
        )
        return np.prod(factors, axis=1), slopes
    if kind in ("triangle", "tetra"):
        dim = len(place)
        return np.array([1.0 - sum(place), *place]), np.vstack([-np.ones(dim), np.eye(dim)])
    if kind == "wedge":
        r, s, t = place
        flat = np.array([1.0 - r - s, r, s])
        turn = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
        values = np.concatenate([flat * (1.0 - t), flat * t])
        along = np.concatenate([-flat, flat])
        return values, np.column_stack([np.concatenate([turn * (1.0 - t), turn * t]), along])
    a, b, z = place  # of a pyramid as a cube: corners of the base times 1 - z, the apex times z
    ring = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    base = 0.25 * (1.0 + ring[:, 0] * a) * (1.0 + ring[:, 1] * b)
    by_a = 0.25 * ring[:, 0] * (1.0 + ring[:, 1] * b)
    by_b = 0.25 * ring[:, 1] * (1.0 + ring[:, 0] * a)
    # The size of the map shrinks as (1 - z)^2, which the weights hold: slopes across are those of the whole base.
    slopes = np.column_stack([np.append(by_a, 0.0), np.append(by_b, 0.0), np.append(-base, 1.0)])
    return np.append(base * (1.0 - z), z), slopes
