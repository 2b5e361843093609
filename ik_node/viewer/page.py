"""The page: scene, plots, player and words, put together on viser.

viser's callbacks come from threads of its own; they only note what is wanted. All drawing is done by :meth:`Page.tick`,
in the one thread that owns the robot.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.viewer import status_html
from ik_node.viewer.meshes import Part
from ik_node.viewer.playback import SPEEDS, Player
from ik_node.viewer.plots import AXIS_PX, Plots, plots_for
from ik_node.viewer.recorded_scene import SceneAt
from ik_node.viewer.scene_view import HIDDEN_AT_FIRST, LAYERS, Stage
from ik_node.viewer.timeline import Film

SLOW_PERIOD_S = 0.1
"""Plots, slider and words follow the picture this often."""
PATH_PERIOD_S = 0.5
"""The paths and the extent of a live film are renewed this often."""
USUAL_PERCENT = 98.0
"""So many of a film's multipliers have arrows that are not cut off; the rest are spikes."""
PLOTTED = {"whole run": 0.0, "10 s": 10.0, "2 s": 2.0, "0.5 s": 0.5}
"""What the plots may show: s around the moment; 0: everything."""
PLOTS_PX = 400
CONTROLS_PX = 370


class Subject(NamedTuple):
    """What is looked at."""

    title: str
    robot: Robot
    parts: tuple[Part, ...]
    """Empty: lines are drawn instead."""
    velocity_limits: Array
    """(n,), rad/s (m/s)."""
    mass_weighted: bool
    """The multiplier has units of momentum."""
    scene_at: SceneAt
    targets: Callable[[], Array]
    """Positions of the targets received so far, (m, 3), m, in the base frame."""
    notes: tuple[str, ...] = ()
    """What the page has to say about itself, e.g. that there are no meshes."""
    live: bool = False


class Page:
    """A page on a viser server; :meth:`tick` keeps it going."""

    def __init__(self, server: Any, subject: Subject, film: Callable[[], Film]) -> None:
        """``film`` gives what there is so far; for a recorded run always the same."""
        self.server = server
        self.subject = subject
        self._film = film
        self._lock = threading.RLock()
        now = film()
        self.player = Player(now.begin_s, now.end_s, live=subject.live)
        self.stage = Stage(server, subject.robot, subject.parts)
        self._wanted = True
        """Something has to be drawn although no time has passed."""
        self._slow_s = self._path_s = np.inf
        self._build_look()
        self._build_plots(subject.live or bool(np.isfinite(now.clearance).any()))
        self._build_controls()
        self._aim()
        self.tick(0.0)

    # --- building ----------------------------------------------------------------------------------------------------

    def _build_look(self) -> None:
        gui, scene = self.server.gui, self.server.scene
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(0, 114, 178))
        gui.set_panel_label(self.subject.title)
        scene.set_up_direction("+z")
        scene.configure_environment_map("studio", environment_intensity=0.35)
        scene.set_background_image(_backdrop())
        main = gui.main_panel
        main.dock_right()
        main.set_width(CONTROLS_PX)

    def _build_plots(self, with_clearance: bool) -> None:
        gui = self.server.gui
        panel = gui.add_panel()
        with panel.add_tab("Plots"):
            self._strip = gui.add_html("")
            shown = plots_for(self.subject.robot.joints, self.subject.velocity_limits, with_clearance)
            self._plots = Plots(self.server, shown)
            self._window = gui.add_dropdown("show", tuple(PLOTTED), hint="Part of the run that the plots show")
            self._window.on_update(lambda _: self._want())
        panel.dock_left()
        panel.set_width(PLOTS_PX)

    def _build_controls(self) -> None:
        gui, player = self.server.gui, self.player
        for text in self.subject.notes:
            gui.add_html(status_html.note(text))
        self._play = gui.add_button("Play", icon="player-play")
        self._play.on_click(lambda _: self._toggle())
        gui.add_command("Play or pause", hotkey="space").on_trigger(lambda _: self._toggle())
        self._slider = gui.add_slider("time [s]", _before(player), _after(player), 0.001, round(player.time_s, 3))
        self._slider.on_update(self._on_slider)
        jumps = gui.add_button_group(
            "go to", tuple(JUMPS), hint="start; one tick back; one tick on; next change of the controller's state"
        )
        jumps.on_click(lambda event: self._jump(event.target.value))
        speed = gui.add_dropdown("speed", tuple(f"{speed:g} x" for speed in SPEEDS), initial_value="1 x")
        speed.on_update(lambda event: self._set_speed(event.target.value))
        self._words = gui.add_html("")
        with gui.add_folder("Show"):
            for layer, (label, hint) in LAYERS.items():
                box = gui.add_checkbox(label, layer not in HIDDEN_AT_FIRST, hint=hint)
                box.on_update(lambda event, layer=layer: self._show_layer(layer, event.target.value))
        views = gui.add_button_group("view", tuple(VIEWS))
        views.on_click(lambda event: self._look(event.client, event.target.value))

    # --- what people do (threads of viser) ---------------------------------------------------------------------------

    def _want(self) -> None:
        with self._lock:
            self._wanted = True

    def _toggle(self) -> None:
        with self._lock:
            self.player.toggle()
            self._wanted = True

    def _on_slider(self, event: Any) -> None:
        # What the page itself sets comes back here too, without a client.
        if event.client is None:
            return
        with self._lock:
            if self.subject.live:
                self.player.playing = False
            self.player.seek(float(event.target.value))
            self._wanted = True

    def _jump(self, where: str) -> None:
        with self._lock:
            film, player = self._film(), self.player
            player.playing = False
            row = film.row(player.time_s)
            if where == "event":
                row = next((change for change in film.changes() if change > row), len(film.times_s) - 1)
            else:
                row = row + JUMPS[where] if JUMPS[where] else 0
            if len(film.times_s):
                player.seek(float(film.times_s[min(max(row, 0), len(film.times_s) - 1)]))
            self._wanted = True

    def _set_speed(self, label: str) -> None:
        with self._lock:
            self.player.speed = float(label.split(maxsplit=1)[0])

    def _show_layer(self, layer: str, visible: bool) -> None:
        with self._lock:
            self.stage.set_visible(layer, visible)
            self._wanted = True

    # --- camera ------------------------------------------------------------------------------------------------------

    def _aim(self) -> None:
        """Where the camera is at first, and what it looks at: the arm and all of its path."""
        film = self._film()
        self._centre, self._size = _extent(self.subject, film)
        camera = self.server.initial_camera
        camera.position, camera.look_at = self._centre + self._size * VIEWS["home"], self._centre
        camera.fov = FIELD_OF_VIEW

    def _look(self, client: Any, view: str) -> None:
        if client is not None:
            with client.atomic():
                client.camera.position = self._centre + self._size * VIEWS[view]
                client.camera.look_at = self._centre

    # --- the one thread that draws -----------------------------------------------------------------------------------

    def tick(self, elapsed_s: float) -> None:
        """Lets ``elapsed_s`` of real time pass: moves the play head and draws what has changed."""
        with self._lock:
            film, player = self._film(), self.player
            before = player.time_s
            if self.subject.live:
                player.extend(film.begin_s, film.end_s)
            player.advance(elapsed_s)
            moved = player.time_s != before
            wanted, self._wanted = self._wanted, False
            self._slow_s += elapsed_s
            self._path_s += elapsed_s
            if not len(film.times_s) or not (moved or wanted or self.subject.live):
                return
            if self._path_s >= PATH_PERIOD_S and (self.subject.live or self._path_s == np.inf):
                self._path_s = 0.0
                self._draw_paths(film)
            self._draw_moment(film)
            if wanted or self._slow_s >= SLOW_PERIOD_S or not player.playing:
                self._slow_s = 0.0
                self._draw_slow(film)

    def _draw_moment(self, film: Film) -> None:
        moment = film.moment(film.row(self.player.time_s))
        scene = self.subject.scene_at(self.player.time_s)
        with self.server.atomic():
            self.stage.show(moment, scene)

    def _draw_slow(self, film: Film) -> None:
        player, subject = self.player, self.subject
        moment = film.moment(film.row(player.time_s))
        span_s = PLOTTED[self._window.value]
        begin_s = player.begin_s if span_s == 0.0 else player.time_s - 0.5 * span_s
        end_s = player.end_s if span_s == 0.0 else player.time_s + 0.5 * span_s
        if subject.live and span_s:
            begin_s, end_s = player.time_s - span_s, player.time_s
        with self.server.atomic():
            self._slider.min, self._slider.max = _before(player), _after(player)
            self._slider.value = round(player.time_s, 3)
            self._play.label, self._play.icon = (
                ("Pause", "player-pause")
                if player.playing
                else (("Live", "player-play") if subject.live else ("Play", "player-play"))
            )
            self._words.content = status_html.describe(
                moment, subject.robot.joints, subject.velocity_limits, subject.mass_weighted
            )
            self._plots.draw(film, begin_s, end_s, player.time_s)

    def _draw_paths(self, film: Film) -> None:
        for term, wrenches in enumerate((film.multiplier_task, film.multiplier_potential)):
            for part in range(2):
                self.stage.usual[term, part] = _usual(wrenches[:, 3 * part : 3 * part + 3])
        with self.server.atomic():
            self.stage.draw_paths(film.pose_sb[:, :3, 3], film.pose_sd[:, :3, 3])
            self.stage.draw_targets(self.subject.targets())
            self._strip.content = status_html.strip(film, AXIS_PX + 12, 17)


FIELD_OF_VIEW = 0.7
JUMPS = {"start": 0, "\u25c0": -1, "\u25b6": 1, "event": 0}
"""Buttons that go to another moment, and by how many ticks."""
VIEWS = {
    "home": np.array([1.02, 1.02, 0.6]),
    "front": np.array([1.8, 0.0, 0.1]),
    "side": np.array([0.0, -1.8, 0.1]),
    "top": np.array([0.0, -0.02, 1.9]),
}
"""View -> where the camera is, from the middle of the scene, in sizes of it."""


def _before(player: Player) -> float:
    """The slider's begin, in whole milliseconds."""
    return math.floor(1e3 * player.begin_s) / 1e3


def _after(player: Player) -> float:
    """The slider's end, in whole milliseconds: it needs some length."""
    return max(math.ceil(1e3 * player.end_s), math.floor(1e3 * player.begin_s) + 1) / 1e3


def _usual(vectors: Array) -> float:
    """A norm that few of ``vectors`` (k, 3) exceed; 0 where all are 0 or unknown."""
    norms = np.linalg.norm(vectors, axis=1)
    known = norms[np.isfinite(norms) & (norms > 0.0)]
    return float(np.percentile(known, USUAL_PERCENT)) if len(known) else 0.0


def _backdrop() -> Any:
    """(64, 2, 3), uint8: a light sky above a lighter ground, against which white robots are seen."""
    rows = np.linspace((196, 206, 218), (238, 241, 244), 64)
    return np.repeat(rows[:, None], 2, axis=1).astype(np.uint8)


def _extent(subject: Subject, film: Film) -> tuple[Array, float]:
    """Middle and size, m, of the arm, its path and the obstacles within its reach, in the root frame."""
    robot = subject.robot
    known = np.flatnonzero(np.isfinite(film.q).all(axis=1))
    q = film.q[known[0]] if len(known) else np.zeros(robot.n)
    tools = film.pose_sb[:, :3, 3]
    arm = np.vstack((np.zeros(3), robot.joint_origins(q), robot.pose(q)[:3, 3], tools[np.isfinite(tools).all(axis=1)]))
    reach = max(float(np.linalg.norm(arm, axis=1).max()), 0.3)
    obstacles = [entry.pose_s[:3, 3] for entry in subject.scene_at(film.begin_s).obstacles.values()]
    near = [point for point in obstacles if np.linalg.norm(point) < 1.5 * reach]
    points = np.vstack((arm, *near))
    low, high = points.min(axis=0), points.max(axis=0)
    centre = np.append(0.5 * (low + high), 1.0)
    inverse = np.linalg.inv(robot.pose_base_root)
    return (inverse @ centre)[:3], max(float(np.linalg.norm(high - low)), 0.3)
