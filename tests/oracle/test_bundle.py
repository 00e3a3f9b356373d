"""The bundle adjustment beside SciPy's least squares: the same optimum, and the covariance of its Jacobian."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import markerloom as ml
from markerloom import _core
from markerloom.observations import DotArrays

FREE = 14
"""Free parameters of a camera: rotation, position, focal length, principal point, c1, c2, p1, p2, c3."""


def project(camera: np.ndarray, turn: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Pixels of places (n, 3) by a camera's parameters (14,) about the rotation ``turn``."""
    rotation = Rotation.from_rotvec(camera[:3]).as_matrix() @ turn
    x, y, z = rotation @ (places - camera[3:6]).T
    x, y = x / z, y / z
    c1, c2, p1, p2, c3 = camera[9:14]
    r2 = x * x + y * y
    radial = (1 + c2 * r2**2 + c3 * r2**3) / (1 - c1 * r2)
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return camera[6] * np.column_stack([u, v]) + camera[7:9]


@pytest.fixture(scope="module")
def solved() -> tuple[dict, np.ndarray]:
    """An adjusted wave and the pixels of its dots."""
    scene = ml.make_scene(
        "wand", cameras=3, frames=70, rate_hz=6.0, clutter_per_frame=0.0, reflections=0, hide="none", seed=3
    )
    take = ml.simulate(scene)
    dots = take.observations
    order = np.argsort(dots.frame, kind="stable")
    starts = np.searchsorted(dots.frame[order], np.arange(scene.frames + 1))
    arrays = DotArrays(starts, dots.camera[order], dots.pixel[order], np.ones(len(dots)))
    cameras = [
        ml.Camera(i, (1280.0, 1024.0), (1280.0, 1280.0), (639.5, 511.5), np.eye(3), np.zeros(3)) for i in take.rig.ids
    ]
    places = ml.read_wand(scene.wand).places_m.tolist()
    result = _core.calibrate_wand([c._described() for c in cameras], "nothing", places, arrays, 10, 6000)
    return result, dots.pixel[order]


@pytest.mark.slow
def test_scipy_finds_nothing_better_and_the_same_covariance(solved: tuple[dict, np.ndarray]):
    result, pixels = solved
    cameras, poses = len(result["cameras"]), len(result["pose_frame"])
    used = result["used"]
    pose, camera, marker = (result[k][used] for k in ("pose", "camera", "marker"))
    pixel, sigma = pixels[result["dot"][used]], np.array(result["noise_px"])[camera]
    turns = [np.array(c["rotation"]) for c in result["cameras"]]
    start = []
    for described in result["cameras"]:
        _, k2, p1, p2, k3, k4 = described["coefficients"][:6]
        lens = [-k4, k2, p1, p2, k3]
        start += [0.0, 0.0, 0.0, *described["position_m"], described["focal_px"][0], *described["principal_px"], *lens]
    start = np.concatenate([start, np.column_stack([np.zeros((poses, 3)), result["pose_position_m"]]).ravel()])

    def residuals(p: np.ndarray) -> np.ndarray:
        own = p[: cameras * FREE].reshape(cameras, FREE)
        placed = p[cameras * FREE :].reshape(poses, 6)
        rotation = result["pose_rotation"] @ Rotation.from_rotvec(placed[:, :3]).as_matrix()
        places = np.einsum("nij,nj->ni", rotation[pose], result["markers_m"][marker]) + placed[pose, 3:]
        off = np.empty((len(pose), 2))
        for i in range(cameras):
            rows = camera == i
            off[rows] = pixel[rows] - project(own[i], turns[i], places[rows])
        return (off / sigma[:, None]).ravel()

    ours = float(np.sum(residuals(start) ** 2))
    assert ours == pytest.approx(len(residuals(start)) - cameras * FREE - poses * 6 + 6, rel=0.02)
    found = least_squares(residuals, start, x_scale="jac", method="trf", xtol=1e-12, ftol=1e-12, gtol=1e-10, max_nfev=8)
    assert 2 * found.cost > ours * (1 - 1e-5)

    # Known up to the world's six motions: laid onto the camera centres, as ours is.
    matrix = found.jac.T @ found.jac
    scale = 1 / np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    assert values[6] > 1e3 * abs(values[5])
    covariance = (vectors[:, 6:] / values[6:]) @ vectors[:, 6:].T * np.outer(scale, scale)
    centers = np.array([c["position_m"] for c in result["cameras"]])
    motions, hold = np.zeros((cameras * FREE, 6)), np.zeros((6, cameras * FREE))
    for i in range(cameras):
        x, y, z = centers[i] - centers.mean(axis=0)
        turn = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        at = i * FREE
        motions[at + 3 : at + 6, :3], motions[at + 3 : at + 6, 3:] = np.eye(3), turn
        motions[at : at + 3, 3:] = -turns[i]
        hold[:3, at + 3 : at + 6], hold[3:, at + 3 : at + 6] = np.eye(3), turn.T
    lay = np.eye(cameras * FREE) - motions @ np.linalg.solve(hold @ motions, hold)
    theirs = np.sqrt(np.diag(lay @ covariance[: cameras * FREE, : cameras * FREE] @ lay.T))
    mine = np.sqrt(np.diag(result["covariance"])).reshape(cameras, 15)[:, :FREE].ravel()
    assert mine == pytest.approx(theirs, rel=0.02)
