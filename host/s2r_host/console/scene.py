"""The 3D view: the real arm, the reference and the twin as ghosts, the plan's path, clouds and the estimated axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import viser

from s2r_host.report.arm_shapes import ArmShapes, quat_wxyz

STILL = 1e-5
_HAIR_M = 8e-4
MAX_POINTS = 40_000
TABLE_TOP_M, REACH_M = 0.01, 1.3
REAL = ((72, 80, 92), (217, 114, 46))  # links in turn, as the picture of a real arm
PLAN_COLOUR, TWIN_COLOUR = (59, 111, 182), (47, 143, 84)
AXIS_COLOUR, PATH_COLOUR = (192, 38, 75), (59, 111, 182)
TABLE_COLOUR = (240, 242, 245)


@dataclass(frozen=True, eq=False)
class Axis:
    """An estimated joint axis in the base frame: a point [m], a unit direction, prismatic or revolute."""

    origin_m: np.ndarray
    direction: np.ndarray
    kind: str

    def is_as(self, other: Axis | None) -> bool:
        """Another one would be drawn alike."""
        return other is not None and (
            self.kind == other.kind
            and np.array_equal(self.origin_m, other.origin_m)
            and np.array_equal(self.direction, other.direction)
        )


class ArmView:
    """One arm in the scene: each body hangs on the one before, so that a joint's motion is one message."""

    def __init__(
        self,
        scene: viser.SceneApi,
        shapes: ArmShapes,
        name: str,
        colours: tuple[tuple[int, int, int], ...],
        opacity: float | None = None,
    ) -> None:
        self._shapes = shapes
        self._sent = np.tile(np.eye(4), (len(shapes.bodies), 1, 1))
        self._root = scene.add_frame(f"/{name}", show_axes=False)
        self._root.visible = False  # until it is known where the joints are
        self._handles = []
        path = f"/{name}"
        for i, body in enumerate(shapes.bodies):
            path += f"/{body.name}"
            mesh = scene.add_mesh_simple(
                path,
                # A body and its neighbours share surfaces; a hair of difference keeps them from flickering.
                body.inflated(_HAIR_M * (i % 3)),
                body.faces,
                color=colours[i % len(colours)],
                opacity=opacity,
                flat_shading=False,
                cast_shadow=False,
                receive_shadow=False,
            )
            self._handles.append(mesh)

    def show(self, q: np.ndarray) -> None:
        """Move it to joint values [rad]."""
        X = self._shapes.poses(q)
        X[1:] = np.linalg.inv(X[:-1]) @ X[1:]  # of each body in the one before
        off = np.abs(X - self._sent)
        for i in np.nonzero(off[:, :3, 3].max(axis=1) > STILL)[0]:
            self._handles[i].position = X[i, :3, 3]
            self._sent[i, :3, 3] = X[i, :3, 3]
        for i in np.nonzero(off[:, :3, :3].max(axis=(1, 2)) > STILL)[0]:
            self._handles[i].wxyz = quat_wxyz(X[i, :3, :3])
            self._sent[i, :3, :3] = X[i, :3, :3]

    @property
    def visible(self) -> bool:
        """Shown at all."""
        return self._root.visible

    @visible.setter
    def visible(self, wanted: bool) -> None:
        if self._root.visible != wanted:
            self._root.visible = wanted


class CellScene:
    """Everything in the 3D view."""

    def __init__(self, server: viser.ViserServer, shapes: ArmShapes) -> None:
        self._scene = server.scene
        self._shapes = shapes
        self._scene.set_up_direction("+z")
        self._scene.configure_default_lights(
            True, cast_shadow=False
        )  # drawn in software on most lab machines
        # From the side: the arm on the left, the front of what it works on to the right of it.
        server.initial_camera.position = (0.05, -1.5, 0.85)
        server.initial_camera.look_at = (0.38, 0.0, 0.3)
        self._scene.add_grid(
            "/table",
            width=2.4,
            height=2.4,
            cell_size=0.1,
            section_size=0.5,
            cell_color=(225, 229, 234),
            section_color=(200, 206, 214),
            plane_color=TABLE_COLOUR,
            plane_opacity=0.9,
            shadow_opacity=0.0,
        )
        self.real = ArmView(self._scene, shapes, "real", REAL)
        self.plan = ArmView(self._scene, shapes, "plan", (PLAN_COLOUR,), opacity=0.28)
        self.twin = ArmView(self._scene, shapes, "twin", (TWIN_COLOUR,), opacity=0.28)
        self._path: viser.SceneNodeHandle | None = None
        self._cloud: viser.SceneNodeHandle | None = None
        self._axis: list[viser.SceneNodeHandle] = []
        self._axis_shown: Axis | None = None

    def show_path(self, q: np.ndarray | None) -> None:
        """The tool's way through joint values (n, dof), or none."""
        if self._path is not None:
            self._path.remove()
            self._path = None
        if q is not None and len(q) > 1:
            p = self._shapes.tool_path(q)
            pairs = np.stack([p[:-1], p[1:]], axis=1)
            self._path = self._scene.add_line_segments(
                "/plan_path", pairs, PATH_COLOUR, thickness=3.0, thickness_units="screen"
            )

    def show_cloud(self, points: np.ndarray, colours: np.ndarray | None = None) -> None:
        """Points (n, 3) [m] in the base frame with colours (n, 3) uint8; by height when there are none.

        The table is drawn anyway, and what lies beyond the arm's reach is noise: neither is shown.
        """
        near = (points[:, 2] > TABLE_TOP_M) & (np.linalg.norm(points[:, :2], axis=1) < REACH_M)
        points, colours = points[near], None if colours is None else colours[near]
        if len(points) > MAX_POINTS:
            keep = np.linspace(0, len(points) - 1, MAX_POINTS).astype(int)
            points, colours = points[keep], None if colours is None else colours[keep]
        shown = by_height(points) if colours is None else colours
        self._cloud = self._scene.add_point_cloud(
            "/cloud", points.astype(np.float32), shown, point_size=0.0035, point_shape="rounded"
        )

    def clear_object(self) -> None:
        """Take cloud and axis away."""
        if self._cloud is not None:
            self._cloud.remove()
            self._cloud = None
        self.show_axis(None)

    def show_cloud_visible(self, wanted: bool) -> None:
        """Show or hide cloud and axis."""
        for handle in (self._cloud, *self._axis):
            if handle is not None and handle.visible != wanted:
                handle.visible = wanted

    def show_axis(self, axis: Axis | None) -> None:
        """The estimated joint, as an arrow (prismatic) or a long line (revolute); None takes it away."""
        if axis is not None and axis.is_as(self._axis_shown):
            return
        self._axis_shown = axis
        for handle in self._axis:
            handle.remove()
        self._axis = []
        if axis is None:
            return
        reach = 0.3 * axis.direction
        ends = np.array([[axis.origin_m - (reach if axis.kind == "revolute" else 0), axis.origin_m + reach]])
        self._axis = [
            self._scene.add_arrows(
                "/axis", ends, AXIS_COLOUR, shaft_radius=0.006, head_radius=0.016, head_length=0.04
            ),
            self._scene.add_label(
                "/axis_label",
                f"estimated axis ({axis.kind})",
                position=ends[0, 1] + np.array([0.0, 0.0, 0.08]),
            ),
        ]


def by_height(points: np.ndarray) -> np.ndarray:
    """Colours (n, 3) uint8 from dark blue at the table to light at 0.6 m."""
    share = np.clip(points[:, 2] / 0.6, 0.0, 1.0)[:, None]
    return ((1 - share) * np.array([40, 74, 122]) + share * np.array([244, 196, 96])).astype(np.uint8)
