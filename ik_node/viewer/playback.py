"""Playback position on a timeline: play, pause, speed, seek. Elapsed time is an argument."""

from __future__ import annotations

from dataclasses import dataclass

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Timeline seconds per second that the page offers."""


@dataclass
class Playback:
    """Playback position between the begin and the end of a timeline; the end of a live timeline advances."""

    begin_s: float
    end_s: float
    live: bool = False
    """Playing at the end follows the end instead of stopping."""
    time_s: float = 0.0
    playing: bool = False
    speed: float = 1.0
    """Timeline seconds per second."""

    def __post_init__(self) -> None:
        self.time_s = self.end_s if self.live else self.begin_s
        self.playing = self.live

    @property
    def following(self) -> bool:
        """Whether the position follows the end of a live timeline."""
        return self.live and self.playing and self.time_s >= self.end_s

    def extend(self, begin_s: float, end_s: float) -> None:
        """Sets a new range. A position that follows the end moves with it; others are clamped to the range."""
        following = self.following
        self.begin_s, self.end_s = begin_s, max(begin_s, end_s)
        self.seek(self.end_s if following else self.time_s)

    def advance(self, elapsed_s: float) -> None:
        """Plays for ``elapsed_s`` of real time; stops at the end of a recorded timeline."""
        if not self.playing or self.following:
            return
        self.seek(self.time_s + self.speed * max(elapsed_s, 0.0))
        if self.time_s >= self.end_s and not self.live:
            self.playing = False

    def seek(self, time_s: float) -> None:
        """Sets the position, clamped to the range."""
        self.time_s = min(max(time_s, self.begin_s), self.end_s)

    def toggle(self) -> None:
        """Plays or pauses. Play jumps to the end of a live timeline, and restarts a recorded one at its end."""
        self.playing = not self.playing
        if self.playing and self.live:
            self.time_s = self.end_s
        elif self.playing and self.time_s >= self.end_s:
            self.time_s = self.begin_s
