"""The active-stereo depth camera: both infrared views ray-cast with a projected dot pattern, noise, stereo matching.

Method after Zhang et al., "Close the Optical Sensing Domain Gap by Physics-Grounded Active Stereo Sensor Simulation"
(T-RO 2023): the errors of such depth are those of a real camera (shadow holes, fattened edges, closed gaps) because
they arise in the same way.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import mujoco
import numpy as np

from s2r_sim.camera.intrinsics import StereoRig
from s2r_sim.camera.matching import Matching, depth, disparity
from s2r_sim.camera.pattern import dot_texture, illuminate
from s2r_sim.camera.raycast import Hits, cast
from s2r_sim.world import CameraTruth

REACH_M = 3.0
SHADOW_TOLERANCE_M = 0.008
# Sensor noise in 8-bit grey levels: times Gamma(398.12, 0.00254), plus Gaussian (-0.231, 0.83).
SPECKLE_MEAN, SPECKLE_SIGMA = 398.12 * 0.00254, 398.12**0.5 * 0.00254
NOISE_MEAN, NOISE_SIGMA = -0.231, 0.83
BIAS_WAVES, BIAS_RMS_PX = 4, 0.04  # 0.04 px are 0.7 mm at 0.8 m
AMBIENT = 0.05  # share of light that does not come from the projector
EXPOSURE_GREY = 190.0  # auto exposure brings the bright end here
BACKGROUND = 0.75  # grey of the far room
BAND_ROWS = 40
LIGHT_DIRECTION = np.array([-0.45, -0.35, 0.82])  # towards the ceiling lamp, world frame


def bias_waves(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """What calibration leaves over: a smooth disparity error [px] that stays the same from frame to frame."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) / width
    field = np.zeros((height, width), np.float32)
    for _ in range(BIAS_WAVES):
        direction, cycles = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 2.5)
        phase = 2 * np.pi * (cycles * (x * np.cos(direction) + y * np.sin(direction)) + rng.uniform())
        field += np.sin(phase).astype(np.float32)
    return field * np.float32(BIAS_RMS_PX * np.sqrt(2 / BIAS_WAVES))


@dataclass(frozen=True, eq=False)
class View:
    """One image.

    Attributes:
        depth_m: 0 where there is no return, shape (height, width), float32.
        colour: RGB, registered to the depth, shape (height, width, 3), uint8.
        infrared: Left and right images, shape (height, width), uint8.
    """

    depth_m: np.ndarray
    colour: np.ndarray
    infrared: tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Sight:
    """What is really there, per pixel of the left imager.

    Attributes:
        body: MuJoCo's body index, -1 where nothing is in reach, shape (height, width).
        point: Surface point in the world frame [m], shape (height, width, 3).
        normal: Unit normal towards the camera's side, shape (height, width, 3).
    """

    body: np.ndarray
    point: np.ndarray
    normal: np.ndarray


class DepthCamera:
    """Renders one world through the true camera pose. Not thread-safe: one caller at a time."""

    def __init__(self, model: mujoco.MjModel, truth: CameraTruth, rig: StereoRig | None = None) -> None:
        self.model = model
        self.rig = rig if rig is not None else StereoRig()
        self.X_base_camera = truth.X_base_camera_true
        self._data = mujoco.MjData(model)
        pattern_rng, self._rng = np.random.default_rng([truth.seed, 415]).spawn(2)
        self._texture = dot_texture(pattern_rng)
        self._bias_px = bias_waves(pattern_rng, self.rig.height, self.rig.width)
        self._matching = Matching()
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="camera")
        R, rig = self.X_base_camera[:3, :3], self.rig
        self._R_camera_base = R.T.astype(np.float32)
        self._rays = rig.rays.astype(np.float32).reshape(rig.height, rig.width, 3)
        self._rays_world = (rig.rays @ R.T).reshape(rig.height, rig.width, 3)
        self._projector_rays_world = (rig.projector_rays @ R.T).reshape(rig.height, -1, 3)
        self._rgb = model.geom_rgba[:, :3].astype(np.float32)
        self._albedo = self._rgb.mean(axis=1)
        self._lamp = LIGHT_DIRECTION / np.linalg.norm(LIGHT_DIRECTION)

    def capture(self, qpos: np.ndarray) -> View:
        """See the world at the joint positions ``qpos`` (MuJoCo order)."""
        self._place(qpos)
        lit_depth = self._lit_depth()
        left, colour = self._look(np.zeros(3), lit_depth)
        right, _ = self._look(np.array([self.rig.baseline_m, 0.0, 0.0]), lit_depth)
        exposure = EXPOSURE_GREY / max(float(np.percentile(left[::4, ::4], 98)), 1e-6)
        images = self._expose(left, exposure), self._expose(right, exposure)
        d = disparity(*images, self._matching)
        d = np.where(d > 0, d + self._bias_px, d)
        return View(depth(d, self.rig.f_px, self.rig.baseline_m, REACH_M), colour, images)

    def exact_depth(self, qpos: np.ndarray) -> np.ndarray:
        """True depth of the left imager [m], 0 where nothing is in reach, shape (height, width)."""
        self._place(qpos)
        out = np.empty((self.rig.height, self.rig.width))

        def band(rows: slice) -> None:
            hits = self._cast(np.zeros(3), self._rays_world[rows])
            out[rows] = np.maximum(hits.distance, 0.0).reshape(-1, self.rig.width)

        self._in_bands(band)
        return out

    def exact_sight(self, qpos: np.ndarray) -> Sight:
        """Bodies, points and normals without noise: for labels, never for a host."""
        self._place(qpos)
        h, w = self.rig.height, self.rig.width
        sight = Sight(np.empty((h, w), np.int32), np.empty((h, w, 3)), np.empty((h, w, 3)))
        of_geom = np.append(self.model.geom_bodyid, -1)  # geom -1: nothing hit

        def band(rows: slice) -> None:
            hits = self._cast(np.zeros(3), self._rays_world[rows])
            rays = self._rays_world[rows].reshape(-1, 3)
            sight.body[rows] = of_geom[hits.geom].reshape(-1, w)
            sight.point[rows] = (self.X_base_camera[:3, 3] + hits.distance[:, None] * rays).reshape(-1, w, 3)
            sight.normal[rows] = hits.normal.reshape(-1, w, 3)

        self._in_bands(band)
        return sight

    def _place(self, qpos: np.ndarray) -> None:
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self._data)

    def _in_bands(self, work: Callable[[slice], None]) -> None:
        """Run ``work`` on bands of rows in two threads; small bands stay in the cache."""
        starts = range(0, self.rig.height, BAND_ROWS)
        for done in [self._pool.submit(work, slice(s, min(s + BAND_ROWS, self.rig.height))) for s in starts]:
            done.result()

    def _cast(self, p_camera: np.ndarray, rays_world: np.ndarray) -> Hits:
        origin = self.X_base_camera[:3, :3] @ p_camera + self.X_base_camera[:3, 3]
        return cast(self.model, self._data, origin, rays_world.reshape(-1, 3), REACH_M)

    def _lit_depth(self) -> np.ndarray:
        """Depth of the first surface along every ray of the projector: what lies behind is in its shadow."""
        out = np.empty(self._projector_rays_world.shape[:2], np.float32)

        def band(rows: slice) -> None:
            hits = self._cast(np.asarray(self.rig.projector_m), self._projector_rays_world[rows])
            out[rows] = np.where(hits.distance > 0, hits.distance, 2 * REACH_M).reshape(-1, out.shape[1])

        self._in_bands(band)
        return out

    def _look(self, p_imager: np.ndarray, lit_depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Light on one imager (not yet exposed), and the colours it would see."""
        light = np.empty((self.rig.height, self.rig.width), np.float32)
        colour = np.empty((self.rig.height, self.rig.width, 3), np.uint8)

        def band(rows: slice) -> None:
            hits = self._cast(p_imager, self._rays_world[rows])
            light[rows] = self._light(hits, self._rays[rows], p_imager, lit_depth)
            colour[rows] = self._shade(hits).reshape(-1, self.rig.width, 3)

        self._in_bands(band)
        return light, colour

    def _light(self, hits: Hits, rays: np.ndarray, p_imager: np.ndarray, lit_depth: np.ndarray) -> np.ndarray:
        """Light that hit points send back: pattern where the projector sees them, ambient everywhere."""
        rig, shape = self.rig, rays.shape[:2]
        z = np.where(hits.distance > 0, hits.distance, REACH_M).astype(np.float32).reshape(shape)
        # The points in the projector's frame, and where its image plane they fall on.
        offset = (p_imager - np.asarray(rig.projector_m)).astype(np.float32)
        x, y, z = rays[..., 0] * z + offset[0], rays[..., 1] * z + offset[1], z + offset[2]
        tan_x, tan_y = x / z, y / z
        u = tan_x * np.float32(rig.f_px) + np.float32(rig.K[0, 2] + rig.projector_margin_px)
        v = tan_y * np.float32(rig.f_px) + np.float32(rig.K[1, 2])
        first = cv2.remap(lit_depth, u, v, cv2.INTER_NEAREST, borderValue=0.0)
        pattern = illuminate(self._texture, tan_x, tan_y, rig.projector_half_angle_rad)
        normal = cv2.transform(hits.normal.astype(np.float32).reshape(*shape, 3), self._R_camera_base)
        range_sq = x * x + y * y + z * z
        cosine = -(normal[..., 0] * x + normal[..., 1] * y + normal[..., 2] * z) / np.sqrt(range_sq)
        lit = z - first < SHADOW_TOLERANCE_M
        direct = np.where(lit, np.clip(cosine, 0.0, 1.0) / range_sq, np.float32(0.0)) * pattern
        ambient = AMBIENT * (0.5 + 0.5 * np.abs(normal[..., 2]))
        geom = hits.geom.reshape(shape)
        return np.where(geom >= 0, self._albedo[geom] * (direct + ambient), np.float32(0.0))

    def _shade(self, hits: Hits) -> np.ndarray:
        """Colour of hit points under a ceiling lamp, shape (n, 3), uint8."""
        shade = np.float32(0.45) + np.float32(0.55) * np.clip(hits.normal @ self._lamp, 0.0, 1.0)
        image = np.where(
            (hits.geom >= 0)[:, None], self._rgb[hits.geom] * shade[:, None], np.float32(BACKGROUND)
        )
        return np.clip(np.rint(255 * image), 0, 255).astype(np.uint8)

    def _expose(self, light: np.ndarray, exposure: float) -> np.ndarray:
        """Grey levels with noise. A gamma law of shape 398 is as good as normal."""
        speckle = self._rng.standard_normal(light.shape, dtype=np.float32)
        noise = self._rng.standard_normal(light.shape, dtype=np.float32)
        grey = light * exposure * (SPECKLE_MEAN + SPECKLE_SIGMA * speckle) + (
            NOISE_MEAN + NOISE_SIGMA * noise
        )
        return np.clip(np.rint(grey), 0, 255).astype(np.uint8)
