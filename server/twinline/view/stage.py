"""The 3-D scene: the bed, one growing cloud, and where the viewer first stands."""

import threading
from dataclasses import dataclass

import numpy as np
import viser

from twinline.arrays import BoolArray, FloatArray
from twinline.fusion.cloud import PointCloud
from twinline.operations.clock import Clock
from twinline.operations.display import ColourMode, DisplayState, Legend
from twinline.view.colours import SCALED, colours, scalar, value_range

FLUSH_INTERVAL_S = 0.1
"""Batches that come faster are shown together: at most ten updates a second."""
RESCALE_FRACTION = 0.1
"""The colour scale is laid anew when the data's range has outgrown it by so much of its length."""
NODE_POINTS = 100_000
"""Points per scene node where a whole cloud is shown at once; a message stays below 2 MB."""
BARE_BED_MM = 2.0
"""What is not higher is taken for the bed when the camera is placed ..."""
OBJECT_FRACTION = 0.01
"""... if so much of the cloud is higher."""
STRAY_PERCENTILES = (0.5, 99.5)
"""Beyond these of each coordinate, points do not count for where the camera stands."""
CELL_MM = 2.0
FIELD_OF_VIEW_RAD = np.deg2rad(45.0)
_VIEW_DIRECTION = np.array([-0.45, -0.75, 0.6]) / np.linalg.norm([-0.45, -0.75, 0.6])
_EMPTY_BOUNDS = np.array([[-150.0, -100.0, 0.0], [150.0, 100.0, 60.0]])


@dataclass(eq=False)
class _Node:
    """One batch on the stage."""

    handle: viser.PointCloudHandle
    cloud: PointCloud


class Stage:
    """Shows one cloud in a viser scene; see `twinline.operations.display.CloudDisplay`.

    Every batch becomes a scene node with its own origin, so that a growing cloud sends only what is new, in float32.

    Parameters
    ----------
    server
        The viser server; its scene is taken over.
    max_points
        Points drawn at most; beyond it every second, then every fourth ... point is shown.
    """

    def __init__(self, server: viser.ViserServer, clock: Clock, *, max_points: int) -> None:
        self._server = server
        self._clock = clock
        self._max_points = max_points
        self._lock = threading.RLock()
        self._mode = ColourMode.HEIGHT
        self._placed: dict[int, FloatArray] = {}
        self._reset(None, None)
        self._furnish()
        server.on_client_connect(self._welcome)

    def begin(self, *, job_id: str | None = None, scan_id: str | None = None) -> None:
        """Clear the stage for another cloud."""
        with self._lock:
            for node in self._nodes:
                node.handle.remove()
            self._reset(job_id, scan_id)

    def append(self, cloud: PointCloud) -> None:
        """Add points; small batches may be held back for a moment."""
        with self._lock:
            self._points += len(cloud)
            self._held.append(_thinned(cloud, self._step))
            if self._clock.monotonic_s() - self._flushed_s >= FLUSH_INTERVAL_S:
                self._flush()

    def finish(self, *, scan_id: str | None = None) -> None:
        """Show all that was held back; the cloud is whole and is that of a scan."""
        with self._lock:
            self._flush()
            self._scan_id = scan_id
            self._rescale(force=True)
            self._place_cameras()

    def clear(self) -> None:
        """Show nothing."""
        self.begin()

    def set_colour(self, mode: ColourMode) -> None:
        """Colour all points in another way."""
        with self._lock:
            if mode is not self._mode:
                self._mode = mode
                self._rescale(force=True)

    def reset_cameras(self) -> None:
        """Let all viewers see the whole cloud again."""
        with self._lock:
            self._placed = {}
            self._place_cameras()

    def state(self) -> DisplayState:
        """What is shown now."""
        with self._lock:
            legend = None
            if self._ends is not None and self._mode in SCALED:
                legend = Legend(*self._ends, SCALED[self._mode])
            return DisplayState(
                colour=self._mode,
                points=self._points,
                shown=sum(len(node.cloud) for node in self._nodes),
                scan_id=self._scan_id,
                job_id=self._job_id,
                legend=legend,
                note=f"Every {self._step}th point is drawn; the files hold all." if self._step > 1 else None,
            )

    def _reset(self, job_id: str | None, scan_id: str | None) -> None:
        self._nodes: list[_Node] = []
        self._held: list[PointCloud] = []
        self._job_id, self._scan_id = job_id, scan_id
        self._points = 0
        self._step = 1
        self._serial = 0
        self._ends: tuple[float, float] | None = None
        self._bounds = _EMPTY_BOUNDS
        self._samples: list[FloatArray] = []
        self._flushed_s = float("-inf")

    def _furnish(self) -> None:
        scene = self._server.scene
        scene.set_up_direction("+z")
        scene.add_grid(
            "/bed", infinite_grid=True, cell_size=10.0, section_size=100.0, cell_color=(34, 41, 52),
            section_color=(58, 70, 88), cell_thickness=0.7, section_thickness=1.0, fade_distance=1200.0,
            shadow_opacity=0.0,
        )  # fmt: skip
        self._server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        camera = self._server.initial_camera
        camera.fov = float(FIELD_OF_VIEW_RAD)
        # viser's own far plane, 1000, would cut a scene in millimetres.
        camera.near, camera.far = 1.0, 20_000.0
        self._place_cameras()

    def _flush(self) -> None:
        cloud = PointCloud.concatenate(self._held)
        self._held = []
        self._flushed_s = self._clock.monotonic_s()
        cloud = _finite(cloud)
        if not len(cloud):
            return
        shown = sum(len(node.cloud) for node in self._nodes)
        while shown + len(cloud) > self._max_points:
            self._step *= 2
            cloud = _thinned(cloud, 2)
            self._thin()
            shown = sum(len(node.cloud) for node in self._nodes)
        first = not self._nodes
        for start in range(0, len(cloud), NODE_POINTS):
            part = _sliced(cloud, slice(start, start + NODE_POINTS))
            self._grow(part)
            self._nodes.append(self._show(part))
        self._rescale(force=False)
        if first:
            self._place_cameras()

    def _show(self, cloud: PointCloud) -> _Node:
        self._serial += 1
        with np.errstate(invalid="ignore"):
            low, high = cloud.points_mm.min(axis=0), cloud.points_mm.max(axis=0)
        origin = np.round((low + high) / 2)
        handle = self._server.scene.add_point_cloud(
            f"/cloud/{self._serial:06d}",
            points=np.asarray(cloud.points_mm - origin, np.float32),
            colors=colours(cloud, self._mode, self._ends),
            point_size=_spacing_mm(cloud.points_mm),
            point_shape="circle",
            point_shading="flat",
            precision="float32",
            position=origin,
        )
        return _Node(handle, cloud)

    def _grow(self, cloud: PointCloud) -> None:
        self._samples.append(cloud.points_mm[:: max(1, len(cloud) // 5000)])
        points = np.concatenate(self._samples)
        above = points[points[:, 2] > BARE_BED_MM]
        # The bed reaches far around what lies on it.
        points = above if len(above) > OBJECT_FRACTION * len(points) else points
        # A few stray points must not make the object small.
        self._bounds = np.percentile(points, STRAY_PERCENTILES, axis=0)

    def _thin(self) -> None:
        clouds = [_thinned(node.cloud, 2) for node in self._nodes]
        for node in self._nodes:
            node.handle.remove()
        self._nodes = [self._show(cloud) for cloud in clouds if len(cloud)]

    def _rescale(self, *, force: bool) -> None:
        if self._mode in SCALED:
            ends = value_range([scalar(node.cloud, self._mode) for node in self._nodes])
            if not force and not _outgrown(self._ends, ends):
                return
            self._ends = ends
        elif not force:
            return
        for node in self._nodes:
            node.handle.colors = colours(node.cloud, self._mode, self._ends)

    def _camera_pose(self) -> tuple[FloatArray, FloatArray]:
        """Position and target, in the bed frame, from which the whole cloud is seen."""
        low, high = self._bounds
        centre = (low + high) / 2
        radius_mm = max(float(np.linalg.norm(high - low)) / 2, 10.0)
        return centre + _VIEW_DIRECTION * radius_mm / np.sin(FIELD_OF_VIEW_RAD / 2) * 1.05, centre

    def _place_cameras(self) -> None:
        position, target = self._camera_pose()
        self._server.initial_camera.position = position
        self._server.initial_camera.look_at = target
        for client_id, client in self._server.get_clients().items():
            placed = self._placed.get(client_id)
            # Who has moved the camera keeps the view that was chosen.
            if placed is None or np.linalg.norm(client.camera.position - placed) < 0.02 * np.linalg.norm(placed) + 1.0:
                client.camera.position = position
                client.camera.look_at = target
                self._placed[client_id] = position

    def _welcome(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._placed[client.client_id] = np.array(client.camera.position)
            present = set(self._server.get_clients())
            self._placed = {key: value for key, value in self._placed.items() if key in present}


def _spacing_mm(points: FloatArray) -> float:
    """About the distance between neighbours, so that a surface looks closed and its edges stay sharp.

    The area is counted in cells that hold a point: a batch's hull is mostly empty, because the two stripes lie far
    apart.
    """
    cells = np.unique(np.floor(points[:, :2] / CELL_MM).astype(np.int32), axis=0)
    return float(np.clip(CELL_MM * np.sqrt(len(cells) / len(points)), 0.05, 2.0))


def _outgrown(old: tuple[float, float] | None, new: tuple[float, float] | None) -> bool:
    if old is None or new is None:
        return old is not new
    slack = RESCALE_FRACTION * max(old[1] - old[0], 1e-9)
    return abs(new[0] - old[0]) > slack or abs(new[1] - old[1]) > slack


def _sliced(cloud: PointCloud, rows: slice | BoolArray) -> PointCloud:
    return PointCloud(
        cloud.points_mm[rows], cloud.sigma_mm[rows], cloud.intensity[rows], cloud.colour[rows], cloud.source[rows]
    )


def _thinned(cloud: PointCloud, step: int) -> PointCloud:
    return cloud if step == 1 else _sliced(cloud, slice(None, None, step))


def _finite(cloud: PointCloud) -> PointCloud:
    known: BoolArray = np.asarray(np.isfinite(cloud.points_mm).all(axis=1))
    return cloud if known.all() else _sliced(cloud, known)
