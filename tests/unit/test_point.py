"""`pmpm point`: a particle on its path, against closed forms; held stresses; what is refused and what is written."""

import csv
import math
import os
import sys
import types

import numpy as np
import pytest

from pmpm.cli import main
from pmpm.physics.materials import LAWS, fluid
from pmpm.physics.materials.examples import EXAMPLES
from pmpm.physics.materials.keys import lame
from pmpm.point.command import complete_keys, typical_run
from pmpm.point.driver import PathEnds, Point, Unreachable, consolidate, drive, find_root, motion
from pmpm.point.paths import ACROSS, PATHS, REQUIRED, SHEAR, VOLUME, courses
from pmpm.point.report import panels_of

RUBBER = {"density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3}
MU, LAM = lame(1e6, 0.3)
DIMS = (2, 3)


def sand(friction_angle=30.0, **more):
    return complete_keys("drucker_prager", {"youngs_modulus": 1e7, "friction_angle": friction_angle} | more)


def driven(model, keys, dim, name, strain, pressure=None, steps=50, rate=1.0, **cycles):
    record = drive(Point(model, keys, dim), PATHS[name], courses(strain, steps, **cycles), rate, pressure)
    assert record.failure is None
    return record


def table(text):
    """Rows of the table on the screen as {column: text}."""
    lines = text.split("\n\n")[1].splitlines()
    names = lines[0].split()
    return [dict(zip(names, line.split(), strict=True)) for line in lines[2:]]


def refused(arguments, capsys):
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("pmpm: ")
    return captured.err


# ---- closed forms ----


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("strain", [-0.5, 0.5])
def test_confined_rubber_is_the_closed_form(dim, strain):
    """tau = mu (b - I) + lam ln J I with one stretch: sigma = tau / stretch (Bonet and Wood 2008, section 6.4.3)."""
    record = driven("neo_hookean", RUBBER, dim, "uniaxial_strain", strain)
    stretch = np.exp(record["strain"])
    # Each of 50 steps rounds F once.
    assert record["stress_xx"] == pytest.approx((MU * (stretch**2 - 1.0) + LAM * record["strain"]) / stretch, rel=1e-13)
    assert record["stress_yy"] == pytest.approx(LAM * record["strain"] / stretch, rel=1e-13)
    assert record["J"] == pytest.approx(stretch, rel=1e-13)


@pytest.mark.parametrize("dim", DIMS)
def test_sheared_rubber_is_the_closed_form(dim):
    """b = I + gamma (e1 e2 + e2 e1) + gamma^2 e1 e1 and J = 1: sigma_xy = mu gamma, sigma_xx = mu gamma^2."""
    record = driven("neo_hookean", RUBBER, dim, "simple_shear", 2.0)
    gamma = record["strain"]
    assert record["stress_xy"] == pytest.approx(MU * gamma, rel=1e-13)
    assert record["stress_xx"] == pytest.approx(MU * gamma * gamma, rel=1e-13)
    assert record["gamma_xy"] == pytest.approx(gamma, rel=1e-13)
    assert np.abs(record["stress_yy"]).max() < 1e-9 * MU


@pytest.mark.parametrize("dim", DIMS)
def test_pulled_rubber_is_free_across(dim):
    """With stretches a across, mu (a^2 - 1) + lam ln J = 0 and sigma_xx = mu (stretch^2 - a^2) / J."""
    record = driven("neo_hookean", RUBBER, dim, "uniaxial_stress", 1.0)
    stretch, a = np.exp(record["strain"]), np.exp(record["strain_yy"])
    J = stretch * a ** (dim - 1)
    assert np.abs(MU * (a * a - 1.0) + LAM * np.log(J)).max() < 1e-10 * MU
    assert record["stress_xx"] == pytest.approx(MU * (stretch**2 - a * a) / J, rel=1e-10, abs=1e-10 * MU)


def test_small_strains_show_youngs_modulus_and_poissons_ratio():
    record = driven("neo_hookean", RUBBER, 3, "uniaxial_stress", 1e-6, steps=1)
    assert record["stress_xx"][-1] / 1e-6 == pytest.approx(1e6, rel=1e-5)
    assert record["strain_yy"][-1] / 1e-6 == pytest.approx(-0.3, rel=1e-5)


@pytest.mark.parametrize("dim", DIMS)
def test_compressed_water_follows_tait(dim):
    """p = B/gamma (J^-gamma - 1), Monaghan (1994)."""
    keys = complete_keys("fluid", {"bulk_modulus": 2e9})
    record = driven("fluid", keys, dim, "uniaxial_strain", -0.05)
    assert record["p"] == pytest.approx(2e9 / 7.0 * (np.exp(-7.0 * record["strain"]) - 1.0), rel=1e-12)
    assert np.abs(record["q"]).max() < 1e-6


@pytest.mark.parametrize("dim", DIMS)
def test_sand_in_triaxial_compression_peaks_at_the_ratio_of_mohr_and_coulomb(dim):
    """sigma_1 / sigma_3 = (1 + sin phi) / (1 - sin phi) = 3 at 30 degrees; in 2-D the cone is Mohr-Coulomb in the plane."""
    record = driven("drucker_prager", sand(), dim, "triaxial", -0.05, pressure=1e5)
    ratio = record["stress_xx"] / record["stress_yy"]
    assert ratio[0] == pytest.approx(1.0, rel=1e-8)
    assert ratio[-1] == pytest.approx(3.0, rel=1e-8)
    assert ratio.max() < 3.0 * (1.0 + 1e-8)


@pytest.mark.parametrize("name", ["constant_pressure_shear", "direct_shear"])
def test_sheared_sand_ends_on_the_cone(name):
    """|dev tau| = alpha (-tr tau) with alpha of Klar et al. (2016) is q / p = 6 sin phi / (3 - sin phi)."""
    record = driven("drucker_prager", sand(), 3, name, 0.2, pressure=1e5)
    assert record["q"][-1] / record["p"][-1] == pytest.approx(6.0 * 0.5 / 2.5, rel=1e-6)


# ---- held stresses ----


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("name", [name for name, path in PATHS.items() if path.held])
@pytest.mark.parametrize(
    ("model", "keys"), [("neo_hookean", RUBBER), ("drucker_prager", sand())], ids=["rubber", "sand"]
)
def test_the_held_stress_stays_through_yield_and_reversals(dim, name, model, keys):
    path = PATHS[name]
    pressure = 1e4 if path.pressure == REQUIRED else None
    particle = Point(model, keys, dim)
    record = drive(particle, path, courses(0.05, 20, cycles=2, two_way=True), 1.0, pressure)
    assert record.failure is None
    assert record.rows == 1 + 160
    held = {ACROSS: ("yy", "zz")[: dim - 1], VOLUME: ("xx", "yy", "zz")[:dim]}.get(path.held, ("yy",))
    mean = sum(record[f"stress_{axis}"] for axis in held) / len(held)
    # PRECISION and ROUNDING of the driver, the latter of a stiffness of 1e7 Pa.
    assert np.abs(mean + (pressure or 0.0)).max() <= 1e-9 * (pressure or 0.0) + 1e-12 * 2e7


@pytest.mark.parametrize("dim", DIMS)
def test_the_first_pressure_is_isotropic_along_the_axes(dim):
    particle = Point("neo_hookean", RUBBER, dim)
    consolidate(particle, 5e4, 1.0)
    assert np.diag(particle.sigma)[:dim] == pytest.approx([-5e4] * dim, rel=1e-8)
    assert particle.sigma[0, 1] == 0.0
    assert (particle.strain == 0.0).all()


def test_a_pressure_that_the_material_cannot_bear_ends_the_path_with_its_reason():
    particle = Point("fluid", complete_keys("fluid", {}), 3)
    with pytest.raises(PathEnds, match="the mean normal stress cannot be held at .* Pa: it misses the aim by"):
        consolidate(particle, -1e5, 1.0)  # water bears no tension


@pytest.mark.parametrize("root", [0.3, -0.3, 1e-9])
@pytest.mark.parametrize(
    "residual",
    [
        lambda x: x,
        lambda x: math.expm1(50.0 * x),
        lambda x: max(x, 1e-3 * x),  # a corner, as at yield
        lambda x: math.copysign(min(abs(x), 1e-3), x),  # flat on both sides
        lambda x: -x,  # a material that softens
    ],
)
def test_roots_are_found_past_corners_and_plateaus(root, residual):
    found = find_root(lambda x: residual(x - root), 0.0, 1e-3, 1e-13, 0.0)
    assert abs(residual(found - root)) <= 1e-13


def test_the_search_stays_away_from_where_nothing_is_defined():
    found = find_root(lambda x: x - 0.3 if x < 0.4 else math.nan, 0.0, 1e-3, 1e-13, 0.0)
    assert found == pytest.approx(0.3, abs=1e-13)


def test_a_jump_over_the_aim_is_no_root():
    with pytest.raises(Unreachable, match="jumps from -1 to 1 Pa"):
        find_root(lambda x: math.copysign(1.0, x - 0.1), 0.0, 1e-3, 1e-9, 1e-6)


def test_a_stress_that_does_not_answer_is_unreachable():
    with pytest.raises(Unreachable, match="misses the aim by 7 to 7 Pa"):
        find_root(lambda x: 7.0, 0.0, 1e-3, 1e-9, 1e-6)


# ---- courses, rates, motion ----


def test_cycles_lead_there_and_back():
    assert courses(0.2, 2) == pytest.approx([0.1, 0.2])
    assert courses(0.2, 2, cycles=2) == pytest.approx([0.1, 0.2, 0.1, 0.0, 0.1, 0.2, 0.1, 0.0])
    assert courses(0.2, 1, cycles=1, two_way=True) == pytest.approx([0.2, 0.0, -0.2, 0.0])


def test_a_cycle_of_rubber_ends_where_it_began():
    record = driven("neo_hookean", RUBBER, 3, "uniaxial_stress", 0.5, cycles=3, two_way=True)
    assert abs(record["stress_xx"][-1]) < 1e-8 * MU
    assert abs(record["strain_yy"][-1]) < 1e-13


def test_time_follows_strain_and_rate():
    record = driven("neo_hookean", RUBBER, 3, "simple_shear", 0.5, rate=4.0, cycles=1)
    assert record["time"][-1] == pytest.approx(2.0 * 0.5 / 4.0, rel=1e-12)


def test_volume_strain_is_spread_over_all_axes():
    for dim in DIMS:
        assert np.linalg.det(np.eye(dim) + motion(dim, VOLUME, -0.3)) == pytest.approx(math.exp(-0.3), rel=1e-14)
    assert motion(2, SHEAR, 0.1, ACROSS, 0.0)[0, 1] == 0.1


def viscous_stress(state, L, params):
    return (2.0 * L[0], L[1] + L[2], 2.0 * L[3])


def test_viscous_stress_follows_the_rate(monkeypatch):
    """A fluid with a dynamic viscosity of 1 Pa s, sheared at 3 per second: sigma_xy = 3 Pa."""
    syrup = types.SimpleNamespace(**vars(fluid) | {"viscous_stress": viscous_stress})
    syrup.choices = lambda keys: {"LOGARITHMIC": False, "VISCOUS": True}
    monkeypatch.setitem(LAWS, "syrup", syrup)
    record = driven("syrup", complete_keys("fluid", {}), 2, "simple_shear", 0.1, rate=3.0)
    assert record["stress_xy"][1:] == pytest.approx(3.0, rel=1e-12)
    assert record["stress_xy"][0] == 0.0


# ---- examples ----


@pytest.mark.parametrize("model", LAWS)
@pytest.mark.parametrize("dim", DIMS)
def test_every_law_has_an_example_that_survives_its_typical_path(model, dim):
    assert model in EXAMPLES, "give real values and their source in pmpm/physics/materials/examples.py"
    record, _, course = typical_run(model, dim, steps=20)
    assert record.failure is None
    assert np.isfinite(record["p"]).all()
    assert max(record["q"].max(), record["p"].max()) > 0.0
    assert EXAMPLES[model].source


@pytest.mark.parametrize("model", [model for model in EXAMPLES if model in LAWS])
def test_examples_use_keys_of_their_law(model):
    assert set(EXAMPLES[model].keys) <= {key.name for key in LAWS[model].KEYS}


def test_a_key_that_is_set_replaces_one_of_the_example_that_excludes_it():
    keys = complete_keys("fluid", {"bulk_modulus": 1e9})
    assert keys["bulk_modulus"] == 1e9
    assert keys["sound_speed"] is None


# ---- the command ----


def test_the_table_holds_strain_stress_invariants_and_state(capsys):
    assert main(["point", "drucker_prager", "--path", "triaxial", "--pressure", "1e5", "--rows", "5"]) == 0
    rows = table(capsys.readouterr().out)
    assert len(rows) == 5
    assert {"step", "strain", "stress_xx", "stress_yy", "p", "q", "J", "hencky_strain_xx"} <= set(rows[0])
    assert float(rows[-1]["stress_yy"]) == pytest.approx(-1e5)
    assert rows[-1]["strain"] == "-0.05"


def test_the_state_of_expanded_sand_is_shown(capsys):
    main(["point", "drucker_prager", "--path", "isotropic", "--strain", "0.02", "--rows", "2"])
    assert table(capsys.readouterr().out)[-1]["v_c"] == "0.02"


def test_a_file_holds_every_step_and_column(tmp_path, capsys):
    file = tmp_path / "path.csv"
    assert main(["point", "neo_hookean", "--path", "simple_shear", "--steps", "7", "--out", str(file)]) == 0
    assert "8 rows in" in capsys.readouterr().out
    with open(file, newline="") as text:
        rows = list(csv.DictReader(text))
    assert len(rows) == 8
    assert {"step", "time", "strain", "strain_xx", "gamma_xy", "stress_xy", "stress_xz", "p", "q", "J", "F_xy"} <= set(
        rows[0]
    )
    assert float(rows[-1]["F_xy"]) == pytest.approx(0.1, rel=1e-13)


def test_increments_of_a_file_are_followed(tmp_path, capsys):
    file = tmp_path / "mine.csv"
    file.write_text("dt,xy\n" + "0.5, 0.01\n" * 10, encoding="utf-8")
    out = tmp_path / "out.csv"
    arguments = ["point", "neo_hookean", "--increments", str(file), "--dimension", "2", "--out", str(out)]
    assert main(arguments) == 0
    with open(out, newline="") as text:
        last = list(csv.DictReader(text))[-1]
    mu = 2e6 / (2.0 * 1.49)  # of the example
    assert float(last["stress_xy"]) == pytest.approx(0.1 * mu, rel=1e-12)
    assert float(last["time"]) == pytest.approx(5.0)


def test_a_particle_turned_inside_out_ends_the_table_with_status_1(tmp_path, capsys):
    file = tmp_path / "mine.csv"
    file.write_text("xx,xy,yx,yy\n0,0.1,0,0\n-0.5,0.5,0.5,-0.5\n0,0,0,0\n", encoding="utf-8")
    assert main(["point", "neo_hookean", "--increments", str(file)]) == 1
    captured = capsys.readouterr()
    assert len(table(captured.out)) == 2
    assert "stopped: step 2: the material's state is not valid any more" in captured.err


def test_a_material_of_a_scene_keeps_the_keys_and_dimension_of_the_scene(capsys):
    assert main(["point", "column_collapse:sand", "--rows", "2"]) == 0
    text = capsys.readouterr().out
    assert "2-D plane strain" in text
    assert "youngs_modulus = 840000" in text
    assert main(["point", "--scene", "column_collapse", "--set", "friction_angle=40", "--rows", "2"]) == 0
    assert "friction_angle = 40" in capsys.readouterr().out


INCREMENTS = "mine.csv"


@pytest.mark.parametrize(
    ("arguments", "fragments"),
    [
        ([], ["give a model", "neo_hookean"]),
        (["neo_hooken"], ["did you mean neo_hookean?"]),
        (["dam_break"], ["is a scene", "dam_break:NAME"]),
        (["dam_break:watr"], ["watr", "did you mean water?"]),
        (["nothing.toml:sand"], ["nothing.toml: no such file"]),
        (["fluid", "--scene", "dam_break"], ["not both"]),
        (["neo_hookean", "--set", "youngs_modulus=-1"], ["youngs_modulus = -1 must be a number > 0 Pa"]),
        (["neo_hookean", "--set", "youngs_modlus=1"], ["did you mean youngs_modulus?"]),
        (["neo_hookean", "--set", "youngs_modulus"], ["must be key.path=value"]),
        (["neo_hookean", "--set", "model=fluid"], ["model"]),
        (["fluid", "--set", "bulk_modulus=1e9", "--set", "sound_speed=9"], ["exactly one of"]),
        (["column_collapse:sand", "--set", "friction_angle=95"], ["materials.sand.friction_angle = 95", "< 90 deg"]),
        (["neo_hookean", "--path", "triaxal"], ["--path triaxal", "did you mean triaxial?"]),
        (["neo_hookean", "--path", "triaxial"], ["needs --pressure", "> 0 Pa"]),
        (["neo_hookean", "--path", "uniaxial_stress", "--pressure", "5"], ["--pressure 5", "triaxial"]),
        (["neo_hookean", "--path", "isotropic", "--pressure", "-5"], ["--pressure -5", ">= 0 Pa"]),
        (["neo_hookean", "--strain", "0"], ["--strain 0", "from -10 to 10"]),
        (["neo_hookean", "--strain", "nan"], ["--strain nan"]),
        (["neo_hookean", "--rate", "0"], ["--rate 0", "> 0 1/s"]),
        (["neo_hookean", "--steps", "0"], ["--steps 0", "from 1 to 100000"]),
        (["neo_hookean", "--cycles", "0"], ["--cycles 0", "from 1"]),
        (["neo_hookean", "--path", "isotropic", "--two-way"], ["--two-way", "--cycles"]),
        (["neo_hookean", "--rows", "1"], ["--rows 1", ">= 2"]),
        (["neo_hookean", "--out", "/proc/none/x.csv"], ["--out /proc/none/x.csv"]),
        (["neo_hookean", "--increments", "none.csv"], ["none.csv: no such file"]),
        (["neo_hookean", "--increments", INCREMENTS, "--strain", "1"], ["--strain", "--increments"]),
        (["neo_hookean", "--increments", INCREMENTS, "--rate", "-1"], ["--rate -1"]),
    ],
)
def test_wrong_input_ends_with_status_2(arguments, fragments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / INCREMENTS).write_text("xx\n0.1\n", encoding="utf-8")
    message = refused(["point", *arguments], capsys)
    assert all(fragment in message for fragment in fragments), message
    assert os.listdir() == [INCREMENTS]


@pytest.mark.parametrize(
    ("text", "fragments"),
    [
        ("", ["holds no increments"]),
        ("xx\n", ["holds no increments"]),
        ("xq\n0.1\n", ['"xq" is not a column in 2-D', "xx, xy, yx, yy"]),
        ("zz\n0.1\n", ['"zz" is not a column in 2-D']),
        ("xx,xx\n0.1,0.1\n", ["named twice"]),
        ("xx,yy\n0.1,0.1\n0.1\n", ["row 2 has 1 numbers"]),
        ("xx\nfew\n", ['row 1: xx = "few" must be a number']),
        ("xx\n0.9\n", ["xx", "from -0.5 to 0.5"]),
        ("dt,xx\n0,0.1\n", ["dt", "> 0 s"]),
        ("xx\nnan\n", ["must be a number"]),
    ],
)
def test_a_wrong_file_of_increments_is_named_with_row_and_column(text, fragments, tmp_path, capsys):
    file = tmp_path / "mine.csv"
    file.write_text(text, encoding="utf-8")
    message = refused(["point", "neo_hookean", "--dimension", "2", "--increments", str(file)], capsys)
    assert all(fragment in message for fragment in ("mine.csv", *fragments)), message


def test_a_picture_without_matplotlib_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    message = refused(["point", "neo_hookean", "--plot", str(tmp_path / "x.png")], capsys)
    assert "pip install 'pmpm[viz]'" in message


def test_a_picture_leaves_out_a_panel_with_nothing_to_see():
    rubber, _, _ = typical_run("neo_hookean", path="simple_shear", steps=5, cycles=0)
    assert panels_of(rubber, PATHS["simple_shear"]) == [("strain", "stress_xy"), ("p", "q")]
    water, _, _ = typical_run("fluid", steps=5)
    assert panels_of(water, PATHS["isotropic"]) == [("strain", "p")]


def test_a_picture_that_cannot_be_written_is_refused(capsys):
    pytest.importorskip("matplotlib")
    assert main(["point", "neo_hookean", "--steps", "2", "--plot", "/proc/none/x.png"]) == 2
    assert "--plot /proc/none/x.png" in capsys.readouterr().err


def test_a_picture_is_drawn(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    file, increments = tmp_path / "x.png", tmp_path / "mine.csv"
    increments.write_text("xy\n0.1\n0.1\n", encoding="utf-8")
    for path in (["--steps", "10"], ["--increments", str(increments)]):
        assert main(["point", "drucker_prager", *path, "--plot", str(file)]) == 0
        assert file.read_bytes().startswith(b"\x89PNG")
