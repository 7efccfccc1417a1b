"""How well particles stand for a mesh: volume, centroid and inertia of both, by seeding, for public meshes.

python benchmarks/meshes.py [--cells 40] [--docs docs]: a table, and docs/results/meshes.md.

The meshes come out of vtk's sources and, where pyvista is installed (pip
install pyvista), its examples; both may be used freely (BSD, MIT). One is damaged on purpose.
"""

import argparse
import time

import numpy as np
import pages

from pmpm.scene import seeding
from pmpm.scene.mesh import Mesh
from pmpm.scene.needs import grid_geometry, scene_needs
from pmpm.scene.schema import Scene
from pmpm.scene.surfaces import Surface

HEAD = "| mesh | triangles | seeding | particles | volume | centroid | inertia | s |\n|---|---|---|---|---|---|---|---|"
ABOUT = """# What particles make of a mesh

`python benchmarks/meshes.py --cells {cells} --docs docs` wrote this page: public meshes, {cells} cells along
their largest extent, 8 particles in a cell. Errors of the particles, as points, against the formulas of the closed surface:
volume; centroid by the largest extent; second moment by its trace. Nothing is scaled to fit. The
last column is seconds of seeding on one core.

"""
READING = """
- Torus, icosahedron, superquadric, cone and trefoil (a tube around an open knot, with caps) come out of sources of vtk (BSD);
  ant, nut and sphere are examples of pyvista (MIT). Of the damaged
  torus 1 % of the triangles are turned, 3 missing and 10 there twice.
- Of the inertia that `quadrature` misses, most is that a particle is a point.
- The ant is made of pieces that overlap: the formula counts what they share twice, particles once.
- A lattice is worst where faces lie along its rows, as of the nut and the icosahedron.
"""


def vtk_sources():
    """{name: vtk filter whose output is a closed surface}."""
    import vtk

    found = {}
    torus = vtk.vtkParametricFunctionSource()
    torus.SetParametricFunction(vtk.vtkParametricTorus())
    found["torus"] = torus
    solid = vtk.vtkPlatonicSolidSource()
    solid.SetSolidTypeToIcosahedron()
    found["icosahedron"] = solid
    block = vtk.vtkSuperquadricSource()
    block.SetPhiRoundness(0.4)
    block.SetThetaRoundness(0.4)
    block.SetThetaResolution(64)
    block.SetPhiResolution(64)
    found["superquadric"] = block
    cone = vtk.vtkConeSource()
    cone.SetResolution(60)
    found["cone"] = cone
    knot = vtk.vtkTubeFilter()
    knot.SetInputData(trefoil(vtk))
    knot.SetRadius(0.35)
    knot.SetNumberOfSides(24)
    knot.CappingOn()
    found["trefoil"] = knot
    return found


def trefoil(vtk):
    """A trefoil knot as a line that does not quite close, so that the tube around it has two ends."""
    t = np.linspace(0.0, 2.0 * np.pi * 0.96, 300)
    points, line = vtk.vtkPoints(), vtk.vtkPolyLine()
    line.GetPointIds().SetNumberOfIds(len(t))
    for n, (x, y, z) in enumerate(
        zip(np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t), strict=True)
    ):
        points.InsertNextPoint(x, y, z)
        line.GetPointIds().SetId(n, n)
    cells, data = vtk.vtkCellArray(), vtk.vtkPolyData()
    cells.InsertNextCell(line)
    data.SetPoints(points)
    data.SetLines(cells)
    return data


def write_source(source, path):
    """Write what a vtk source makes as STL."""
    import vtk

    triangles, writer = vtk.vtkTriangleFilter(), vtk.vtkSTLWriter()
    triangles.SetInputConnection(source.GetOutputPort())
    writer.SetInputConnection(triangles.GetOutputPort())
    writer.SetFileName(str(path))
    writer.SetFileTypeToBinary()
    writer.Write()


def damaged(path, to):
    """Write an STL again with 1 % of its triangles turned, 3 missing, 10 twice."""
    import meshio

    mesh, rng = meshio.read(path), np.random.default_rng(0)
    cells = mesh.cells_dict["triangle"].copy()
    turned = rng.random(len(cells)) < 0.01
    cells[turned] = cells[turned][:, ::-1]
    cells = np.concatenate([np.delete(cells, rng.integers(len(cells), size=3), axis=0), cells[:10]])
    meshio.write(to, meshio.Mesh(mesh.points, [("triangle", cells)]), binary=True)


def public_meshes(folder):
    """{name: file} of the meshes, written into a folder."""
    files = {}
    for name, source in vtk_sources().items():
        files[name] = folder / f"{name}.stl"
        write_source(source, files[name])
    files["torus, damaged"] = folder / "damaged.stl"
    damaged(files["torus"], files["torus, damaged"])
    try:
        from pyvista import examples
    except ImportError:
        return files
    return files | {name: getattr(examples, f"{name}file") for name in ("ant", "nut", "sphere")}


def scene_of(path, cells, seeding, particles_per_cell=8):
    """A scene with the mesh in the middle of a domain, its largest extent so many cells long."""
    low, high = Mesh(file=path).bounds()
    h = float((high - low).max()) / cells
    count = np.ceil((high - low) / h).astype(int) + 6
    return Scene(
        domain={"size": (count * h).tolist(), "cell_size": h},
        time={"end": 1.0},
        materials={"a": {"model": "neo_hookean", "density": 1.0, "youngs_modulus": 1.0, "poisson_ratio": 0.3}},
        bodies=[
            {
                "material": "a",
                "shape": {"type": "mesh", "file": str(path), "move": (3.0 * h - low).tolist()},
                "seeding": seeding,
                "particles_per_cell": particles_per_cell,
            }
        ],
    )


def seeded(scene, first=0, last=None):
    """Seeds of the body of a scene in these layers."""
    geometry, around = grid_geometry(scene, scene_needs(scene)), seeding.surroundings(scene)
    last = geometry.layers if last is None else last
    return seeding.joined([s for _, s in seeding.seed_planes(scene, geometry, 0, first, last, around)], scene.dim)


def moments(scene, seeds):
    """(volume, centroid, second moment about it) of particles as points."""
    h = scene.domain.cell_size
    x = (seeds.node + seeds.offset) * h
    volume = (
        h**scene.dim / scene.bodies[0].particles_per_cell * (np.ones(len(x)) if seeds.share is None else seeds.share)
    )
    centroid = volume @ x / volume.sum()
    return volume.sum(), centroid, np.einsum("n,ni,nj->ij", volume, x - centroid, x - centroid)


def misses(scene, seeds):
    """Errors of volume, centroid (by the size of the mesh) and second moment (by its trace) of particles, relative."""
    surface: Surface = scene.bodies[0].shape.surface
    volume, centroid, second = moments(scene, seeds)
    size = float(np.ptp(np.stack(surface.bounds()), axis=0).max())
    return (
        abs(volume / surface.volume - 1.0),
        float(np.abs(centroid - surface.centroid).max()) / size,
        float(np.abs(second - surface.second_moment).max() / np.trace(surface.second_moment)),
    )


def main():
    import pathlib
    import tempfile

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=40, help="cells along the largest extent")
    parser.add_argument("--seedings", default=",".join(seeding.SEEDINGS), help="which of them")
    parser.add_argument("--docs", type=pathlib.Path, help="write the page here")
    options = parser.parse_args()
    lines = []
    print(HEAD)
    with tempfile.TemporaryDirectory() as folder:
        for name, path in public_meshes(pathlib.Path(folder)).items():
            for kind in options.seedings.split(","):
                scene = scene_of(path, options.cells, kind)
                began = time.perf_counter()
                seeds = seeded(scene)
                took = time.perf_counter() - began
                errors = " | ".join(f"{error:.1e}" for error in misses(scene, seeds))
                count = len(scene.bodies[0].shape.surface.elements)
                lines.append(f"| {name} | {count} | {kind} | {len(seeds.id)} | {errors} | {took:.1f} |")
                print(lines[-1], flush=True)
    if options.docs:
        pages.write(options.docs, "meshes", page(options.cells, lines))


def page(cells, lines):
    return ABOUT.format(cells=cells) + "\n".join([HEAD, *lines]) + "\n" + READING


if __name__ == "__main__":
    main()
