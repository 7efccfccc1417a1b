"""One real material for each law, and a path that shows what the law does: what `pmpm point MODEL` and the docs start from.

A law without an entry works all the same; its keys must then be given.
"""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Example:
    """`keys` of a scene's material, what it is (`name`), where the numbers are from (`source`), and the options of a typical
    `path` of pmpm.point."""

    name: str
    keys: dict
    source: str
    path: dict = field(default_factory=dict)


RUBBER = {"density": 930.0, "youngs_modulus": 2.0e6, "poisson_ratio": 0.49}
RUBBER_SOURCE = "M. F. Ashby, Materials Selection in Mechanical Design, 3rd ed. (2005), appendix C: natural rubber"
STEEL_SOURCE = "EN 1993-1-1:2005, table 3.1 (S235, t <= 40 mm) and section 3.2.6"
DENSE_SAND = {"density": 1700.0, "youngs_modulus": 5.0e7, "poisson_ratio": 0.3, "friction_angle": 35.0}
DENSE_SAND_SOURCE = (
    "J. E. Bowles, Foundation Analysis and Design, 5th ed. (1996), tables 2-6 to 2-8: dense sand, E 50 to 81 MPa"
)

EXAMPLES = {
    "neo_hookean": Example(
        "natural rubber",
        RUBBER,
        RUBBER_SOURCE,
        {"path": "uniaxial_stress", "strain": 0.7, "two_way": True, "cycles": 1},
    ),
    "fixed_corotated": Example(
        "natural rubber",
        RUBBER,
        RUBBER_SOURCE,
        {"path": "uniaxial_stress", "strain": 0.7, "two_way": True, "cycles": 1},
    ),
    "hencky": Example(
        "natural rubber",
        RUBBER,
        RUBBER_SOURCE,
        {"path": "uniaxial_stress", "strain": 0.7, "two_way": True, "cycles": 1},
    ),
    "fluid": Example(
        "water at 20 degrees Celsius",
        {"density": 998.2, "sound_speed": 1482.0, "gamma": 7.0},
        "density and sound speed: IAPWS-95 (2018), at 0.1 MPa; gamma: Monaghan (1994), J. Comput. Phys. 110, 399",
        {"path": "isotropic", "strain": -0.05, "two_way": True, "cycles": 1},
    ),
    "drucker_prager": Example(
        "dense quartz sand",
        DENSE_SAND,
        DENSE_SAND_SOURCE,
        {"path": "triaxial", "pressure": 1.0e5, "strain": -0.02, "cycles": 2},
    ),
    "mohr_coulomb": Example(
        "dense quartz sand",
        DENSE_SAND | {"cohesion": 0.0, "dilatancy_angle": 5.0},
        f"{DENSE_SAND_SOURCE}; dilatancy: phi - 30 degrees (Bolton 1986)",
        {"path": "triaxial", "pressure": 1.0e5, "strain": -0.02, "cycles": 2},
    ),
    "snow": Example(
        "snow, the reference parameters of the law",
        {
            "density": 400.0,
            "youngs_modulus": 1.4e5,
            "poisson_ratio": 0.2,
            "critical_compression": 2.5e-2,
            "critical_stretch": 7.5e-3,
            "hardening": 10.0,
        },
        "Stomakhin, Schroeder, Chai, Teran, Selle, ACM Trans. Graph. 32 (2013) 102, table 2",
        {"path": "uniaxial_strain", "strain": -0.2, "cycles": 2},
    ),
    "von_mises": Example(
        "structural steel S235",
        {
            "density": 7850.0,
            "youngs_modulus": 2.1e11,
            "poisson_ratio": 0.3,
            "yield_stress": 2.35e8,
            "hardening_modulus": 2.1e9,
        },
        f"{STEEL_SOURCE}; hardening E/100: EN 1993-1-5:2006, annex C.6",
        {"path": "uniaxial_stress", "strain": 0.01, "cycles": 2, "two_way": True},
    ),
    "cam_clay": Example(
        "London clay, normally consolidated",
        {
            "density": 1830.0,
            "shear_modulus": 1.6e6,
            "swelling_index": 0.0293,
            "compression_index": 0.0761,
            "critical_state_slope": 0.888,
            "preconsolidation_pressure": 1.0e5,
            "initial_pressure": 1.0e5,
        },
        "Schofield and Wroth, Critical State Soil Mechanics (1968): lambda 0.161, kappa 0.062, M 0.888, over the specific "
        "volume 2.12 at 100 kPa; shear modulus for a Poisson's ratio of 0.3 there",
        {"path": "triaxial", "pressure": 1.0e5, "strain": -0.3, "steps": 400},
    ),
    "mu_i": Example(
        "glass beads",
        {
            "density": 1470.0,
            "youngs_modulus": 1.0e7,
            "poisson_ratio": 0.3,
            "static_friction": 0.382,
            "dynamic_friction": 0.643,
            "reference_inertial_number": 0.279,
            "grain_diameter": 5.3e-4,
            "grain_density": 2450.0,
        },
        "Jop, Forterre and Pouliquen (2006), Nature 441, 727; stiffness chosen, far below that of glass",
        {
            "path": "constant_pressure_shear",
            "pressure": 1.0e3,
            "strain": 0.002,
            "rate": 100.0,
            "cycles": 1,
            "two_way": True,
        },
    ),
    "bingham": Example(
        "Carbopol gel, 0.30 %",
        {
            "density": 1000.0,
            "flow_speed": 2.0,
            "shear_modulus": 400.0,
            "yield_stress": 89.0,
            "viscosity": 47.7,
            "flow_index": 0.415,
        },
        "Cochard and Ancey (2009), J. Non-Newton. Fluid Mech. 158, 73; shear modulus: the usual order of such gels",
        {"path": "simple_shear", "strain": 2.0, "rate": 1.0, "cycles": 1, "two_way": True},
    ),
}
