"""Pictures of iterations like those of the lecture notes.

They show the iterates of an arm with the screw axis from the first one to the goal (Fig. 6.8), or the tangents of a
scalar curve (Fig. 6.7). Colours are those of Okabe and Ito, and cividis.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ik_node.errors import IkNodeError, InputError
from ik_node.inverse_kinematics.newton_raphson import PoseSolution, RootSolution, TerminationReason
from ik_node.inverse_kinematics.worked_examples import PLATEAU_ROOTS, PLATEAU_X_D, plateau_f
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.robot.screw_chain import ScrewChain

INK, FAINT = "#222222", "#9aa0a6"
BLUE, VERMILION, GREEN, ORANGE = "#0072b2", "#d55e00", "#009e73", "#e69f00"
STYLE: Any = {
    "font.size": 10.0,
    "axes.titlesize": 11.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888888",
    "axes.grid": True,
    "grid.color": "#e6e8ea",
    "text.color": INK,
    "axes.labelcolor": INK,
}
MAX_ARMS = 6
"""Number of iterates drawn as arms: the first ones and the last one."""


def draw_pose_iterations(
    path: str | Path, title: str, chain: Robot | ScrewChain, pose_sd: Array, solution: PoseSolution
) -> None:
    """Writes a picture of a result of inverse kinematics.

    Left: the arm at its iterates, light to dark, the frame of the goal, the screw axis of the first V_b, and the path
    of that constant twist during one second. Right: both errors over the iterations.

    Args:
        path: Output file, PNG, SVG or PDF according to its suffix.
        title: Title of the picture.
        chain: The arm.
        pose_sd: The goal, (4, 4).
        solution: The result.

    Raises:
        IkNodeError: matplotlib is not installed.
        InputError: The file cannot be written.
    """
    planar = _is_planar(chain)
    with _picture(path, (12.5, 6.6)) as figure:
        grid = figure.add_gridspec(
            1, 2, width_ratios=(1.2, 1.0), left=0.06, right=0.975, top=0.86, bottom=0.19, wspace=0.16
        )
        axes = figure.add_subplot(grid[0]) if planar else _space_axes(figure)
        figure.suptitle(title, x=0.06, y=0.965, ha="left", fontsize=14, fontweight="bold")
        points = _draw_arms(axes, chain, solution, planar)
        points += _draw_screw(axes, solution.iterates[0].pose_sb, pose_sd, planar, _size(points))
        length = 0.12 * _size(points)
        points.append(_draw_frame(axes, solution.iterates[0].pose_sb, length, planar, "start", -0.45))
        points.append(_draw_frame(axes, pose_sd, length, planar, "goal", 0.45))
        _limits(axes, np.concatenate(points), planar)
        _draw_errors(figure.add_subplot(grid[1]), solution)
        about = "Iterates, light to dark, and the screw motion from the first to the goal"
        figure.text(0.06, 0.885, about, fontsize=11)
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles, labels, loc="lower left", bbox_to_anchor=(0.05, 0.01), ncol=6, frameon=False, fontsize=9)


def draw_plateau(path: str | Path, starts: Sequence[float], runs: Sequence[RootSolution]) -> None:
    """Writes a picture of the curve x_d - f(theta) with the tangents of every run, see :func:`draw_pose_iterations`."""
    with _picture(path, (11.0, 5.6)) as figure:
        axes = figure.add_subplot()
        figure.subplots_adjust(left=0.07, right=0.975, top=0.86, bottom=0.11)
        title = r"Newton-Raphson on $x_d - f(\theta) = 0$: two roots, a plateau"
        figure.suptitle(title, x=0.07, y=0.965, ha="left", fontsize=14, fontweight="bold")
        theta = np.linspace(-1.0, 5.5, 1200)
        axes.plot(theta, PLATEAU_X_D - plateau_f(theta), color=INK, linewidth=1.8, label=r"$x_d - f(\theta)$")
        axes.axhline(0.0, color=FAINT, linewidth=0.8)
        colours = (BLUE, GREEN, VERMILION, ORANGE)
        for index, (start, run) in enumerate(zip(starts, runs, strict=True)):
            _draw_tangents(axes, start, run, colours[index % len(colours)])
        axes.plot(PLATEAU_ROOTS, (0.0, 0.0), "o", color=INK, markersize=7, label="roots", zorder=5)
        axes.set_xlim(theta[0], theta[-1])
        axes.set_ylim(-0.56, 0.72)
        axes.set_xlabel(r"$\theta$")
        axes.set_ylabel(r"$x_d - f(\theta)$")
        axes.legend(loc="upper left", frameon=False, fontsize=9)


@contextlib.contextmanager
def _picture(path: str | Path, size: tuple[float, float]) -> Iterator[Any]:
    """An empty figure, written to ``path`` at the end."""
    try:
        import matplotlib as mpl  # imported here because it is optional
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise IkNodeError("pictures need matplotlib, which is not installed") from error
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=size)
        FigureCanvasAgg(figure)
        yield figure
        try:
            figure.savefig(Path(path), dpi=120)
        except (OSError, ValueError) as error:
            raise InputError(f"the picture cannot be written: {error}") from error


def _space_axes(figure: Any) -> Any:
    axes = figure.add_axes((0.0, 0.16, 0.56, 0.72), projection="3d", computed_zorder=False)
    axes.view_init(elev=22.0, azim=-58.0)
    return axes


def _is_planar(chain: Robot | ScrewChain) -> bool:
    """True if every joint moves the tool in the plane z = constant of the base."""
    pose, jacobian = chain.evaluate(np.linspace(0.1, 0.7, chain.n))
    space = se3.adjoint(pose) @ jacobian
    return bool(np.abs(space[2:5]).max() < 1e-9)


def _draw_arms(axes: Any, chain: Robot | ScrewChain, solution: PoseSolution, planar: bool) -> list[Array]:
    """Draws the arm at its iterates; returns the points drawn."""
    import matplotlib as mpl

    rows = list(enumerate(solution.iterates))
    shown = rows if len(rows) <= MAX_ARMS else [*rows[: MAX_ARMS - 1], rows[-1]]
    points = []
    for place, (index, row) in enumerate(shown):
        last = index == len(rows) - 1
        line = np.vstack((np.zeros(3), chain.joint_origins(row.theta), row.pose_sb[:3, 3]))
        points.append(line)
        part = place / max(1, len(shown) - 1)
        colour = mpl.colormaps["cividis_r"](0.12 + 0.83 * part)
        label = rf"$\theta^{{{index}}}$" + (" (last)" if last else "")
        axes.plot(
            *_coordinates(line, planar), "-o", color=colour, linewidth=3.4 if last else 2.2, markersize=5, label=label,
            solid_capstyle="round", zorder=2 + part,
        )  # fmt: skip
    return points


def _draw_screw(axes: Any, pose_sb: Array, pose_sd: Array, planar: bool, size: float) -> list[Array]:
    """Draws the path of constant V_b from ``pose_sb`` to ``pose_sd`` and its screw axis; returns the points."""
    twist_b = se3.log(se3.inverse(pose_sb) @ pose_sd)
    path = np.array([(pose_sb @ se3.exp(twist_b * part))[:3, 3] for part in np.linspace(0.0, 1.0, 100)])
    axes.plot(*_coordinates(path, planar), "--", color=VERMILION, linewidth=1.5, label=r"path of constant $V_b$")
    twist_s = se3.adjoint(pose_sb) @ twist_b
    v, omega = twist_s[:3], twist_s[3:]
    rate = float(np.linalg.norm(omega))
    if rate < 1e-9:
        return [path]
    direction = omega / rate
    foot = np.cross(omega, v) / rate**2
    if planar:
        ring = {"color": "white", "markeredgecolor": VERMILION, "markeredgewidth": 1.5, "markersize": 12}
        axes.plot(*foot[:2], linestyle="", marker="o", zorder=6, label="screw axis", **ring)
        axes.plot(*foot[:2], "o", color=VERMILION, markersize=4, zorder=7)
        return [path, foot[None, :]]
    # The section of the axis beside the path, if it is near the picture.
    along = (path - foot) @ direction
    low, high = float(along.min()) - 0.25 * size, float(along.max()) + 0.25 * size
    line = foot + np.outer((low, high), direction)
    near = float(np.linalg.norm(np.cross(path[0] - foot, direction))) < 1.5 * size
    if near:
        axes.plot(*line.T, "-.", color=VERMILION, linewidth=1.5, label="screw axis")
    return [path, line] if near else [path]


def _draw_frame(axes: Any, pose: Array, length: float, planar: bool, name: str, aside: float) -> Array:
    """Draws the axes of ``pose`` and its name, ``aside`` lengths along x and y; returns the points drawn."""
    ends = [pose[:3, 3], *(pose[:3, 3] + length * pose[:3, column] for column in range(2 if planar else 3))]
    for end, colour in zip(ends[1:], (VERMILION, GREEN, BLUE), strict=False):
        axes.plot(*_coordinates(np.array([ends[0], end]), planar), color=colour, linewidth=2.0, zorder=8)
    place = pose[:3, 3] + aside * length * (pose[:3, 0] + pose[:3, 1])
    axes.text(*_coordinates(place[None, :], planar)[:, 0], f"{{{name}}}", fontsize=10, ha="center", zorder=9)
    return np.array(ends)


def _draw_errors(axes: Any, solution: PoseSolution) -> None:
    steps = np.arange(len(solution.iterates))
    series = (
        (r"$\Vert \omega_b \Vert$ [rad]", BLUE, "o", [row.norm_omega for row in solution.iterates]),
        (r"$\Vert v_b \Vert$ [m]", VERMILION, "s", [row.norm_v for row in solution.iterates]),
    )
    for label, colour, marker, values in series:
        # An error of exactly zero is drawn at the level of rounding.
        axes.semilogy(steps, np.maximum(values, 1e-17), marker=marker, color=colour, linewidth=1.6, label=label)
    axes.set_xlabel("iteration i")
    axes.xaxis.get_major_locator().set_params(integer=True)
    ended = "converged" if solution.converged else f"not converged: {solution.reason.value}"
    axes.set_title(f"Error: {ended}")
    axes.legend(loc="upper right", frameon=False)


def _draw_tangents(axes: Any, start: float, run: RootSolution, colour: str) -> None:
    label = rf"from $\theta^0$ = {start:g}: " + (
        rf"$\theta$ = {run.theta[0]:.4g}" if run.converged else str(run.reason.value)
    )
    axes.plot(start, run.iterates[0].value[0], "o", color=colour, markersize=8, label=label, zorder=6)
    if run.reason is TerminationReason.SINGULAR and len(run.iterates) == 1:
        value = float(run.iterates[0].value[0])
        axes.plot((start - 1.0, start + 1.0), (value, value), "--", color=colour, linewidth=1.4)
    for row, following in zip(run.iterates, run.iterates[1:], strict=False):
        here, there = (float(row.theta[0]), float(row.value[0])), (float(following.theta[0]), 0.0)
        axes.plot((here[0], there[0]), (here[1], there[1]), "--", color=colour, linewidth=1.3)
        axes.plot((there[0], there[0]), (0.0, float(following.value[0])), ":", color=colour, linewidth=1.1)
        axes.plot(there[0], float(following.value[0]), "o", color=colour, markersize=4)


def _coordinates(points: Array, planar: bool) -> Array:
    return np.asarray(points.T[: 2 if planar else 3])


def _size(points: Sequence[Array]) -> float:
    together = np.concatenate(points)
    return float(np.ptp(together, axis=0).max()) or 1.0


def _limits(axes: Any, points: Array, planar: bool) -> None:
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.56 * float((high - low).max())
    if planar:
        axes.set_aspect("equal")
        axes.set_xlim(low[0] - 0.12 * half, high[0] + 0.12 * half)
        axes.set_ylim(low[1] - 0.12 * half, high[1] + 0.12 * half)
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        return
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_zlim(middle[2] - half, middle[2] + half)
    axes.set_box_aspect((1.0, 1.0, 1.0))
    for name in "xyz":
        getattr(axes, f"set_{name}label")(f"{name} [m]")
        getattr(axes, f"{name}axis").pane.set_alpha(0.0)
        getattr(axes, f"{name}axis").get_major_locator().set_params(nbins=6)
