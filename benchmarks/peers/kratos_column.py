"""The column under its own weight in KratosMultiphysics' MPMApplication: static, quadrilaterals with linear shape functions.

Newton's method at each of some load steps finds equilibrium at once, where an explicit code has to let the column come to rest:
another integrator and another degree, so that only error against time can be compared. The law is that of pmpm: with one load
step its error falls with the second power of the cell size. In one load step material points stay where the mesh of the
undeformed column has them, as in a finite element code; with several they move over the grid.
"""

import json
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

MARGIN = 1  # cells above the column


@dataclass(frozen=True)
class Settled:
    """What a run leaves: start heights and heights at rest (m) of the material points, steps taken, and seconds of solving."""

    start: np.ndarray
    heights: np.ndarray
    steps: int
    seconds: float
    built: float


def write_strip(path, cells, dx, body):
    """An mdpa file of one column of square cells; all nodes keep their x, those at the base stay."""
    nodes = [f"{2 * j + i + 1} {i * dx} {j * dx} 0.0" for j in range(cells + 1) for i in range(2)]
    elements = [f"{j + 1} {1 if body else 0} {2 * j + 1} {2 * j + 2} {2 * j + 4} {2 * j + 3}" for j in range(cells)]
    blocks = [f"Begin Properties {1 if body else 0}", "End Properties", "Begin Nodes", *nodes, "End Nodes"]
    blocks += ["Begin Elements Element2D4N", *elements, "End Elements"]
    every = [str(n + 1) for n in range(len(nodes))]
    numbers = [str(n + 1) for n in range(cells)]
    of_grid = {"Parts_Grid": (every, numbers), "Sides": (every, []), "Base": (every[:2], [])}
    parts = {"Parts_Body": (every, numbers)} if body else of_grid
    for name, (own_nodes, own_elements) in parts.items():
        blocks += [f"Begin SubModelPart {name}", "Begin SubModelPartNodes", *own_nodes, "End SubModelPartNodes"]
        blocks += ["Begin SubModelPartElements", *own_elements, "End SubModelPartElements", "End SubModelPart"]
    path.write_text("\n".join(blocks) + "\n", encoding="utf-8")


def settings(folder, steps):
    def fixed(part, constrained):
        return {
            "python_module": "assign_vector_variable_process",
            "kratos_module": "KratosMultiphysics",
            "Parameters": {
                "model_part_name": f"Background_Grid.{part}",
                "variable_name": "DISPLACEMENT",
                "constrained": constrained,
                "value": [0.0 if held else None for held in constrained],
                "interval": [0.0, "End"],
            },
        }

    return {
        "problem_data": {
            "problem_name": "column", "parallel_type": "OpenMP", "start_time": 0.0, "end_time": 1.0 - 0.5 / steps,
            "echo_level": 0,
        },
        "solver_settings": {
            "solver_type": "Static",
            "model_part_name": "MPM_Material",
            "domain_size": 2,
            "echo_level": 0,
            "analysis_type": "non_linear",
            "model_import_settings": {"input_type": "mdpa", "input_filename": str(folder / "body")},
            "material_import_settings": {"materials_filename": str(folder / "materials.json")},
            "time_stepping": {"time_step": 1.0 / steps},
            "convergence_criterion": "residual_criterion",
            "residual_relative_tolerance": 1e-6,
            "residual_absolute_tolerance": 1e-9,
            "max_iteration": 20,
            "problem_domain_sub_model_part_list": ["Parts_Grid", "Parts_Body"],
            "processes_sub_model_part_list": ["Sides", "Base"],
            "grid_model_import_settings": {"input_type": "mdpa", "input_filename": str(folder / "grid")},
            "pressure_dofs": False,
            "linear_solver_settings": {"solver_type": "LinearSolversApplication.sparse_lu"},
        },
        "processes": {
            "constraints_process_list": [fixed("Sides", [True, False, True]), fixed("Base", [True, True, True])],
        },
        "output_processes": {},
    }  # fmt: skip


def materials(column, points):
    law = {"name": "HyperElasticNeoHookeanPlaneStrain2DLaw"}
    variables = {
        "THICKNESS": 1.0, "MATERIAL_POINTS_PER_ELEMENT": points, "DENSITY": column.density,
        "YOUNG_MODULUS": column.modulus, "POISSON_RATIO": column.poisson_ratio,
    }  # fmt: skip
    material = {"constitutive_law": law, "Variables": variables, "Tables": {}}
    return {
        "properties": [{"model_part_name": "Initial_MPM_Material.Parts_Body", "properties_id": 1, "Material": material}]
    }


def settle(column, cells, steps, per_direction=2):
    """Settled after the weight has grown in `steps` equal load steps."""
    began = time.perf_counter()
    import KratosMultiphysics as Kratos
    import KratosMultiphysics.LinearSolversApplication  # noqa: F401 - registers the direct solver
    from KratosMultiphysics import MPMApplication
    from KratosMultiphysics.MPMApplication.mpm_analysis import MpmAnalysis

    Kratos.Logger.GetDefaultOutput().SetSeverity(Kratos.Logger.Severity.WARNING)

    class Analysis(MpmAnalysis):
        def InitializeSolutionStep(self):
            weight = [0.0, -column.gravity * min(1.0, round(self.time * steps) / steps), 0.0]
            part = self.model["MPM_Material"]
            for element in part.Elements:
                element.SetValuesOnIntegrationPoints(MPMApplication.MP_VOLUME_ACCELERATION, [weight], part.ProcessInfo)
            super().InitializeSolutionStep()

    def heights(model):
        part = model["MPM_Material"]
        places = [e.CalculateOnIntegrationPoints(MPMApplication.MP_COORD, part.ProcessInfo)[0] for e in part.Elements]
        return np.array([place[1] for place in places])

    dx = column.length / cells
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_strip(folder / "body.mdpa", cells, dx, body=True)
        write_strip(folder / "grid.mdpa", cells + MARGIN, dx, body=False)
        (folder / "materials.json").write_text(json.dumps(materials(column, per_direction**2)), encoding="utf-8")
        model = Kratos.Model()
        analysis = Analysis(model, Kratos.Parameters(json.dumps(settings(folder, steps))))
        before = os.getcwd()
        os.chdir(folder)  # Kratos leaves files of its timers where it runs
        try:
            analysis.Initialize()
            start = heights(model)
            built = time.perf_counter() - began
            began = time.perf_counter()
            analysis.RunSolutionLoop()
            seconds = time.perf_counter() - began
            found = heights(model)
            analysis.Finalize()
        finally:
            os.chdir(before)
    return Settled(start, found, steps, seconds, built)
