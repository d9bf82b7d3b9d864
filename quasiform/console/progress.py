"""How far a run has come, on stderr: a bar on a terminal, plain lines in a pipe or a log."""

from __future__ import annotations

import sys
import time
from datetime import timedelta
from math import nan
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.text import Text

from ..solve.increments import Progress

if TYPE_CHECKING:
    from ..studies import StudyProgress

# A run slows down on its way: in five of the built-in scenes the time left, as shown from a quarter
# of the travel on, was 0.3 to 4 times what it took if the time grew as its square, 0.1 to 1.1
# times (0.4 in the mean) if in proportion. What comes after the travel is not in it.
GROWTH, SHOWN_FROM = 2, 1 / 4
SELDOM = 5.0  # s between lines of a study in a log


def progress(step: Progress) -> None:
    """Show on stderr how far a run has come: `solve(scene, callback=progress)`.

    On a terminal one line is drawn over and over; elsewhere each increment prints a line.

    Parameters
    ----------
    step : Progress
    """
    console = Console(stderr=True)
    if _draws(console):
        console.print(_bar(step, console), end="\n" if step.travel >= step.goal else "\r")
    else:
        print(_words(step), file=sys.stderr, flush=True)


class LiveProgress:
    """The same callback with a clock that runs on between two increments.

    A context around a run to the travel `goal`, however it ends.
    """

    def __init__(self, goal: float) -> None:
        self._step = Progress(0.0, goal, nan, 0.0, 0, 0, 0.0)
        self._part: Progress | None = None
        self._stage, self._begun = "", 0.0
        self._shown = time.perf_counter()
        self._console = Console(stderr=True)
        self._live = Live(get_renderable=self._row, console=self._console)

    def __enter__(self) -> LiveProgress:
        if _draws(self._console):
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def __call__(self, step: Progress) -> None:
        self._step, self._stage, self._shown = step, "", time.perf_counter()
        if not self._live.is_started:
            progress(step)

    def stage(self, words: str) -> None:
        """Show what follows the travel."""
        self._stage, self._part, self._begun = words, None, time.perf_counter()
        if not self._live.is_started:
            print(words, file=sys.stderr, flush=True)

    def step(self, step: Progress) -> None:
        """Show how far the stage has come."""
        self._part, self._shown = step, time.perf_counter()
        if not self._live.is_started:
            print(f"{self._stage}: {_words(step)}", file=sys.stderr, flush=True)

    def _row(self) -> Text:
        since = time.perf_counter() - self._shown
        if self._stage:
            took = time.perf_counter() - self._begun
            part = _words(self._part, since) if self._part else f"{_clock(took)} elapsed"
            words = f"{self._stage}: {part}"
            return Text(words, no_wrap=True, overflow="crop")
        return _bar(self._step, self._console, since)


class StudyBar:
    """The callback of a study: a bar over its runs, or lines, with the time that is left."""

    def __init__(self) -> None:
        self._failed, self._shown = 0, -SELDOM
        self._console = Console(stderr=True)

    def __call__(self, step: StudyProgress) -> None:
        self._failed += "error" in step.row
        words = f"{step.done} of {step.total} runs, {_clock(step.elapsed)} elapsed"
        if step.left:
            words += f", about {_clock(step.elapsed * step.left / step.solved)} left"
        words += f", {self._failed} failed" * bool(self._failed)
        if _draws(self._console):
            line = _line(words, step.done / step.total, self._console)
            self._console.print(line, end="\r" if step.left else "\n")
        elif not step.left or step.elapsed - self._shown >= SELDOM:
            self._shown = step.elapsed
            print(words, file=sys.stderr, flush=True)


def _draws(console: Console) -> bool:
    """Whether stderr is a terminal on which a line can be drawn over."""
    return console.file.isatty() and not console.is_dumb_terminal


def _words(step: Progress, since: float = 0.0) -> str:
    """How far a run had come at a step, `since` seconds later."""
    words = [f"travel {step.travel:.4g} of {step.goal:.4g}"]
    words.append(f"{_clock(step.elapsed + since)} elapsed")
    if SHOWN_FROM * step.goal <= step.travel < step.goal:
        left = step.elapsed * ((step.goal / step.travel) ** GROWTH - 1)
        words.append(f"about {_clock(max(left - since, 0.0))} left")
    if step.travel:
        words.append(f"residual {step.residual:.1e}")
    if step.contacts:
        words.append(f"{step.contacts} contacts")
    return ", ".join(words)


def _bar(step: Progress, console: Console, since: float = 0.0) -> Text:
    return _line(_words(step, since), step.travel / step.goal, console)


def _line(words: str, share: float, console: Console) -> Text:
    """One line as wide as the console: the bar, then the words, cut off where it ends."""
    words = f" {words}"
    width = max(8, min(30, console.width - len(words) - 1))
    bar = ProgressBar(total=1.0, completed=share, width=width)
    line = Text.assemble(*((s.text, s.style or "") for s in console.render(bar)), words)
    line.truncate(console.width - 1, pad=True)
    return line


def _clock(seconds: float) -> str:
    """Minutes and seconds, with hours where there are any: 1:05, 1:02:05."""
    return str(timedelta(seconds=round(seconds))).removeprefix("0:").removeprefix("0")
