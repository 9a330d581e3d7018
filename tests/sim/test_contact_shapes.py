"""The fingertips' contacts with curved tools, against the definition of the nearest point."""

from __future__ import annotations

import numpy as np
import pytest

from aminn_sim import SimulationConfig, _core
from aminn_sim.open_hand import open_hand

# Numbers of MuJoCo's mjtGeom.
SPHERE, CAPSULE, ELLIPSOID, CYLINDER = 2, 3, 4, 5


def test_no_tool_has_a_box() -> None:
    """Two boxes have half of their overlap in MuJoCo 2.2, and no closed form here stands in for that."""
    config = SimulationConfig()
    simulator, options = open_hand(None).simulator(), config.options()
    for family in config.family_indices():
        geoms = _core.Session(simulator, options, 3, 0, family, family, [family]).scene()["tool_geoms"]
        assert {int(geom["type"]) for geom in geoms} <= {SPHERE, CAPSULE, ELLIPSOID, CYLINDER}


@pytest.mark.parametrize("half", [(0.05, 0.015, 0.02), (0.02, 0.02, 0.02), (0.04, 0.025, 0.009)])
def test_nearest_point_of_an_ellipsoid(half: tuple[float, float, float]) -> None:
    """The point found lies on the surface, and the way to it is normal to the surface."""
    e, rng = np.array(half), np.random.default_rng(1)
    for _ in range(200):
        outward = rng.normal(size=3)
        foot = e * outward / np.linalg.norm(outward)
        normal = foot / e**2 / np.linalg.norm(foot / e**2)
        for distance in (0.02, 0.0098, 1e-6, -1e-4):
            found, d = _core.nearest_on_ellipsoid(e, foot + distance * normal)
            np.testing.assert_allclose(found, normal, atol=1e-9)
            assert d == pytest.approx(distance, abs=1e-12)


def test_points_on_the_axes_of_an_ellipsoid() -> None:
    e = np.array([0.05, 0.015, 0.02])
    for axis in range(3):
        for sign in (-1.0, 1.0):
            point = np.zeros(3)
            point[axis] = sign * (e[axis] + 0.01)
            normal, distance = _core.nearest_on_ellipsoid(e, point)
            np.testing.assert_allclose(normal, np.eye(3)[axis] * sign, atol=1e-12)
            assert distance == pytest.approx(0.01)
    normal, distance = _core.nearest_on_ellipsoid(e, np.zeros(3))
    assert distance == pytest.approx(-0.015) and np.linalg.norm(normal) == pytest.approx(1)


def test_nearest_point_of_a_cylinder() -> None:
    """Against the closest of a dense set of surface points."""
    radius, half = 0.015, 0.05
    angle = np.linspace(0, 2 * np.pi, 721)
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], 1)
    z = np.linspace(-half, half, 401)
    side = np.concatenate([np.c_[ring, np.full(len(ring), v)] for v in z])
    disc = np.concatenate(
        [np.c_[s * ring, np.full(len(ring), v)] for s in np.linspace(0, 1, 61) for v in (-half, half)]
    )
    surface, rng = np.concatenate([side, disc]), np.random.default_rng(2)
    for point in rng.uniform([-0.03, -0.03, -0.07], [0.03, 0.03, 0.07], (60, 3)):
        normal, distance = _core.nearest_on_cylinder(radius, half, point)
        nearest = surface[np.argmin(np.linalg.norm(surface - point, axis=1))]
        assert abs(distance) == pytest.approx(np.linalg.norm(nearest - point), abs=3e-5)
        assert (distance < 0) == (np.hypot(*point[:2]) < radius and abs(point[2]) < half)
        np.testing.assert_allclose(point - distance * normal, nearest, atol=6e-4)


def test_placements_are_sobol_points() -> None:
    """The same point sets as PyTorch's generator (it orders them otherwise)."""
    torch = pytest.importorskip("torch")
    ours = np.stack([_core.sobol_point(i) for i in range(256)])
    theirs = torch.quasirandom.SobolEngine(ours.shape[1]).draw(256, dtype=torch.float64).numpy()
    np.testing.assert_allclose(np.sort(ours, axis=0), np.sort(theirs, axis=0), atol=1e-9)
    order = {tuple(np.round(x, 9)) for x in theirs}
    assert {tuple(np.round(x, 9)) for x in ours} == order


SOLIDS = {
    "capsule": lambda rng: ("capsule", rng.uniform(0.004, 0.03, 2)),
    "cylinder": lambda rng: ("cylinder", rng.uniform(0.004, 0.03, 2)),
    "ellipsoid": lambda rng: ("ellipsoid", rng.uniform(0.004, 0.03, 3)),
    "box": lambda rng: ("box", rng.uniform(0.004, 0.03, 3)),
}


@pytest.mark.parametrize("first", SOLIDS)
@pytest.mark.parametrize("second", ["capsule", "cylinder", "ellipsoid"])
def test_no_contact_is_left_out_where_the_search_is(first: str, second: str) -> None:
    """Solids that the current MuJoCo finds in each other touch here too, and those apart do not."""
    mujoco = pytest.importorskip("mujoco", reason="the extra mujoco is not installed: pip install aminn[mujoco]")
    rng, touching, apart = np.random.default_rng(4), 0, 0
    for _ in range(60):
        bodies = ""
        for name in (first, second):
            kind, size = SOLIDS[name](rng)
            turn = rng.normal(size=4)
            numbers = {"size": size, "quat": turn / np.linalg.norm(turn)}
            place = " ".join(f"{x:.17g}" for x in rng.uniform(-0.025, 0.025, 3))
            words = " ".join(f'{k}="{" ".join(f"{x:.17g}" for x in v)}"' for k, v in numbers.items())
            bodies += f'<body pos="{place}"><freejoint/><geom type="{kind}" {words}/></body>'
        text = f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"
        engine, model = _core.Engine(text), mujoco.MjModel.from_xml_string(text)
        engine.forward()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        distance = mujoco.mj_geomDistance(model, data, 0, 1, 1.0, None)
        if abs(distance) > 1e-5:
            assert bool(engine.contacts()) == (distance < 0), (text, distance)
        touching, apart = touching + (distance < -1e-5), apart + (distance > 1e-5)
    assert touching > 5 and apart > 5
