"""Draws the pictures of README and docs: ``python docs/make_pictures.py [FOLDER] [--only ...]``.

- demonstration: records ``ik_demo``; ``view.webp``, the viewer while it plays the run, and ``report.png`` beside this
  file. Needs Chromium. With a folder, an earlier output of ``ik_demo`` is drawn instead of a new one.
- methods, tasks: simulates the motions of docs/methods and docs/task.md and draws a picture of each.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "test"), str(HERE)]

# These imports need the paths that are set above.
from browser import Browser  # noqa: E402
from figures import draw_methods, draw_tasks  # noqa: E402

from ik_node.cli import demo  # noqa: E402
from ik_node.recording.run_reader import load_run  # noqa: E402
from ik_node.report.recorded_scene import read_obstacles  # noqa: E402
from ik_node.viewer.open_run import open_run  # noqa: E402
from ik_node.viewer.server import serve, url_of  # noqa: E402

WIDTH, HEIGHT, SHOWN_WIDTH = 1280, 720, 800
FRAMES, QUALITY = 36, 70
START_S, END_S = 2.0, 8.0
"""One figure of eight of the demonstration."""
LOADED_S, SETTLED_S = 20.0, 1.0
"""Time that Chromium needs for all meshes, and for one frame, without a GPU."""
CLOSE_NOTIFICATIONS = "document.querySelectorAll('.mantine-Notification-closeButton').forEach(e => e.click())"


def draw_viewer(bag: Path, to: Path) -> None:
    """Writes an animated picture of the viewer's page."""
    server = serve(0)
    folder = tempfile.mkdtemp()
    browser = Browser(Path(folder), WIDTH, HEIGHT)
    try:
        page = open_run(server, load_run(bag), "demo/bag", read_obstacles(bag))
        server.scene.configure_default_lights(cast_shadow=False)  # slow without a GPU
        browser.open(url_of(server).replace("localhost", "127.0.0.1"))
        browser.until("the page to connect", lambda: bool(server.get_clients()))
        browser.until("the plots", lambda: browser.evaluate("document.querySelectorAll('.uplot canvas').length"))
        time.sleep(LOADED_S)
        browser.evaluate(CLOSE_NOTIFICATIONS)
        pictures = []
        for time_s in np.linspace(START_S, END_S, FRAMES, endpoint=False).tolist():
            page.playback.seek(time_s)
            page.request_redraw()
            page.update(1.0)
            time.sleep(SETTLED_S)
            picture = Image.fromarray(browser.picture().astype(np.uint8))
            pictures.append(picture.resize((SHOWN_WIDTH, SHOWN_WIDTH * HEIGHT // WIDTH), Image.Resampling.LANCZOS))
        duration_ms = round(1000.0 * (END_S - START_S) / FRAMES)
        pictures[0].save(to, save_all=True, append_images=pictures[1:], duration=duration_ms, loop=0, quality=QUALITY)
    finally:
        browser.close()
        server.stop()
        shutil.rmtree(folder, ignore_errors=True)


def draw_demonstration(folder: Path) -> None:
    """Draws report and viewer of an output of ``ik_demo``."""
    shutil.copyfile(folder / "report.png", HERE / "report.png")
    draw_viewer(folder / "bag", HERE / "view.webp")


def main() -> int:
    """Draws the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, help="earlier output of ik_demo [a new one]")
    parser.add_argument("--only", choices=("demonstration", "methods", "tasks"), help="draw these only")
    options = parser.parse_args()
    if options.only in (None, "methods"):
        draw_methods(HERE / "methods")
    if options.only in (None, "tasks"):
        draw_tasks(HERE / "tasks")
    if options.only in (None, "demonstration"):
        folder = options.folder
        if folder is None:
            folder = Path(tempfile.mkdtemp()) / "demo"
            if code := demo.main(["--headless", "--out", str(folder)]):
                return code
        draw_demonstration(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
