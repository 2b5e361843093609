"""The page: scene, plots, playback controls and status, assembled on viser.

The callbacks of viser run in threads of viser and only set state. All drawing is done by :meth:`ViewerPage.update` in
the thread that owns the robot model.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.report.recorded_scene import SceneAt
from ik_node.robot.robot import Robot
from ik_node.viewer import status_html
from ik_node.viewer.camera_views import FIELD_OF_VIEW, NARROW_PX, VIEWS, camera_placement
from ik_node.viewer.meshes import MeshPart
from ik_node.viewer.playback import SPEEDS, Playback
from ik_node.viewer.plots import AXIS_PX, PlotPanel, plots_for
from ik_node.viewer.scene_view import HIDDEN_AT_FIRST, LAYERS, SceneView
from ik_node.viewer.task_plots import task_plots
from ik_node.viewer.timeline import Timeline

SLOW_PERIOD_S = 0.1
"""Update period of plots, slider and status."""
PATH_PERIOD_S = 0.5
"""Update period of the paths and the range of a live timeline."""
REFERENCE_PERCENTILE = 98.0
"""Percentile of the norms of the multiplier that is drawn with the reference length; peaks are clipped."""
PLOT_WINDOWS = {"whole run": 0.0, "10 s": 10.0, "2 s": 2.0, "0.5 s": 0.5}
"""Label -> time around the cursor that the plots show, s; 0: the whole run."""
PLOTS_PX = 300
"""With the controls, less than half of a screen of 1280 px."""
CONTROLS_PX = 300


class PageContent(NamedTuple):
    """The robot and the data of a page."""

    title: str
    robot: Robot
    parts: tuple[MeshPart, ...]
    """Visual geometry; if empty, lines between the joints are drawn."""
    velocity_limits: Array
    """(n,), rad/s (m/s)."""
    mass_weighted: bool
    """Whether the multiplier has units of momentum."""
    gradient_gain: Callable[[float], float]
    """Time in s -> the gain k of the potential at that time."""
    scene_at: SceneAt
    tolerance_at: Callable[[float], TaskTolerance]
    """Time in s -> the tolerance of the task at that time."""
    targets: Callable[[], Array]
    """Positions of the targets received so far, (m, 3), m, in the base frame."""
    to_trajectory: Callable[[Array], Array] | None = None
    """Times (k,), s -> distance of the tool from the trajectory, (k,), m; None when it is not known."""
    verdict_html: str = ""
    """The verdict of a recorded run and what was done, as HTML."""
    notes: tuple[str, ...] = ()
    """Notes shown on the page, for example that the meshes are missing."""
    live: bool = False


class ViewerPage:
    """A page on a viser server; call :meth:`update` periodically."""

    def __init__(self, server: Any, content: PageContent, timeline: Callable[[], Timeline]) -> None:
        """Builds the page and draws the first frame.

        Args:
            server: viser.ViserServer.
            content: Robot and data.
            timeline: Returns the current timeline; for a recorded run always the same object.
        """
        self.server = server
        self.content = content
        self._timeline = timeline
        self._lock = threading.RLock()
        initial = timeline()
        self.playback = Playback(initial.begin_s, initial.end_s, live=content.live)
        self.scene_view = SceneView(server, content.robot, content.parts)
        self._redraw = True
        """Draw although the playback time has not changed."""
        self._since_slow_s = self._since_paths_s = np.inf
        self._build_appearance()
        self._build_plots(content.live or bool(np.isfinite(initial.clearance).any()))
        self._build_controls()
        self._set_initial_camera()
        self.update(0.0)

    @property
    def status(self) -> str:
        """Values and mode of the displayed frame, as HTML."""
        return str(self._status.content)

    # --- building ----------------------------------------------------------------------------------------------------

    def _build_appearance(self) -> None:
        gui, scene = self.server.gui, self.server.scene
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(0, 114, 178))
        gui.set_panel_label(self.content.title)
        scene.set_up_direction("+z")
        scene.configure_environment_map("studio", environment_intensity=0.35)
        scene.set_background_image(_background())
        main = gui.main_panel
        main.dock_right()
        main.set_width(CONTROLS_PX)

    def _build_plots(self, with_clearance: bool) -> None:
        gui = self.server.gui
        panel = gui.add_panel()
        with panel.add_tab("Plots"):
            self._mode_bar = gui.add_html("")
            shown = plots_for(
                self.content.robot.joints, self.content.velocity_limits, with_clearance, self.content.to_trajectory
            )
            self._plots = PlotPanel(self.server, (shown[0], *task_plots(self.content.tolerance_at), *shown[1:]))
            self._window = gui.add_dropdown("show", tuple(PLOT_WINDOWS), hint="Time range of the plots")
            self._window.on_update(lambda _: self.request_redraw())
        panel.dock_left()
        panel.set_width(PLOTS_PX)
        panel.expand()  # in the sheet of a narrow window, too, where it would be folded

    def _build_controls(self) -> None:
        gui, playback = self.server.gui, self.playback
        if self.content.verdict_html:
            gui.add_html(self.content.verdict_html)
        for text in self.content.notes:
            gui.add_html(status_html.note_html(text))
        self._play = gui.add_button("Play", icon="player-play")
        self._play.on_click(lambda _: self._toggle())
        gui.add_command("Play or pause", hotkey="space").on_trigger(lambda _: self._toggle())
        self._slider = gui.add_slider(
            "time [s]", _slider_min(playback), _slider_max(playback), 0.001, round(playback.time_s, 3)
        )
        self._slider.on_update(self._on_slider)
        jumps = gui.add_button_group(
            "go to", tuple(JUMPS), hint="start; previous step; next step; next change of the controller's status"
        )
        jumps.on_click(lambda event: self._jump(event.target.value))
        speed = gui.add_dropdown("speed", tuple(f"{speed:g} x" for speed in SPEEDS), initial_value="1 x")
        speed.on_update(lambda event: self._set_speed(event.target.value))
        self._status = gui.add_html("")
        with gui.add_folder("Show"):
            for layer, (label, hint) in LAYERS.items():
                box = gui.add_checkbox(label, layer not in HIDDEN_AT_FIRST, hint=hint)
                box.on_update(lambda event, layer=layer: self._show_layer(layer, event.target.value))
        views = gui.add_button_group("view", tuple(VIEWS))
        views.on_click(lambda event: self._set_view(event.client, event.target.value))

    # --- callbacks (threads of viser) --------------------------------------------------------------------------------

    def request_redraw(self) -> None:
        """Makes the next :meth:`update` draw even if the playback time has not changed."""
        with self._lock:
            self._redraw = True

    def _toggle(self) -> None:
        with self._lock:
            self.playback.toggle()
            self._redraw = True

    def _on_slider(self, event: Any) -> None:
        # Values set by the page itself arrive here as well, without a client.
        if event.client is None:
            return
        with self._lock:
            if self.content.live:
                self.playback.playing = False
            self.playback.seek(float(event.target.value))
            self._redraw = True

    def _jump(self, where: str) -> None:
        with self._lock:
            timeline, playback = self._timeline(), self.playback
            playback.playing = False
            row = timeline.row(playback.time_s)
            if where == "event":
                row = next((change for change in timeline.status_changes() if change > row), len(timeline.times_s) - 1)
            else:
                row = row + JUMPS[where] if JUMPS[where] else 0
            if len(timeline.times_s):
                playback.seek(float(timeline.times_s[min(max(row, 0), len(timeline.times_s) - 1)]))
            self._redraw = True

    def _set_speed(self, label: str) -> None:
        with self._lock:
            self.playback.speed = float(label.split(maxsplit=1)[0])

    def _show_layer(self, layer: str, visible: bool) -> None:
        with self._lock:
            self.scene_view.set_visible(layer, visible)
            self._redraw = True

    # --- camera ------------------------------------------------------------------------------------------------------

    def _set_initial_camera(self) -> None:
        """Points the camera at the arm and its whole path."""
        timeline = self._timeline()
        self._centre, self._size = _extent(self.content, timeline)
        camera = self.server.initial_camera
        camera.position, camera.look_at = camera_placement("home", self._centre, self._size)
        camera.fov = FIELD_OF_VIEW
        self.server.on_client_connect(self._fit_to_window)

    def _fit_to_window(self, client: Any) -> None:
        """Shows the scene above the sheet of a narrow window."""
        if client.camera.image_width <= NARROW_PX:
            self._set_view(client, "home")

    def _set_view(self, client: Any, view: str) -> None:
        if client is not None:
            with client.atomic():
                client.camera.position, client.camera.look_at = camera_placement(
                    view, self._centre, self._size, client.camera.image_width
                )

    # --- drawing (thread that owns the robot model) ------------------------------------------------------------------

    def update(self, elapsed_s: float) -> None:
        """Advances the playback by ``elapsed_s`` of real time and draws what has changed."""
        with self._lock:
            timeline, playback = self._timeline(), self.playback
            before = playback.time_s
            if self.content.live:
                playback.extend(timeline.begin_s, timeline.end_s)
            playback.advance(elapsed_s)
            moved = playback.time_s != before
            redraw, self._redraw = self._redraw, False
            self._since_slow_s += elapsed_s
            self._since_paths_s += elapsed_s
            if not len(timeline.times_s) or not (moved or redraw or self.content.live):
                return
            if self._since_paths_s >= PATH_PERIOD_S and (self.content.live or self._since_paths_s == np.inf):
                self._since_paths_s = 0.0
                self._draw_paths(timeline)
            self._draw_moment(timeline)
            if redraw or self._since_slow_s >= SLOW_PERIOD_S or not playback.playing:
                self._since_slow_s = 0.0
                self._draw_slow(timeline)

    def _draw_moment(self, timeline: Timeline) -> None:
        frame = timeline.frame(timeline.row(self.playback.time_s))
        scene = self.content.scene_at(self.playback.time_s)
        with self.server.atomic():
            self.scene_view.update(frame, scene, self.content.tolerance_at(self.playback.time_s))

    def _draw_slow(self, timeline: Timeline) -> None:
        playback, content = self.playback, self.content
        frame = timeline.frame(timeline.row(playback.time_s))
        span_s = PLOT_WINDOWS[self._window.value]
        begin_s = playback.begin_s if span_s == 0.0 else playback.time_s - 0.5 * span_s
        end_s = playback.end_s if span_s == 0.0 else playback.time_s + 0.5 * span_s
        if content.live and span_s:
            begin_s, end_s = playback.time_s - span_s, playback.time_s
        with self.server.atomic():
            self._slider.min, self._slider.max = _slider_min(playback), _slider_max(playback)
            self._slider.value = round(playback.time_s, 3)
            self._play.label, self._play.icon = (
                ("Pause", "player-pause")
                if playback.playing
                else (("Live", "player-play") if content.live else ("Play", "player-play"))
            )
            self._status.content = status_html.frame_html(
                frame,
                content.robot.joints,
                content.velocity_limits,
                content.mass_weighted,
                content.gradient_gain(playback.time_s),
                content.tolerance_at(playback.time_s),
            )
            self._plots.draw(timeline, begin_s, end_s, playback.time_s)

    def _draw_paths(self, timeline: Timeline) -> None:
        for term, terms in enumerate((timeline.multiplier_task, timeline.multiplier_potential)):
            for half in range(2):
                self.scene_view.reference_norms[term, half] = _reference_norm(terms[:, 3 * half : 3 * half + 3])
        with self.server.atomic():
            self.scene_view.draw_paths(timeline.pose_sb[:, :3, 3], timeline.pose_sd[:, :3, 3])
            self.scene_view.draw_targets(self.content.targets())
            self._mode_bar.content = status_html.mode_bar_html(timeline, AXIS_PX + 12, 17)


JUMPS = {"start": 0, "\u25c0": -1, "\u25b6": 1, "event": 0}
"""Button -> number of steps to move."""


def _slider_min(playback: Playback) -> float:
    """Begin of the slider, in whole milliseconds."""
    return math.floor(1e3 * playback.begin_s) / 1e3


def _slider_max(playback: Playback) -> float:
    """End of the slider, in whole milliseconds; at least 1 ms after its begin."""
    return max(math.ceil(1e3 * playback.end_s), math.floor(1e3 * playback.begin_s) + 1) / 1e3


def _reference_norm(vectors: Array) -> float:
    """Percentile of the norms of ``vectors`` (k, 3); 0 if all are 0 or NaN."""
    norms = np.linalg.norm(vectors, axis=1)
    positive = norms[np.isfinite(norms) & (norms > 0.0)]
    return float(np.percentile(positive, REFERENCE_PERCENTILE)) if len(positive) else 0.0


def _background() -> Any:
    """Vertical gradient, (64, 2, 3) uint8, with enough contrast to white robots."""
    rows = np.linspace((196, 206, 218), (238, 241, 244), 64)
    return np.repeat(rows[:, None], 2, axis=1).astype(np.uint8)


def _extent(content: PageContent, timeline: Timeline) -> tuple[Array, float]:
    """Centre (3,) and size, m, of the arm, its path and the obstacles within reach, in the root frame."""
    robot = content.robot
    rows = np.flatnonzero(np.isfinite(timeline.joint_position).all(axis=1))
    q = timeline.joint_position[rows[0]] if len(rows) else np.zeros(robot.n)
    tools = timeline.pose_sb[:, :3, 3]
    arm = np.vstack((np.zeros(3), robot.joint_origins(q), robot.pose(q)[:3, 3], tools[np.isfinite(tools).all(axis=1)]))
    reach = max(float(np.linalg.norm(arm, axis=1).max()), 0.3)
    obstacles = [entry.pose_s[:3, 3] for entry in content.scene_at(timeline.begin_s).obstacles.values()]
    near = [point for point in obstacles if np.linalg.norm(point) < 1.5 * reach]
    points = np.vstack((arm, *near))
    low, high = points.min(axis=0), points.max(axis=0)
    centre = np.append(0.5 * (low + high), 1.0)
    inverse = np.linalg.inv(robot.pose_base_root)
    return (inverse @ centre)[:3], max(float(np.linalg.norm(high - low)), 0.3)
