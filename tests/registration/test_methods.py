"""A registration method from another package, and specmap where kiss-icp does not exist."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import Pose2, compose, invert
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.map_server import write_grid
from specmap_cli.registration import FrontEnd
from specmap_cli.registration.aligner import GROUP, KissIcpAligner, aligner_factory
from tests.conftest import SAMPLE_LOGS
from tests.plugins import install
from tests.registration.drives import run, worst

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


WITHOUT_KISS_ICP = """
    import sys

    class Missing:
        def find_spec(self, name, path, target=None):
            if name.split(".")[0] == "kiss_icp":
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    sys.meta_path.insert(0, Missing())
"""


def in_a_house_without_kiss_icp(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python code where importing kiss_icp fails as if it were not installed."""
    return subprocess.run(
        [sys.executable, "-c", dedent(WITHOUT_KISS_ICP) + dedent(code), *arguments],
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
    assert found.stdout == (
        "registration.method 'kiss-icp' needs the package kiss-icp: No module named 'kiss_icp'; "
        "install it or choose another method\n"
    )


def test_a_floor_plan_is_segmented_without_kiss_icp(flat: GridMap, tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_grid(tmp_path / "plan", flat)
    found = in_a_house_without_kiss_icp(
        "from specmap_cli.cli import main; sys.exit(main())",
        *("segment", str(tmp_path / "plan.yaml"), "-o", str(out)),
    )
    assert found.returncode == 0, found.stderr
    assert (out / "topology.json").exists()
