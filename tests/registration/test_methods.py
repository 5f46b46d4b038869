"""KISS-ICP as a registration method, one from another package, and specmap without kiss-icp."""

import re
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.map_server import write_grid
from specmap_cli.registration import Aligner, FrontEnd, SensorKind
from specmap_cli.registration.aligner import GROUP, KissIcpAligner, aligner_factory
from tests.conftest import SAMPLE_LOGS
from tests.plugins import install
from tests.registration.drives import run, turned, worst
from tests.strategies import few
from tests.turning import configured

# What another package could hold: point-to-point ICP on a k-d tree.
POINT_TO_POINT = """
    from collections import deque

    import numpy as np
    from scipy.spatial import KDTree

    from specmap_cli.registration.aligner import WINDOW_KEYFRAMES


    class TreeIcp:
        def __init__(self, config, sensor):
            self.clouds = deque(maxlen=WINDOW_KEYFRAMES)
            self.tree = None

        def insert(self, points, map_from_base):
            self.clouds.append(points @ map_from_base[:3, :3].T + map_from_base[:3, 3])
            self.tree = KDTree(np.concatenate(self.clouds))

        def clear(self):
            self.clouds.clear()
            self.tree = None

        def align(self, points, guess, kernel_m, *, coarse):
            pose = guess
            for _ in range(5 if coarse else 50):
                here = points @ pose[:3, :3].T + pose[:3, 3]
                distance, nearest = self.tree.query(here, distance_upper_bound=3 * kernel_m)
                met = np.isfinite(distance)
                if met.sum() < 6:
                    break
                source, target = here[met], self.tree.data[nearest[met]]
                weights = kernel_m**2 / (kernel_m**2 + distance[met] ** 2)
                centre, aim = (np.average(p, axis=0, weights=weights) for p in (source, target))
                u, _, vt = np.linalg.svd((source - centre).T * weights @ (target - aim))
                sign = np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)])
                step = np.eye(4)
                step[:3, :3] = vt.T @ sign @ u.T
                step[:3, 3] = aim - step[:3, :3] @ centre
                pose = step @ pose
                if np.abs(step - np.eye(4)).max() < 1e-4:
                    break
            return pose
"""


def offered(folder: Path, monkeypatch: pytest.MonkeyPatch, **entries: str) -> None:
    install(folder, monkeypatch, GROUP, entries, POINT_TO_POINT)


def test_a_method_of_another_package_registers_a_simulated_tour(
    flat_tour: list[tuple[Sweep, Pose2]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offered(tmp_path, monkeypatch, **{"tree-icp": "TreeIcp"})
    items, poses = zip(*flat_tour[:150], strict=True)
    front_end, scans = run(items, method="tree-icp")
    assert np.less(worst(scans, np.array(poses)), (0.1, 0.03)).all()
    assert front_end.counts["registered"] == 150
    by_kiss_icp = run(items)[1]
    assert [scan.map_from_base for scan in scans] != [scan.map_from_base for scan in by_kiss_icp]
    found, other = (np.array([s.map_from_base for s in each]) for each in (scans, by_kiss_icp))
    assert np.abs(compose(invert(found), other)[:, :2]).max() < 0.1


def test_kiss_icp_is_the_default_and_unknown_methods_and_names_in_use_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offered(tmp_path, monkeypatch, **{"tree-icp": "TreeIcp"})
    assert RegistrationConfig().method == "kiss-icp"
    assert aligner_factory("kiss-icp") is KissIcpAligner
    with pytest.raises(UsageError) as refused:
        FrontEnd(RegistrationConfig(method="magic"))
    assert str(refused.value) == (
        "registration.method: no such method 'magic': choose from kiss-icp, tree-icp, or "
        "install the package that offers it"
    )
    (tmp_path / "other").mkdir()
    offered(tmp_path / "other", monkeypatch, **{"kiss-icp": "TreeIcp"})
    with pytest.raises(UsageError, match=r"offers 'kiss-icp' in specmap\.registration"):
        FrontEnd(RegistrationConfig())


def in_a_house_without_kiss_icp(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python code where importing kiss_icp fails as if it were not installed."""
    missing = 'import sys; sys.modules["kiss_icp"] = None\n'
    return subprocess.run(
        [sys.executable, "-c", missing + dedent(code), *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=SAMPLE_LOGS.parent,
    )


def test_every_module_of_registration_can_be_imported_without_kiss_icp() -> None:
    """And the front end says in one line what it needs as soon as it registers with it."""
    found = in_a_house_without_kiss_icp(
        """
        import importlib, pkgutil
        import numpy as np
        from specmap_cli import registration
        from specmap_cli.core.settings import RegistrationConfig
        from specmap_cli.core.errors import UsageError
        from tests.registration.drives import circle

        names = [m.name for m in pkgutil.iter_modules(registration.__path__)]
        for name in names:
            importlib.import_module(f"specmap_cli.registration.{name}")
        assert "aligner" in names and "frontend" in names
        front_end = registration.FrontEnd(RegistrationConfig())
        try:
            front_end.register(circle(0, np.ones(4)))
        except UsageError as error:
            print(error)
        """
    )
    assert found.stderr == ""
    needs = "registration.method 'kiss-icp' needs the package kiss-icp: No module named 'kiss_icp"
    assert re.fullmatch(f"{needs}.*; install it or choose another method\n", found.stdout)


def test_a_floor_plan_is_segmented_without_kiss_icp(flat: GridMap, tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_grid(tmp_path / "plan", flat)
    found = in_a_house_without_kiss_icp(
        "from specmap_cli.cli import main; sys.exit(main())",
        *("segment", str(tmp_path / "plan.yaml"), "-o", str(out)),
    )
    assert found.returncode == 0, found.stderr
    assert (out / "topology.json").exists()


def aligner(in_space: bool = True, **settings: int) -> KissIcpAligner:
    sensor = SensorKind(in_space=in_space, voxel_m=0.2, range_m=20.0)
    return KissIcpAligner(configured(RegistrationConfig, "registration", settings), sensor)


def room(seed: int) -> FloatArray:
    """Points (N, 3) on floor and four walls of a room, the two long ones with a step in them."""
    u, v = np.random.default_rng(seed).uniform(0.0, 1.0, (2, 250))
    faces = [
        np.column_stack([6 * u, 4 * v, 0 * u]),
        np.column_stack([6 * u, 0.5 * (u > 0.4), 2 * v]),
        np.column_stack([6 * u, 4 - 0.7 * (u > 0.7), 2 * v]),
        np.column_stack([0 * u, 4 * v, 2 * u]),
        np.column_stack([6 + 0 * u, 4 * v, 2 * u]),
    ]
    return np.concatenate(faces) - (3.0, 2.0, 0.0)


def aligned(method: Aligner, points: FloatArray, guess: FloatArray) -> FloatArray:
    for kernel_m in (0.4, 0.2, 0.1, 0.05):
        guess = method.align(points, guess, kernel_m, coarse=False)
    return guess


@few(15)
@given(*(st.floats(-most, most) for most in (0.15, 0.15, 0.08, 0.03)))
def test_a_moved_cloud_comes_back_to_its_pose(x: float, y: float, yaw: float, roll: float) -> None:
    """Other points of the same room, so that no point finds itself."""
    method = aligner()
    keyframe = Pose2(5.0, -3.0, 0.7).matrix()
    method.insert(room(0), keyframe)
    found = aligned(method, room(1), keyframe @ turned(x, yaw, roll) @ Pose2(0.0, y, 0.0).matrix())
    assert np.linalg.norm((found - keyframe)[:3, 3]) < 0.02
    assert np.abs(found[:3, :3] - keyframe[:3, :3]).max() < 0.01


def test_a_coarse_alignment_may_stop_early_and_points_far_from_everything_do_not_move() -> None:
    method = aligner(in_space=False)
    method.insert(room(0), np.eye(4))
    guess = turned(0.2, 0.1, 0.0)
    coarse, fine = (method.align(room(1), guess, 0.2, coarse=flag) for flag in (True, False))
    assert not np.array_equal(coarse, fine)
    assert np.linalg.norm(coarse[:3, 3]) < 0.05
    far = Pose2(50.0, 0.0, 0.0).matrix()
    assert np.array_equal(method.align(room(1), far, 0.2, coarse=False), far)


def pulled_m(method: KissIcpAligner, place_m: float) -> float:
    """How far a room is pulled to what the map holds at a place."""
    guess = Pose2(place_m + 0.1, 0.0, 0.0).matrix()
    found = method.align(room(1), guess, 0.2, coarse=False)
    return float(np.linalg.norm((found - guess)[:3, 3]))


def test_a_keyframe_that_left_the_window_leaves_the_map_at_the_next_rebuild() -> None:
    method = aligner()
    for number in range(81):  # rooms 20 m apart, of which the window holds eighty
        assert not number or pulled_m(method, 0.0) > 0.05
        method.insert(room(0), Pose2(20.0 * number, 0.0, 0.0).matrix())
    assert pulled_m(method, 0.0) == 0.0
    assert pulled_m(method, 20.0) > 0.05


def test_a_cleared_map_is_as_good_as_new() -> None:
    cleared, new = aligner(), aligner()
    for _ in range(3):
        cleared.insert(room(0), np.eye(4))
    cleared.clear()
    assert pulled_m(cleared, 0.0) == 0.0
    for number in range(3):
        for method in (cleared, new):
            method.insert(room(number), Pose2(20.0 + 0.03 * number, 0.0, 0.0).matrix())
        assert pulled_m(cleared, 0.0) == 0.0
        assert pulled_m(cleared, 20.0) == pulled_m(new, 20.0) > 0.05


@pytest.mark.parametrize(
    ("in_space", "name"), [(False, "points_per_voxel"), (True, "cloud_points_per_voxel")]
)
def test_a_full_voxel_keeps_the_newest_keyframe_s_points(in_space: bool, name: str) -> None:
    """Two keyframes of one room 8 cm apart, with one point a voxel: the newer decides."""
    ahead = []
    for rebuild_keyframes in (1, 4):  # not rebuilt: the older stays
        method = aligner(in_space=in_space, **{name: 1, "rebuild_keyframes": rebuild_keyframes})
        for place_m in (0.0, 0.08):
            method.insert(room(0), Pose2(place_m, 0.0, 0.0).matrix())
        ahead.append(aligned(method, room(1), np.eye(4))[0, 3])
    assert ahead[0] > 0.05 > ahead[1]


@pytest.mark.parametrize("coarse", [True, False])
def test_two_runs_are_identical_and_arguments_stay(coarse: bool) -> None:
    points, guess = room(1), turned(0.1, 0.05, 0.01)
    found = []
    for _ in range(2):
        method = aligner()
        method.insert(room(0), np.eye(4))
        found.append(method.align(points, guess, 0.2, coarse=coarse))
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(points, room(1))
    assert np.array_equal(guess, turned(0.1, 0.05, 0.01))
